"""Small soft bodies in scenes, and the same physics in dense matrices, from `elasticity.corotational`."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest
from builders.shapes import mixed

from mjframes.body.build import build
from mjframes.body.soft_body import SoftBody
from mjframes.frames.supports import Fixed
from mjframes.scene.attach import attach
from mjframes.scene.contact import Contact
from mjframes.scene.taxels import TaxelGrid, add_taxels
from mjframes.scene.view import Soft, soft, soft_names
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

FLOOR = '<mujoco><worldbody><geom name="floor" type="plane" size="1 1 .1"/></worldbody></mujoco>'
TILTED = (0.9, 0.3, -0.2, 0.25)


@cache
def lump(alpha: float = 0.0, beta: float = 0.0, method: str = "whole_body") -> SoftBody:
    """Three materials, two bones and a hole; four frames, one below the other; large regions."""
    return build(mixed(), 4, method=method, damping=(alpha, beta))


@cache
def beam(young: float = 2e4, alpha: float = 0.0, beta: float = 0.0, method: str = "whole_body") -> SoftBody:
    """0.24 m along x, two layers; five frames in a tree with two branches."""
    labels = np.ones((24, 4, 4), int)
    labels[:, 2:] = 2
    labels[10:14, 1:3, 1:3] = 3
    materials = {
        1: Material(young, 0.4, 1000),
        2: Material(3 * young, 0.3, 1100),
        3: Material(40 * young, 0.3, 1900),
    }
    return build(Volume.from_labels(labels, 0.01, materials), 5, method=method, damping=(alpha, beta))


def in_space(body: SoftBody) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The body alone, without gravity, turned; contact left out."""
    weightless = "<mujoco><option gravity='0 0 0'/></mujoco>"
    return compiled(weightless, (body, (0.1, 0.2, 0.3), TILTED), contact=False)


def compiled(
    xml: str,
    *bodies: tuple[SoftBody, tuple[float, ...], tuple[float, ...]],
    contact: bool | Contact = True,
    parent: str = "world",
    **options: object,
) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """A scene with soft bodies at (pos, quat) of `parent`, named soft0, soft1, …; `options` of the simulation."""
    spec = mujoco.MjSpec.from_string(xml)
    for key, value in options.items():
        setattr(spec.option, key, value)
    for number, (body, pos, quat) in enumerate(bodies):
        if body.links or parent == "world":
            attach(spec, body, f"soft{number}", parent, pos=pos, quat=quat, contact=contact)
        else:
            attach_free(spec.body(parent), body, f"soft{number}", pos, quat, contact)
    model = spec.compile()
    return model, mujoco.MjData(model)


def attach_free(
    parent: mujoco.MjsBody,
    body: SoftBody,
    name: str,
    pos: tuple[float, ...] = (0.0, 0.0, 0.0),
    quat: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0),
    contact: bool | Contact = True,
) -> None:
    """Below `parent` though it moves and holds nothing of the body, where `attach` would put it below the world."""
    own = mujoco.MjSpec()
    attach(own, body, name[2:], pos=pos, quat=quat, contact=contact)
    parent.add_frame().attach_body(own.worldbody.first_body(), name[:2], "")


def point_jacobian(model: mujoco.MjModel, data: mujoco.MjData, view: Soft) -> np.ndarray:
    """∂x/∂q (3k, nv) of the control points, without what moves all of them alike; needs mj_forward."""
    jacobian = np.zeros((len(view.bodies), 3, model.nv))
    for j, (body, x) in enumerate(zip(view.bodies, view.control_positions, strict=True)):
        mujoco.mj_jac(model, data, jacobian[j], None, x, int(body))
    moved = np.array([[_is_below(model, int(body), int(model.dof_bodyid[a])) for a in range(model.nv)]
                      for body in view.bodies])  # fmt: skip
    moved &= ~np.isin(model.dof_bodyid, view.bodies)  # the soft body's own degrees of freedom stay
    jacobian[:, :, moved.all(axis=0)] = 0
    return jacobian.reshape(-1, model.nv)


def _is_below(model: mujoco.MjModel, body: int, upper: int) -> bool:
    while body > upper:
        body = int(model.body_parentid[body])
    return body == upper


def point_mass(model: mujoco.MjModel, data: mujoco.MjData, view: Soft) -> np.ndarray:
    """(nv, nv) inertia of the soft body's own mass."""
    jacobian = point_jacobian(model, data, view)
    mass = np.diag(view.mass)
    for points, difference in view.mass_difference:
        mass[np.ix_(points, points)] += difference
    return jacobian.T @ np.kron(mass, np.eye(3)) @ jacobian


