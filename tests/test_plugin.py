"""One mj_step is the dense linearly implicit step of equation (7), forces of contact and all."""

from __future__ import annotations

from functools import cache

import mujoco
import numpy as np
import pytest
from scenes import (
    TILTED,
    beam,
    compiled,
    dense_constraints,
    dense_inertia,
    distort,
    implicit_step,
    in_space,
    lump,
    rigid_inertia,
)

from mjframes.body import SoftBody
from mjframes.view import soft, soft_names

BODIES = {"deep tree": lump, "branched tree": beam}

# A beam across a free box on the floor and a free ball on the beam; a second soft body beside them.
PILE = """
<mujoco>
  <option timestep="0.002"/>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 .1"/>
    <body pos="0.05 0.02 0.02"><freejoint/><geom name="box" type="box" size=".03 .06 .02" mass=".5"/></body>
    <body name="ball" pos="0.13 0.02 0.105"><freejoint/><geom type="sphere" size=".02" mass=".05" condim="6"/></body>
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
    assert parents == {"deep tree": 1, "branched tree": 2}


def test_rest_is_free_of_force(body: SoftBody) -> None:
    model, data = in_space(body)
    mujoco.mj_forward(model, data)
    firmness = np.abs(implicit_step(model, data)[1]).max() / model.opt.timestep**2
    assert np.abs(data.qfrc_passive).max() < 1e-12 * firmness * np.ptp(body.control.rest)


def test_passive_force_is_the_energys_gradient(body: SoftBody) -> None:
    model, data = in_space(body)
    rng = np.random.default_rng(0)
    for _ in range(20):
        distort(model, data, rng)
        assert_close(data.qfrc_passive, implicit_step(model, data)[0])


def test_velocities_add_the_implicit_and_rayleighs_damping(body: SoftBody) -> None:
    model, data = in_space(body)
    rng = np.random.default_rng(1)
    for _ in range(20):
        distort(model, data, rng, speed=3.0)
        assert_close(data.qfrc_passive, implicit_step(model, data)[0])


def test_inertia_is_that_of_the_implicit_step(body: SoftBody) -> None:
    model, data = in_space(body)
    rng = np.random.default_rng(2)
    for _ in range(20):
        distort(model, data, rng)
        assert_close(dense_inertia(model, data), rigid_inertia(model, data) + implicit_step(model, data)[1])


def test_inertia_is_factored(body: SoftBody) -> None:
    model, data = in_space(body)
    distort(model, data, np.random.default_rng(3))
    random = np.random.default_rng(3).normal(size=model.nv)
    solution = np.zeros((1, model.nv))
    mujoco.mj_solveM(model, data, solution, random[None])
    assert_close(dense_inertia(model, data) @ solution[0], random, 1e-8)


def test_internal_forces_are_balanced(body: SoftBody) -> None:
    model, data = in_space(body, timestep=1e-3)
    view = soft(model, data, "soft0")
    rng = np.random.default_rng(4)
    model.body_mass[:] = 0  # M α v is no internal force
    for _ in range(20):
        distort(model, data, rng)
        velocity = np.zeros(model.nv)
        for _ in range(2):  # at rest, then with the implicit and Rayleigh's βK forces
            data.qvel[:] = velocity
            mujoco.mj_forward(model, data)
            # moving the first point takes all with it: its slides feel the net force; a turn is a velocity field
            force = data.qfrc_passive
            arm = view.control_positions - view.control_positions.mean(axis=0)
            size = np.abs(force).sum()
            for axis in np.eye(3):
                for field in (np.tile(axis, (len(arm), 1)), np.cross(axis, arm) / np.abs(arm).max()):
                    assert abs(force @ rates(model, data, field)) < 1e-10 * size
            velocity = rng.normal(size=model.nv)


def rates(model: mujoco.MjModel, data: mujoco.MjData, field: np.ndarray) -> np.ndarray:
    """qvel (nv,) that moves the control points with velocities `field` (k, 3) in the world."""
    from scenes import point_jacobian

    return np.linalg.solve(point_jacobian(model, data, soft(model, data, "soft0").bodies), field.ravel())


def test_two_soft_bodies_and_a_moving_parent() -> None:
    model, data = compiled(
        ARM, (lump(0.7, 0.004), (0.1, 0, 0), TILTED), (beam(), (0, 0.3, 0.1), (1, 0, 0, 0)), parent="arm"
    )
    rng = np.random.default_rng(5)
    assert soft_names(model) == ["soft0", "soft1"]
    for _ in range(5):
        distort(model, data, rng)
        data.qvel[2:] = rng.normal(size=model.nv - 2)  # damping is relative to the parent
        data.qpos[:2] = rng.normal(size=2)
        mujoco.mj_forward(model, data)
        passive, inertia = implicit_step(model, data)
        assert_close(data.qfrc_passive[2:], passive[2:])
        assert_close(dense_inertia(model, data)[2:, 2:], (rigid_inertia(model, data) + inertia)[2:, 2:])
        assert_close(data.qfrc_passive[:2], 0 * passive[:2] + data.qfrc_passive[:2])
