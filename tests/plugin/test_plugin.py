"""One mj_step is the dense linearly implicit step of equation (7), forces of contact and all."""

from __future__ import annotations

import copy
from dataclasses import replace
from functools import cache, partial
from itertools import product

import mujoco
import numpy as np
import pytest
from builders.scenes import (
    TILTED,
    beam,
    compiled,
    dense_constraints,
    dense_inertia,
    distort,
    implicit_step,
    in_space,
    lump,
    point_jacobian,
    rigid_inertia,
)
from builders.tiers import thinned

from mjframes.body.soft_body import SoftBody
from mjframes.elasticity.corotational import FOLDED, CorotationalRegion
from mjframes.scene.view import Soft, soft, soft_names

BODIES = {
    "deep tree": lump,
    "branched tree": beam,
    "the paper's regions": partial(beam, method="paper"),
}

# A soft beam lies across a free box, a free lid on the beam; a soft lump lies beside them, all on one floor.
PILE = """
<mujoco>
  <option timestep="0.002"/>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 .1"/>
    <body pos="0.12 0.02 0.02"><freejoint/><geom name="box" type="box" size=".03 .06 .02" mass=".5"/></body>
    <body pos="0.14 0.02 .0975"><freejoint/><geom name="lid" type="box" size=".02 .02 .01" mass=".1" condim="6"/></body>
  </worldbody>
</mujoco>
"""
# A soft body on a moving arm, one beside it with other damping.
ARM = """
<mujoco>
  <worldbody>
    <body name="arm" pos="0 0 .5">
      <joint axis="0 1 0"/><joint type="slide" axis="1 0 0"/><geom size=".05" mass="1" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.fixture(params=BODIES, ids=str)
def body(request: pytest.FixtureRequest) -> SoftBody:
    return BODIES[request.param](alpha=0.7, beta=0.004)


def assert_close(actual: np.ndarray, expected: np.ndarray, tolerance: float = 1e-10) -> None:
    """To `tolerance` of the largest expected value."""
    np.testing.assert_allclose(actual, expected, rtol=0, atol=tolerance * np.abs(expected).max())


def test_bodies_have_the_trees_they_are_named_after() -> None:
    parents = {name: np.bincount(make().parent[1:]).max() for name, make in BODIES.items()}
    assert parents == {"deep tree": 1, "branched tree": 2, "the paper's regions": 2}


def test_rest_is_free_of_force(body: SoftBody) -> None:
    model, data = in_space(body)
    mujoco.mj_forward(model, data)
    firmness = np.abs(implicit_step(model, data)[1]).max() / model.opt.timestep**2
    assert np.abs(data.qfrc_passive).max() < 1e-12 * firmness * np.ptp(body.control.rest)


def folded(view: Soft) -> bool:
    """Whether a region's gradient has an eigenvalue below `FOLDED`."""
    x, found = view.control_positions, False
    for region in view.regions:
        assert isinstance(region, CorotationalRegion)
        S = (x[region.points] @ region.rotation(x[region.points])).T @ region.gradient
        found = found or np.linalg.eigvalsh(S + S.T)[0] < 2 * FOLDED
    return bool(found)


def pressed(view: Soft) -> bool:
    """Whether a region is pressed so far that it gets stiffer."""
    for region in view.regions:
        assert isinstance(region, CorotationalRegion)
        x = view.control_positions[region.points]
        y = (x - x.mean(axis=0)) @ region.rotation(x) - region.rest + region.rest.mean(axis=0)
        if region.pressed.at(region.pressed.slope @ y.ravel())[2].any():
            return True
    return False


