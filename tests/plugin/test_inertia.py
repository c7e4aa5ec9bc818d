"""d->M and its factors: the same however often they are computed, and those that MuJoCo's own functions would give."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
import pytest
from builders.inertia import ROBOTS, SCENES, bodies, scene
from builders.scenes import attach_free, beam, compiled, dense_inertia, implicit_step, rigid_inertia

import mjframes as mf


def state(data: mujoco.MjData) -> tuple[np.ndarray, ...]:
    return data.M.copy(), data.qLD.copy(), data.qLDiagInv.copy(), data.qacc.copy()


def check_same(one: Sequence[np.ndarray], other: Sequence[np.ndarray]) -> None:
    """Bit for bit."""
    for first, second in zip(one, other, strict=True):
        np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize("name", SCENES)
def test_computed_again_it_is_the_same(name: str) -> None:
    model, data = scene(*bodies(name))
    once = state(data)
    for _ in range(2):
        mujoco.mj_forwardSkip(model, data, mujoco.mjtStage.mjSTAGE_POS, 0)
        check_same(once, state(data))


@pytest.mark.parametrize("name", SCENES)
def test_a_copy_computes_the_same(name: str) -> None:
    model, data = scene(*bodies(name))
    once = state(data)
    copy = mujoco.MjData(model)
    mujoco.mj_step(model, copy)  # what it computed before must not matter
    mujoco.mj_copyData(copy, model, data)
    mujoco.mj_forwardSkip(model, copy, mujoco.mjtStage.mjSTAGE_POS, 0)
    check_same(once, state(copy))


@pytest.mark.parametrize("name", SCENES)
def test_inertia_and_factors_are_those_of_mujoco(name: str) -> None:
    model, data = scene(*bodies(name))
    expected = rigid_inertia(model, data) + implicit_step(model, data)[1]
    np.testing.assert_allclose(dense_inertia(model, data), expected, rtol=0, atol=1e-10 * np.abs(expected).max())
    _, factors, inverse, _ = state(data)
    mujoco.mj_factorM(model, data)
    np.testing.assert_allclose(factors, data.qLD, rtol=1e-9, atol=1e-12 * np.abs(data.qLD).max())
    np.testing.assert_allclose(inverse, data.qLDiagInv, rtol=1e-11)


def test_masses_and_armature_of_the_running_model_count() -> None:
    model, data = scene(beam(), beam())
    rng = np.random.default_rng(2)
    model.body_mass[1:] *= rng.uniform(0.5, 2, model.nbody - 1)
    model.dof_armature[:] = rng.uniform(0, 0.1, model.nv)
    mujoco.mj_forward(model, data)
    expected = rigid_inertia(model, data) + implicit_step(model, data)[1]
    np.testing.assert_allclose(dense_inertia(model, data), expected, rtol=0, atol=1e-10 * np.abs(expected).max())


@pytest.mark.parametrize("driver", ["joint", "joint, later", "tendon"])
def test_what_else_changes_the_inertia_of_slides_is_kept(driver: str) -> None:
    spec = mujoco.MjSpec.from_string(ROBOTS)
    attach_free(spec.body("hand"), beam(), "soft", contact=False)
    slides = [joint.name for joint in spec.joints if joint.name.startswith("soft")][:6]
    if driver == "tendon":
        tendon = spec.add_tendon(name="cord", armature=0.3)
        for number, name in enumerate(slides):
            tendon.wrap_joint(name, 1 + number)
        expected = 0.3 * np.outer(np.arange(1, 7), np.arange(1, 7))
    else:
        actuator = spec.add_actuator(target=slides[3], trntype=mujoco.mjtTrn.mjTRN_JOINT)
        actuator.armature = 0.0 if driver == "joint, later" else 0.2
        expected = np.diag([0, 0, 0, 0.2, 0, 0])
    model = spec.compile()
    data = mujoco.MjData(model)
    if driver == "joint, later":
        model.actuator_armature[:] = 0.2
        mujoco.mj_setConst(model, data)
    dofs = [model.joint(name).dofadr[0] for name in slides]
    for _ in range(2):
        mujoco.mj_forwardSkip(model, data, mujoco.mjtStage.mjSTAGE_NONE, 0)
        more = dense_inertia(model, data) - rigid_inertia(model, data) - implicit_step(model, data)[1]
        np.testing.assert_allclose(more[np.ix_(dofs, dofs)], expected, rtol=0, atol=1e-10 * np.abs(data.M).max())


def test_with_sleep_enabled_the_factors_are_those_of_mujoco() -> None:
    spec = mujoco.MjSpec.from_string(ROBOTS)
    spec.option.enableflags = mujoco.mjtEnableBit.mjENBL_SLEEP
    attach_free(spec.body("hand"), beam(), "soft", contact=False)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    expected = state(data)
    mujoco.mj_factorM(model, data)
    np.testing.assert_allclose(expected[1], data.qLD, rtol=1e-9, atol=1e-12 * np.abs(data.qLD).max())


@pytest.mark.slow
def test_it_is_positive_definite_in_far_states_of_bodies_that_hang_on_a_hinge() -> None:
    """Of the consistent masses MuJoCo's own matrix for the hinge does not know."""
    xml = """<mujoco><worldbody><body name="arm" pos="-.2 0 .2"><joint name="arm" axis="0 1 0" damping=".01"/>
      <geom type="capsule" fromto="0 0 0 -.1 0 0" size=".01" mass=".1"/></body></worldbody></mujoco>"""
    labels = np.ones((8, 4, 4), int)
    volume = mf.Volume.from_labels(labels, 0.01, {1: mf.Material(3e4, 0.4, 1000)})
    body = mf.build(volume, 3, supports=mf.Attached("arm", np.arange(8)[:, None, None] * labels < 1))
    model, data = compiled(xml, (body, (0, 0, 0.1), (1, 0, 0, 0)), contact=False)
    rng, lost = np.random.default_rng(0), 0
    for _ in range(100):
        mujoco.mj_resetData(model, data)
        mujoco.mj_integratePos(model, data.qpos, 0.1 * rng.normal(size=model.nv), 1.0)
        mujoco.mj_forward(model, data)
        lost += np.linalg.eigvalsh(rigid_inertia(model, data) + implicit_step(model, data)[1])[0] < 0
        assert np.linalg.eigvalsh(dense_inertia(model, data))[0] > 0
        assert (data.qLDiagInv > 0).all()
    assert lost > 0
