"""MuJoCo's solver starts from the solution of contacts and of all other rows, and finds next to nothing left to do."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
import pytest
from builders.scenes import beam

import mjframes as mf

ROBOT = """<mujoco><option jacobian="{}" solver="{}"/><worldbody><geom type="plane" size="2 2 .1"/>
<body name="arm" pos="0 0 .3"><joint name="swing" axis="0 1 0" range="-1 .1" limited="true" frictionloss=".01"/>
<geom type="capsule" fromto="0 0 0 .3 0 0" size=".02"/></body>
<body pos="1 1 .04"><freejoint/><geom type="box" size=".05 .05 .05"/></body></worldbody>
<actuator><motor joint="swing" ctrlrange="-1 1"/></actuator></mujoco>"""
WRIST = """<mujoco><option><flag island="{}"/></option><worldbody><geom type="plane" size="2 2 .1"/>
<body name="arm" pos="0 0 .3"><joint name="swing" axis="0 1 0" range="-1 .1" limited="true" frictionloss=".01"/>
<geom type="capsule" fromto="0 0 0 .3 0 0" size=".02"/>
<body pos=".32 0 0"><joint name="wrist" type="ball"/><geom type="box" size=".03 .02 .01"/></body></body></worldbody>
<actuator><orientation joint="wrist" kp=".05" kv=".001" input="{}"/>
<general joint="swing" dyntype="filter" dynprm=".1"/></actuator></mujoco>"""


# y, z of beams along x [m]
APART = ((-1.0, 0.02), (-0.5, 0.02))
STACK = ((-1.0, 0.02), (-1.0, 0.08))  # more rows than degrees of freedom
TOWER = (*STACK, (-1.0, 0.14), (-1.0, 0.20))  # rows between the upper two know nothing of the floor's
BRIDGE = ((-1.022, 0.02), (-0.978, 0.02), (-1.0, 0.08))  # nor those below one pier of the other's, but by the bridge


def falling(jacobian: str, solver: str, beams: Sequence[tuple[float, float]] = STACK) -> mujoco.MjModel:
    """Beams on a floor, and a robot at the limit of its joint: all rows but equalities."""
    spec = mujoco.MjSpec.from_string(ROBOT.format(jacobian, solver))
    for number, (y, z) in enumerate(beams):
        mf.attach(spec, beam(), f"beam{number}", pos=(1, y, z))
    return spec.compile()


@pytest.mark.parametrize("islands", [True, False], ids=["islands", "no islands"])
@pytest.mark.parametrize("jacobian", ["dense", "sparse"])
@pytest.mark.parametrize("solver", ["Newton", "CG"])
def test_mujocos_solver_has_next_to_nothing_left_to_do(jacobian: str, solver: str, islands: bool) -> None:
    model = falling(jacobian, solver, APART)
    model.opt.disableflags |= 0 if islands else mujoco.mjtDisableBit.mjDSBL_ISLAND
    data = mujoco.MjData(model)
    data.ctrl[0] = -0.3
    touched = iterated = 0
    for _ in range(120):
        data.xfrc_applied[model.nbody - 1, 0] = 0.01 * np.sin(data.time)
        mujoco.mj_step(model, data)
        touched += data.ncon
        iterated += bool(data.solver_niter.any())
    assert touched > 120
    assert iterated <= 2  # without it, in most steps


@pytest.mark.parametrize("beams", [STACK, TOWER, BRIDGE])
def test_it_is_the_solution_that_mujoco_finds_from_a_cold_start(beams: Sequence[tuple[float, float]]) -> None:
    model = falling("dense", "Newton", beams)
    data = mujoco.MjData(model)
    for _ in range(150):
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    assert not data.solver_niter.any()  # what was found before MuJoCo's solver is the solution
    warm, forces = data.qacc.copy(), data.efc_force.copy()
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_WARMSTART
    model.opt.tolerance = 0
    mujoco.mj_forward(model, data)
    assert data.solver_niter.any()
    np.testing.assert_allclose(warm, data.qacc, atol=1e-6 * np.abs(warm).max())
    np.testing.assert_allclose(forces, data.efc_force, atol=1e-6 * np.abs(forces).max())


def test_elliptic_cones_are_left_to_mujoco() -> None:
    model = falling("dense", "Newton")
    model.opt.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    data = mujoco.MjData(model)
    iterations = 0
    for _ in range(60):
        before = data.qacc_warmstart.copy()
        mujoco.mj_forward(model, data)
        iterations += data.solver_niter.sum()
        np.testing.assert_array_equal(data.qacc_warmstart, before)
        mujoco.mj_step(model, data)
    assert iterations > 0


@pytest.mark.parametrize("chart", ["expmap", "quat"])
def test_actuators_of_several_controls_push_what_it_starts_from(chart: str) -> None:
    """There are more controls than actuators."""
    model, data = wrist("enable", chart)
    assert model.nu > model.nactuator
    iterated = 0
    for _ in range(120):
        mujoco.mj_step(model, data)
        iterated += bool(data.solver_niter.any())
    assert data.nefc > 8
    assert iterated <= 6  # without it, in all of them


def wrist(islands: str, chart: str = "expmap") -> tuple[mujoco.MjModel, mujoco.MjData]:
    """A beam on a floor and an arm at the limit of its joint, whose wrist turns."""
    spec = mujoco.MjSpec.from_string(WRIST.format(islands, chart))
    mf.attach(spec, beam(), "beam", pos=(1, -1, 0.02))
    model = spec.compile()
    data = mujoco.MjData(model)
    data.ctrl[:3], data.ctrl[-1] = 0.3, -0.5
    return model, data


@pytest.mark.parametrize("islands", ["enable", "disable"])
def test_what_no_solver_follows_leaves_no_start_and_no_actuation(islands: str) -> None:
    model, data = wrist(islands)
    for _ in range(80):
        mujoco.mj_step(model, data)
    assert data.nefc > 8
    kept = {name: np.full_like(getattr(data, name), 0.25) for name in ("act_dot", "actuator_force", "qfrc_actuator")}
    kept["qacc_warmstart"] = data.qacc_warmstart + 0.5
    for stage in (mujoco.mj_inverse, mujoco.mj_fwdVelocity):
        for name, value in kept.items():
            getattr(data, name)[:] = value
        stage(model, data)
        for name, value in kept.items():
            if name == "qacc_warmstart" and stage is mujoco.mj_fwdVelocity:
                continue  # where the solver of mj_fwdConstraint starts
            np.testing.assert_array_equal(getattr(data, name), value, err_msg=f"{stage.__name__}, {name}")