@pytest.mark.parametrize(
    "how",
    [
        {},
        pytest.param({"mirrored": True}, marks=pytest.mark.slow),
        pytest.param({"over": True}, marks=pytest.mark.slow),
    ],
    ids=["bent", "mirrored", "turned over"],
)
def test_force_and_inertia_are_those_of_the_implicit_step(body: SoftBody, how: dict[str, bool]) -> None:
    model, data = in_space(body)
    view = soft(model, data, "soft0")
    rng = np.random.default_rng(0)
    flat, small = [], []
    for speed in [0.0, 3.0] * 10:  # at rest the energy's gradient; then with the implicit step's and Rayleigh's damping
        distort(model, data, rng, speed, **how)
        passive, added = implicit_step(model, data)
        assert_close(data.qfrc_passive, passive)
        assert_close(dense_inertia(model, data), rigid_inertia(model, data) + added)
        flat.append(folded(view))
        small.append(pressed(view))
    assert any(flat) if how else not all(flat)
    assert any(small) == (body.error is not None)  # the paper's regions get no stiffer


def test_inertia_is_factored(body: SoftBody) -> None:
    model, data = in_space(body)
    distort(model, data, np.random.default_rng(3))
    random = np.random.default_rng(3).normal(size=model.nv)
    solution = np.zeros((1, model.nv))
    mujoco.mj_solveM(model, data, solution, random[None])
    assert_close(dense_inertia(model, data) @ solution[0], random, 1e-8)


def test_internal_forces_are_balanced(body: SoftBody) -> None:
    damped = replace(body, damping=(0.0, 0.004))
    model, data = in_space(damped)
    view = soft(model, data, "soft0")
    rng = np.random.default_rng(4)
    for number in range(30):  # at rest; then with the implicit step's and Rayleigh's damping
        distort(model, data, rng, 3.0 * (number % 2), over=number % 3 == 0)
        # of each point's own force, which MuJoCo's coordinates mix: qfrc = Jᵀ f
        force = np.linalg.solve(point_jacobian(model, data, view).T, data.qfrc_passive).reshape(-1, 3)
        arm = view.control_positions - view.control_positions.mean(axis=0)
        size = np.abs(force).sum()
        assert np.abs(force.sum(axis=0)).max() < 1e-10 * size
        assert np.abs(np.cross(arm, force).sum(axis=0)).max() < 1e-10 * size * np.abs(arm).max()


def test_two_soft_bodies_and_a_moving_parent() -> None:
    model, data = compiled(
        ARM, (lump(0.7, 0.004), (0.1, 0, 0), TILTED), (beam(beta=0.001), (0, 0.3, 0.1), (1, 0, 0, 0)), parent="arm"
    )
    rng = np.random.default_rng(5)
    assert soft_names(model) == ["soft0", "soft1"]
    for _ in range(5):
        distort(model, data, rng)
        data.qpos[:2] = rng.normal(size=2)
        data.qvel[2:] = rng.normal(size=model.nv - 2)  # the arm at rest: α damps what moves against the arm
        mujoco.mj_forward(model, data)
        passive, inertia = implicit_step(model, data)
        # no torque on the arm: elastic forces are internal
        assert_close(data.qfrc_passive[2:], passive[2:])
        np.testing.assert_array_equal(data.qfrc_passive[:2], 0)
        assert_close(dense_inertia(model, data)[2:, 2:], (rigid_inertia(model, data) + inertia)[2:, 2:])


def pile() -> tuple[mujoco.MjModel, np.ndarray]:
    """The pile and the state in which it has come to lie, the soft bodies still shaking."""
    model, state = settled_pile()
    return copy.copy(model), state


@cache
def settled_pile() -> tuple[mujoco.MjModel, np.ndarray]:
    model, data = compiled(
        PILE, (beam(), (0, 0, 0.045), (1, 0, 0, 0)), (lump(0.5, 0.001), (0.3, 0.1, -0.3), (1, 0, 0, 0))
    )
    for _ in range(150):
        mujoco.mj_step(model, data)
    data.qvel[:12] = 0  # implicit integrators add what MuJoCo knows of the rigid bodies' gyroscopic forces
    model.opt.tolerance, model.opt.iterations = 0, 1000
    model.opt.ls_tolerance, model.opt.ls_iterations = 1e-12, 200
    return model, whole_state(model, data)


