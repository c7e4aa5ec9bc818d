"""MuJoCo's solver starts from the solution of contacts and of all other rows, and finds next to nothing left to do."""

from __future__ import annotations

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


def falling(jacobian: str, solver: str, apart: float = 0) -> mujoco.MjModel:
    """Two beams on a floor, one on the other or so far apart [m], and a robot at the limit of its joint: all rows but
    equalities. Beams on each other have more rows than degrees of freedom.
    """
    spec = mujoco.MjSpec.from_string(ROBOT.format(jacobian, solver))
    for number in range(2):
        mf.attach(spec, beam(), f"beam{number}", pos=(1, -1 + apart * number, 0.02 + (0 if apart else 0.06 * number)))
    return spec.compile()


@pytest.mark.parametrize("jacobian", ["dense", "sparse"])
@pytest.mark.parametrize("solver", ["Newton", "CG"])
def test_mujocos_solver_has_next_to_nothing_left_to_do(jacobian: str, solver: str) -> None:
    model = falling(jacobian, solver, apart=0.5)
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


def test_it_is_the_solution_that_mujoco_finds_from_a_cold_start() -> None:
    model = falling("dense", "Newton")
    data = mujoco.MjData(model)
    for _ in range(60):
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
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
