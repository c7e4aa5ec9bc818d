"""A bar with a closed cavity, and the scenes that its tendons are tried in."""

from __future__ import annotations

from functools import cache

import mujoco
import numpy as np
from builders.scenes import jumble

import mjframes as mf
from benchmarks.stability.states import jacobian
from mjframes.body.soft_body import SoftBody
from mjframes.scene.plugin_text import decode

SHAPE, SPACING = (24, 7, 8), 0.005
CAVITY = (slice(3, 21), slice(2, 5), slice(4, 7))
CENTRE = (0.06, 0.0175, 0.0275)  # a point of the cavity [m]
LOW = [(x, 0.0175, 0.006) for x in (0.004, 0.03, 0.06, 0.09, 0.116)]  # a path along the side that is far from it
STENCIL = {-2: 1 / 12, -1: -2 / 3, 1: 2 / 3, 2: -1 / 12}  # of a slope, to the fourth order
EMPTY_SPACE = "<mujoco><option gravity='0 0 0'/><worldbody/></mujoco>"


@cache
def hollow(label: int = 0) -> mf.Volume:
    """The bar; label: of the cavity."""
    labels = np.ones(SHAPE, np.uint8)
    labels[CAVITY] = label
    return mf.Volume.from_labels(labels, SPACING, {1: mf.Material(2e5, 0.4, 1000), 2: mf.Material(1e5, 0.4, 1000)})


@cache
def hollow_body(frames: int = 5, law: str = "corotational", held: bool = True, types: str = "affine") -> SoftBody:
    supports = mf.Fixed(hollow().side("-x")) if held else ()
    return mf.build(hollow(), frames, law=law, supports=supports, frame_type=types)


def actuated(
    body: SoftBody, tendons: dict[str, mf.Chamber | mf.Fibre | mf.Muscle], xml: str = EMPTY_SPACE, contact: bool = False
) -> mujoco.MjSpec:
    """A scene with the body, a motor and a sensor of the length on each tendon."""
    spec = mujoco.MjSpec.from_string(xml)
    mf.attach(spec, body, "bar", tendons=tendons, contact=contact)
    for name in tendons:
        spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_TENDON)
        spec.add_sensor(
            name=name, type=mujoco.mjtSensor.mjSENS_TENDONPOS, objtype=mujoco.mjtObj.mjOBJ_TENDON, objname=name
        )
    return spec


def row(model: mujoco.MjModel, data: mujoco.MjData, name: str) -> np.ndarray:
    """(nv,) the Jacobian of a tendon."""
    tendon, dense = model.tendon(name).id, np.zeros(model.nv)
    entries = slice(model.ten_J_rowadr[tendon], model.ten_J_rowadr[tendon] + model.ten_J_rownnz[tendon])
    dense[model.ten_J_colind[entries]] = data.ten_J[entries]
    return dense


def slope(model: mujoco.MjModel, data: mujoco.MjData, name: str, way: np.ndarray) -> float:
    """d length / dt of a tendon where qvel is `way`, by differences."""
    at, total, step = data.qpos.copy(), 0.0, 5e-6
    for times, share in STENCIL.items():
        mujoco.mj_integratePos(model, data.qpos, way, times * step)
        mujoco.mj_forward(model, data)
        total += share * data.tendon(name).length[0] / step
        data.qpos[:] = at
    mujoco.mj_forward(model, data)
    return total


def check_virtual_work(spec: mujoco.MjSpec, names: list[str], length: float = 0.003) -> None:
    model = spec.compile()
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    for _ in range(3):
        jumble(model, data, rng, length, 0.3)
        for name in names:
            way = rng.normal(size=model.nv)
            along = row(model, data, name)
            error = slope(model, data, name, way) - along @ way
            assert abs(error) < 1e-8 * np.linalg.norm(along) * np.linalg.norm(way), (name, error)


def corrected(spec: mujoco.MjSpec, name: str, x: np.ndarray, rest: np.ndarray, slope: str = "pair_slope") -> float:
    """Σ c (|x_i − x_j| − |x̄_i − x̄_j|), or Σ b with slope="pair_growth"."""
    config = next(dict(other.config) for other in spec.plugins if other.name == name)
    i, j = decode(config["pair"]).reshape(-1, 2).T
    change = np.linalg.norm(x[i] - x[j], axis=1) - np.linalg.norm(rest[i] - rest[j], axis=1)
    return float(decode(config[slope]) @ change)


def check_momentum(spec: mujoco.MjSpec, forces: dict[str, float]) -> None:
    """Tendons within a free body pull at no common motion, and forces on them move no centre of mass."""
    model = spec.compile()
    data = mujoco.MjData(model)
    rng = np.random.default_rng(2)
    for _ in range(3):
        jumble(model, data, rng, 0.003, 0.3)
        view = mf.soft(model, data, "bar")
        x = view.control_positions
        for velocity in [*np.eye(3)[:, None] + 0 * x, *(np.cross(axis, x) for axis in np.eye(3))]:
            way = np.linalg.lstsq(jacobian(view), velocity.ravel(), rcond=None)[0]
            for name in forces:
                along = row(model, data, name)
                assert abs(along @ way) < 1e-12 * np.linalg.norm(along) * np.linalg.norm(way)
    mujoco.mj_resetData(model, data)
    data.ctrl[:] = list(forces.values())
    force = 0.0
    for _ in range(500):
        mujoco.mj_step(model, data)
        force += model.opt.timestep * np.abs(data.qfrc_actuator).sum()
    mujoco.mj_forward(model, data)
    view = mf.soft(model, data, "bar")
    assert np.abs(view.mass @ view.control_velocities).max() < 1e-12 * force
    assert data.qpos.any()