def whole_state(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """All that the next step depends on."""
    state = np.zeros(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_INTEGRATION))
    mujoco.mj_getState(model, data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
    return state


def restored(model: mujoco.MjModel, state: np.ndarray) -> mujoco.MjData:
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
    return data


def test_the_pile_has_every_kind_of_contact() -> None:
    model, state = pile()
    data = restored(model, state)
    mujoco.mj_forward(model, data)
    touching = {(model.geom(c.geom[0]).name, model.geom(c.geom[1]).name.split(":")[0]) for c in data.contact}
    assert touching == {("floor", "box"), ("floor", "soft1"), ("box", "soft0"), ("lid", "soft0")}
    assert np.abs(data.qvel).max() > 0.05


SCHEMES = product(
    ("EULER", "IMPLICITFAST", "IMPLICIT", "DISCRETE"),
    ("NEWTON", "CG"),
    ("DENSE", "SPARSE"),
    ("PYRAMIDAL", "ELLIPTIC"),
    (True, False),
)


@pytest.mark.parametrize(("integrator", "solver", "jacobian", "cone", "islands"), thinned(SCHEMES, 9))
def test_one_step_is_the_dense_implicit_one(
    integrator: str, solver: str, jacobian: str, cone: str, islands: bool
) -> None:
    model, state = pile()
    model.opt.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator}")
    model.opt.solver = getattr(mujoco.mjtSolver, f"mjSOL_{solver}")
    model.opt.jacobian = getattr(mujoco.mjtJacobian, f"mjJAC_{jacobian}")
    model.opt.cone = getattr(mujoco.mjtCone, f"mjCONE_{cone}")
    model.opt.disableflags = 0 if islands else int(mujoco.mjtDisableBit.mjDSBL_ISLAND)
    data = restored(model, state)
    mujoco.mj_forward(model, data)
    passive, added = implicit_step(model, data)
    effective = rigid_inertia(model, data) + added
    before = data.qvel.copy()

    mujoco.mj_step(model, data)

    acceleration = (data.qvel - before) / model.opt.timestep
    jacobian_t = dense_constraints(model, data).T
    contact = jacobian_t @ data.efc_force
    error = effective @ acceleration - (passive - data.qfrc_bias + contact)
    assert (data.nisland > 1) == islands
    assert np.abs(error).max() < 1e-10 * np.abs(contact).max()
    # and the forces are those that the constraints ask for at this acceleration
    force = data.efc_force.copy()
    mujoco.mj_constraintUpdate(model, data, jacobian_t.T @ acceleration - data.efc_aref, None, 0)
    assert_close(data.efc_force, force, 1e-9 if solver == "CG" else 1e-10)  # where its search along lines ends


def test_a_second_forward_gives_the_same_bits() -> None:
    model, state = pile()
    data = restored(model, state)
    fields = ("qfrc_passive", "M", "qLD", "efc_J", "efc_R", "efc_D", "efc_aref", "qacc_smooth")
    mujoco.mj_forward(model, data)
    first = {field: getattr(data, field).copy() for field in fields}
    mujoco.mj_forward(model, data)
    for field in fields:
        np.testing.assert_array_equal(getattr(data, field), first[field], field)
    # the velocity stage alone, which mjd_transitionFD repeats
    mujoco.mj_forwardSkip(model, data, mujoco.mjtStage.mjSTAGE_POS, 0)
    for field in fields:
        np.testing.assert_array_equal(getattr(data, field), first[field], field)


def test_transition_derivatives_are_those_of_the_step() -> None:
    model, data = in_space(beam(beta=0.001))
    distort(model, data, np.random.default_rng(6), speed=0.1)
    state = whole_state(model, data)
    n, step = 2 * model.nv, 1e-6
    derivative = np.zeros((n, n))
    mujoco.mjd_transitionFD(model, data, step, True, derivative, None, None, None)
    np.testing.assert_array_equal(whole_state(model, data), state)

    def after(change: np.ndarray) -> np.ndarray:
        moved = restored(model, state)
        moved.qpos[:] += change[: model.nv]
        moved.qvel[:] += change[model.nv :]
        mujoco.mj_step(model, moved)
        return np.concatenate([moved.qpos, moved.qvel])

    columns = [(after(step * e) - after(-step * e)) / (2 * step) for e in np.eye(n)]
    assert_close(derivative, np.transpose(columns), 1e-7)
