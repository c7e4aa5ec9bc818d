"""Views: what they say of a soft body is what MuJoCo's state says."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import pytest
from builders.scenes import (
    FLOOR,
    TILTED,
    beam,
    compiled,
    distort,
    dofs,
    elasticity,
    in_space,
    lump,
    move_points,
    point_jacobian,
    point_mass,
)
from scipy.spatial.transform import Rotation

import mjframes as mf
from mjframes.base.errors import MjframesError
from mjframes.elasticity.corotational import CorotationalRegion
from mjframes.scene.view import soft, soft_names


def test_names_are_those_of_the_soft_bodies() -> None:
    model, data = compiled(FLOOR, (lump(), (0, 0, 1), TILTED), (beam(), (1, 0, 1), TILTED))
    assert soft_names(model) == ["soft0", "soft1"]
    assert soft_names(compiled(FLOOR)[0]) == []
    with pytest.raises(MjframesError, match=r"name is 'soft' but the model's soft bodies are: 'soft0', 'soft1'\."):
        soft(model, data, "soft")
    with pytest.raises(MjframesError, match=r"are: none\."):
        soft(*compiled(FLOOR), "soft")


def test_a_state_of_another_model_is_refused() -> None:
    model, data = compiled(FLOOR, (lump(), (0, 0, 1), TILTED))
    other = compiled(FLOOR)[1]
    takers: list[Callable[[Any, Any], Any]] = [
        lambda model, data: mf.soft(model, data, "soft0"),
        lambda model, data: mf.place(model, data, "soft0", (0, 0, 1)),
        mf.mass_matrix,
        mf.still,
    ]
    for take in takers:
        with pytest.raises(MjframesError, match=r"^data is of another model: it has 1 bodies, .*; give mujoco\.MjData"):
            take(model, other)
        with pytest.raises(MjframesError, match=r"^data is a NoneType; give the MjData of the model\.$"):
            take(model, None)
        with pytest.raises(MjframesError, match=r"^model is a MjData; give the MjModel"):
            take(data, model)
    assert mf.soft(copy.copy(model), data, "soft0").name == "soft0"


def test_a_view_holds_what_was_built() -> None:
    model, data = compiled(FLOOR, (lump(), (0, 0, 1), TILTED), (beam(0.3, 0.04), (1, 0, 1), TILTED))
    for name, body in {"soft0": lump(), "soft1": beam(0.3, 0.04)}.items():
        view = soft(model, data, name)
        np.testing.assert_allclose(view.rest, body.control.rest, atol=1e-6)
        np.testing.assert_allclose(model.body_mass[view.bodies], body.control.mass, rtol=1e-5)
        assert (float(view.configuration["alpha"]), float(view.configuration["beta"])) == body.damping
        assert len(view.regions) == len(body.stiffness.points)
        for e, region in enumerate(view.regions):
            assert isinstance(region, CorotationalRegion)
            points, gradient, matrix = region.points, region.gradient, region.stiffness
            np.testing.assert_array_equal(points, body.stiffness.points[e])
            np.testing.assert_allclose(gradient, body.stiffness.gradient[e], atol=1e-5 * np.abs(gradient).max())
            np.testing.assert_allclose(view.rest[points].T @ gradient, np.eye(3), atol=1e-12)
            np.testing.assert_allclose(matrix, body.stiffness.matrix[e], rtol=1e-12, atol=1e-12 * np.abs(matrix).max())


def test_dofs_move_the_points() -> None:
    model, data = in_space(beam())
    view = soft(model, data, "soft0")
    mujoco.mj_forward(model, data)
    jacobian = point_jacobian(model, data, view).reshape(len(view.bodies), 3, model.nv)
    for j, own in enumerate(dofs(model, view)):
        assert np.linalg.matrix_rank(jacobian[j][:, own]) == 3
        assert not np.any(jacobian[j][:, dofs(model, view)[j + 1 :].ravel()])


def test_rest_has_no_energy_wherever_it_is() -> None:
    model, data = in_space(lump())
    view = soft(model, data, "soft0")
    mujoco.mj_kinematics(model, data)
    rest = view.control_positions
    move_points(model, data, view, rest @ Rotation.from_rotvec([1, 2, -3]).as_matrix().T + [3, -1, 2])
    mujoco.mj_forward(model, data)
    moved = view.elastic_energy
    move_points(model, data, view, 1.01 * rest)
    mujoco.mj_forward(model, data)
    assert 0 <= moved < 1e-15 * view.elastic_energy


def test_elastic_forces_are_the_plugins() -> None:
    model, data = in_space(beam())
    view = soft(model, data, "soft0")
    distort(model, data, np.random.default_rng(0))
    np.testing.assert_allclose(
        point_jacobian(model, data, view).T @ view.elastic_forces.ravel(),
        data.qfrc_passive,
        atol=1e-9 * np.abs(data.qfrc_passive).max(),
    )


def test_elastic_energy_is_the_work_done_against_the_plugin() -> None:
    model, data = in_space(beam())
    view = soft(model, data, "soft0")
    distort(model, data, np.random.default_rng(1))
    direction, step, energy = np.random.default_rng(2).normal(size=model.nv), 1e-7, []
    force = data.qfrc_passive.copy()
    start = data.qpos.copy()
    for sign in (1, -1):
        data.qpos[:] = start + sign * step * direction
        mujoco.mj_forward(model, data)
        energy.append(view.elastic_energy)
    assert (energy[0] - energy[1]) / (2 * step) == pytest.approx(-force @ direction, rel=1e-6)


def test_kinetic_energy_is_that_of_the_masses() -> None:
    model, data = in_space(lump())
    view = soft(model, data, "soft0")
    distort(model, data, np.random.default_rng(3), speed=2.0)
    expected = 0.5 * data.qvel @ point_mass(model, data, view) @ data.qvel
    assert view.kinetic_energy == pytest.approx(expected, rel=1e-12)


def test_a_view_is_current_after_a_step() -> None:
    model, data = compiled(FLOOR, (beam(), (0, 0, 0.5), TILTED))
    view = soft(model, data, "soft0")
    mujoco.mj_forward(model, data)
    before = view.control_positions
    for _ in range(10):
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    fall = view.control_positions - before
    np.testing.assert_allclose(fall, np.tile([0, 0, -9.81 * 0.002**2 * 55], (len(fall), 1)), atol=1e-9)
    assert elasticity(model, data, view)[0].shape == (model.nv,)
