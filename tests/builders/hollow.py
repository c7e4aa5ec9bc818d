"""A bar with a closed cavity, and the scenes that its tendons are tried in."""

from __future__ import annotations

from functools import cache

import mujoco
import numpy as np

import mjframes as mf
from mjframes.body.soft_body import SoftBody

SHAPE, SPACING = (24, 7, 8), 0.005
CAVITY = (slice(3, 21), slice(2, 5), slice(4, 7))
CENTRE = (0.06, 0.0175, 0.0275)  # a point of the cavity [m]
LOW = [(x, 0.0175, 0.006) for x in (0.004, 0.03, 0.06, 0.09, 0.116)]  # a path along the side that is far from it
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
    body: SoftBody, tendons: dict[str, mf.Chamber | mf.Fibre], xml: str = EMPTY_SPACE, contact: bool = False
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