def elasticity(model: mujoco.MjModel, data: mujoco.MjData, view: Soft) -> tuple[np.ndarray, np.ndarray]:
    """Elastic force (nv,) and stiffness (nv, nv) in MuJoCo's coordinates, region by region; needs mj_forward."""
    x = view.control_positions
    force, stiffness = np.zeros(x.size), np.zeros((x.size, x.size))
    for region in view.regions:
        f, k = region.response(x[region.points])
        rows = (3 * region.points[:, None] + np.arange(3)).ravel()
        force[rows] += f.ravel()
        stiffness[np.ix_(rows, rows)] += k
    jacobian = point_jacobian(model, data, view)
    return jacobian.T @ force, jacobian.T @ stiffness @ jacobian


def turning_stiffness(model: mujoco.MjModel, data: mujoco.MjData, view: Soft) -> np.ndarray:
    """(nv, nv) of the rotations of what carries control points; zero where some of them ride at a body's origin.

    Σ_j sym(r gᵀ) − (g·r) I of each with the magnitudes of its eigenvalues: g = −f, r from the origin of the closest
    body with joints.
    """
    x, force = view.control_positions, np.zeros((len(view.bodies), 3))
    for region in view.regions:
        force[region.points] += region.response(x[region.points])[0]
    nodes = np.array([_with_joints(model, int(body)) for body in view.bodies])
    common = ~point_jacobian(model, data, view).any(axis=0)  # what moves all points
    stiffness = np.zeros((model.nv, model.nv))
    for node in set(nodes[nodes > 0].tolist()):
        own = nodes == node
        arm, f = x[own] - data.xpos[node], force[own]
        if np.abs(arm).max() < 1e-9:
            return np.zeros((model.nv, model.nv))
        second = -arm.T @ f
        values, vectors = np.linalg.eigh((second + second.T) / 2 - np.trace(second) * np.eye(3))
        rotation = np.zeros((3, model.nv))
        mujoco.mj_jacBody(model, data, None, rotation, node)
        rotation[:, common] = 0
        stiffness += rotation.T @ (vectors * np.abs(values)) @ vectors.T @ rotation
    return stiffness


def _with_joints(model: mujoco.MjModel, body: int) -> int:
    while body > 0 and model.body_dofnum[body] == 0:
        body = int(model.body_parentid[body])
    return body


