"""The mass matrix without elasticity: what kinetic energy is made of, and what controllers may ask for."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
import pytest
from builders.inertia import bodies, scene
from builders.scenes import dense_inertia

import mjframes as mf
from mjframes.app.measure import kinetic_energy
from mjframes.scene.view import soft, soft_names


@pytest.fixture(params=["slides", "frames that turn"])
def moving(request: pytest.FixtureRequest) -> tuple[mujoco.MjModel, mujoco.MjData]:
    return scene(*bodies(request.param))


Moving = tuple[mujoco.MjModel, mujoco.MjData]


def total_kinetic_energy(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    mujoco.mj_comVel(model, data)
    more = sum(float(soft(model, data, name).kinetic_difference) for name in soft_names(model))
    return kinetic_energy(model, data, data.qvel) + more


def test_it_gives_the_kinetic_energy_at_any_velocity(moving: Moving) -> None:
    model, data = moving
    mass, rng = mf.mass_matrix(model, data), np.random.default_rng(0)
    np.testing.assert_allclose(mass, mass.T, atol=1e-12 * np.abs(mass).max())
    for _ in range(5):
        data.qvel[:] = rng.normal(size=model.nv)
        assert 0.5 * data.qvel @ mass @ data.qvel == pytest.approx(total_kinetic_energy(model, data), rel=1e-9)
    assert np.abs(dense_inertia(model, data) - mass).max() > 1e-4 * np.abs(mass).max()  # the step's has elasticity


def energy(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    mujoco.mj_energyVel(model, data)
    return float(data.energy[1])


def by_full_matrix(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    return 0.5 * float(data.qvel @ mass @ data.qvel)


def by_solving(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    momentum, velocity = mf.mass_matrix(model, data) @ data.qvel, np.zeros((1, model.nv))
    mujoco.mj_solveM(model, data, velocity, momentum[None])
    return 0.5 * float(velocity[0] @ momentum)


@pytest.mark.parametrize("read", [energy, by_full_matrix, by_solving])
def test_what_reads_the_inertia_gets_the_rigid_one_inside(
    moving: Moving, read: Callable[[mujoco.MjModel, mujoco.MjData], float]
) -> None:
    model, data = moving
    expected = total_kinetic_energy(model, data)
    before = data.M.copy(), data.qLD.copy(), data.qLDiagInv.copy()
    assert read(model, data) != pytest.approx(expected, rel=1e-3)
    with mf.rigid_inertia(model, data):
        assert read(model, data) == pytest.approx(expected, rel=1e-8)
    for kept, now in zip(before, (data.M, data.qLD, data.qLDiagInv), strict=True):
        np.testing.assert_array_equal(kept, now)