def implicit_step(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[np.ndarray, np.ndarray]:
    """What the plugin has to add, of all soft bodies: to qfrc_passive (nv,) and to M (nv, nv). Equation (7).

    In the latter K has what forces on frames that turn add.
    """
    h, v = model.opt.timestep, data.qvel
    passive, inertia = np.zeros(model.nv), np.zeros((model.nv, model.nv))
    for name in soft_names(model):
        view = soft(model, data, name)
        alpha, beta = float(view.configuration["alpha"]), float(view.configuration["beta"])
        force, stiffness = elasticity(model, data, view)
        mass = point_mass(model, data, view)
        passive += force - (h + beta) * stiffness @ v - alpha * mass @ v - bias_of_mass(model, data, view)
        stiffness += turning_stiffness(model, data, view)
        inertia += (h**2 + h * beta) * stiffness + h * alpha * mass
    return passive, inertia + unknown_mass(model, data)


def unknown_mass(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Jᵀ D J (nv, nv) of all soft bodies: the mass that MuJoCo does not know of."""
    inertia = np.zeros((model.nv, model.nv))
    for name in soft_names(model):
        view = soft(model, data, name)
        jacobian = point_jacobian(model, data, view)
        inertia += point_mass(model, data, view) - jacobian.T @ (np.repeat(view.mass, 3)[:, None] * jacobian)
    return inertia


def bias_of_mass(model: mujoco.MjModel, data: mujoco.MjData, view: Soft) -> np.ndarray:
    """Jᵀ D dJ/dt qvel (nv,) of the mass that MuJoCo does not know of, from MuJoCo's own accelerations at qacc = 0."""
    moving, gravity = data.qacc.copy(), model.opt.gravity.copy()
    model.opt.gravity[:], data.qacc[:] = 0, 0
    mujoco.mj_rnePostConstraint(model, data)
    model.opt.gravity[:], data.qacc[:] = gravity, moving
    acceleration, spatial, velocity = np.zeros((len(view.bodies), 3)), np.zeros(6), np.zeros(6)
    for j, (body, x) in enumerate(zip(view.bodies, view.control_positions, strict=True)):
        mujoco.mj_objectAcceleration(model, data, mujoco.mjtObj.mjOBJ_XBODY, int(body), spatial, 0)
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, int(body), velocity, 0)
        arm, spin = x - data.xpos[body], velocity[:3]
        acceleration[j] = spatial[3:] + np.cross(spatial[:3], arm) + np.cross(spin, np.cross(spin, arm))
    force = np.zeros_like(acceleration)
    for points, difference in view.mass_difference:
        force[points] += difference @ acceleration[points]
    return point_jacobian(model, data, view).T @ force.ravel()


def rigid_inertia(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """M (nv, nv) of all bodies, from their Jacobians; needs mj_forward."""
    inertia = np.diag(model.dof_armature)
    for body in range(1, model.nbody):
        translation, rotation = np.zeros((2, 3, model.nv))
        mujoco.mj_jacBodyCom(model, data, translation, rotation, body)
        turn = data.ximat[body].reshape(3, 3)
        inertia += model.body_mass[body] * translation.T @ translation
        inertia += rotation.T @ turn @ np.diag(model.body_inertia[body]) @ turn.T @ rotation
    return inertia


def dense_inertia(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """d->M (nv, nv)."""
    inertia = np.zeros((model.nv, model.nv))
    row = np.repeat(np.arange(model.nv), model.M_rownnz)
    inertia[row, model.M_colind] = inertia[model.M_colind, row] = data.M
    return inertia


def dense_constraints(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """efc_J (nefc, nv)."""
    if not mujoco.mj_isSparse(model):
        return data.efc_J.reshape(data.nefc, model.nv).copy()
    jacobian = np.zeros((data.nefc, model.nv))
    for i in range(data.nefc):
        entries = slice(data.efc_J_rowadr[i], data.efc_J_rowadr[i] + data.efc_J_rownnz[i])
        jacobian[i, data.efc_J_colind[entries]] = data.efc_J[entries]
    return jacobian


def dofs(model: mujoco.MjModel, view: Soft) -> np.ndarray:
    """(k, 3) degrees of freedom of control points that have slides of their own."""
    return model.jnt_dofadr[model.body_jntadr[view.bodies]][:, None] + np.arange(3)


def coordinates(model: mujoco.MjModel, view: Soft) -> np.ndarray:
    """(k, 3) places of a soft body's coordinates in qpos."""
    return model.jnt_qposadr[model.body_jntadr[view.bodies]][:, None] + np.arange(3)


def move_points(model: mujoco.MjModel, data: mujoco.MjData, view: Soft, x: np.ndarray) -> None:
    """Set qpos so that the control points come to x (k, 3) in the world [m]."""
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    jacobian = point_jacobian(model, data, view)[:, dofs(model, view).ravel()]
    slide = np.linalg.solve(jacobian, (x - view.control_positions).ravel())
    data.qpos[coordinates(model, view)] += slide.reshape(-1, 3)


def distorted(rest: np.ndarray, rng: np.random.Generator, size: float = 0.3, mirrored: bool = False) -> np.ndarray:
    """x (k, 3): `rest` (k, 3) stretched, sheared, bent and crumpled, then turned about its middle by any angle."""
    middle, extent = rest.mean(axis=0), np.ptp(rest, axis=0).max()
    p = (rest - middle) / extent
    bent = p + size * (p @ rng.normal(size=(3, 3)) + (p**2) @ rng.normal(size=(3, 3)))
    crumpled = bent + 0.1 * size * rng.normal(size=p.shape)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.linalg.det(turn) * (-1 if mirrored else 1)
    return middle + extent * crumpled @ turn


def turned_over(x: np.ndarray, frame: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """x (k, 3) with the points of some of the frames (k,), any but all, mirrored at the frame's middle."""
    moved = x.copy()
    for i in rng.permutation(frame.max() + 1)[: rng.integers(1, frame.max() + 1)]:
        moved[frame == i] = 2 * x[frame == i].mean(axis=0) - x[frame == i]
    return moved


def distort(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    rng: np.random.Generator,
    speed: float = 0.0,
    mirrored: bool = False,
    over: bool = False,
) -> None:
    """A random state of every soft body, with random velocities of all degrees of freedom [m/s]; calls mj_forward.

    mirrored: all of it.  over: some of its frames, each for itself.
    """
    mujoco.mj_resetData(model, data)
    mujoco.mj_kinematics(model, data)
    for name in soft_names(model):
        view = soft(model, data, name)
        x = distorted(view.control_positions, rng, mirrored=mirrored)
        move_points(model, data, view, turned_over(x, view.body.control.frame, rng) if over else x)
    data.qvel[:] = speed * rng.normal(size=model.nv)
    mujoco.mj_forward(model, data)


def jumble(model: mujoco.MjModel, data: mujoco.MjData, rng: np.random.Generator, length: float, angle: float) -> None:
    """Random coordinates of any joints, ±length [m] of slides and ±angle of the others; calls mj_forward."""
    mujoco.mj_resetData(model, data)
    slides = model.jnt_type[model.dof_jntid] == mujoco.mjtJoint.mjJNT_SLIDE
    mujoco.mj_integratePos(model, data.qpos, rng.uniform(-1, 1, model.nv) * np.where(slides, length, angle), 1.0)
    mujoco.mj_forward(model, data)


def check_implicit_step(
    model: mujoco.MjModel, data: mujoco.MjData, rng: np.random.Generator, angle: float, rtol: float
) -> None:
    """In random states qfrc_passive and d->M are what the dense matrices of the implicit step say."""
    for _ in range(3):
        jumble(model, data, rng, 0.02, angle)
        data.qvel[:] = rng.normal(size=model.nv)
        mujoco.mj_forward(model, data)
        passive, added = implicit_step(model, data)
        np.testing.assert_allclose(data.qfrc_passive, passive, atol=rtol * np.abs(passive).max())
        expected = rigid_inertia(model, data) + added
        if np.linalg.eigvalsh(expected)[0] <= 0:  # nothing could be solved with it: the step goes by lumped masses
            expected -= unknown_mass(model, data)
        np.testing.assert_allclose(dense_inertia(model, data), expected, atol=rtol * np.abs(expected).max())


def check_slope_of_energy(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    rng: np.random.Generator,
    angle: float,
    states: int,
    length: float = 0.02,
) -> None:
    """In random states at rest qfrc_passive is minus the slope of the elastic energy of `soft0`, to 1e-6."""
    view = soft(model, data, "soft0")
    for _ in range(states):
        jumble(model, data, rng, length, angle)
        force, start = data.qfrc_passive.copy(), data.qpos.copy()
        direction, energy = rng.normal(size=model.nv), []
        for step in (1e-6, -1e-6):
            data.qpos[:] = start
            mujoco.mj_integratePos(model, data.qpos, direction, step)
            mujoco.mj_forward(model, data)
            energy.append(view.elastic_energy)
        close = 1e-9 * float(np.linalg.norm(force) * np.linalg.norm(direction))  # of two at right angles
        assert (energy[0] - energy[1]) / 2e-6 == pytest.approx(-force @ direction, rel=1e-6, abs=close)


def felt_block() -> mujoco.MjModel:
    """A ball on a glued block with 4 × 8 taxels, which feel pressure, shear and its centre."""
    volume = Volume.box((0.04, 0.04, 0.02), Material(1e5, 0.4, 1000), spacing=0.005)
    body = build(volume, 2, supports=Fixed(volume.side("-z")), damping=(0, 0.01))
    ball = '<body pos=".004 .01 .0205"><joint type="slide" axis="0 0 1"/><geom size=".01" mass=".05"/></body>'
    spec = mujoco.MjSpec.from_string(f"<mujoco><worldbody>{ball}</worldbody></mujoco>")
    attach(spec, body, "block")
    grid = TaxelGrid((0, 0, 0.01), (0, 0, 1), (0.016, 0.032), (4, 8), along=(1, 0, 0))
    for quantity in ("pressure", "traction", "pressure_centre"):
        add_taxels(spec, body, "block", grid, quantity)
    return spec.compile()


def prefixed(child: mujoco.MjSpec, folder: Path, **options: object) -> list[mujoco.MjModel]:
    """A scene with another in it, whose names get a prefix: compiled, read from its XML and from a binary file."""
    scene = mujoco.MjSpec.from_string("<mujoco><worldbody><frame name='place'/></worldbody></mujoco>")
    for key, value in options.items():
        setattr(scene.option, key, value)
    scene.attach(child, prefix="robot_", frame=scene.frame("place"))
    model = scene.compile()
    xml, binary = folder / "scene.xml", str(folder / "scene.mjb")
    xml.write_text(scene.to_xml())
    mujoco.mj_saveModel(model, binary)
    return [model, mujoco.MjModel.from_xml_path(str(xml)), mujoco.MjModel.from_binary_path(binary)]
