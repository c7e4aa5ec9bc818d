"""Control points on any body: forces and inertia are Jᵀ f and Jᵀ K J, for every frame type and what holds it."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from builders.linked import ARM, CASES, SPACING, bar, body, ends, scene
from builders.scenes import (
    check_implicit_step,
    check_slope_of_energy,
    compiled,
    dense_inertia,
    implicit_step,
    jumble,
    point_jacobian,
    point_mass,
    rigid_inertia,
)

import mjframes as mf
from mjframes.scene.attach import BranchWarning
from mjframes.scene.view import soft

METHODS = ("whole_body", "paper")


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("case", CASES)
def test_rest_is_free_of_force(case: str, method: str) -> None:
    model, data = scene(case, method)
    mujoco.mj_forward(model, data)
    rest = soft(model, data, "soft0").rest
    firmness = np.abs(implicit_step(model, data)[1]).max() / model.opt.timestep**2
    assert np.abs(data.qfrc_passive).max() < 1e-12 * firmness * np.ptp(rest)


@pytest.mark.parametrize("angle", [0.4, 3.0])
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("case", CASES)
def test_force_and_inertia_are_those_of_the_implicit_step(case: str, method: str, angle: float) -> None:
    rtol = 1e-10 if angle < 1 else 1e-7  # where frames are turned about, some regions hardly determine a rotation
    check_implicit_step(*scene(case, method), np.random.default_rng(0), angle, rtol)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("case", CASES)
def test_force_is_the_slope_of_the_energy(case: str, method: str) -> None:
    # frames that disagree have other forces; single points do not, and near their line they determine no rotation
    length = 0.004 if method == "whole_body" and case != "point" else 0.02
    check_slope_of_energy(*scene(case, method), np.random.default_rng(1), 0.4, 3, length)


@pytest.mark.parametrize("case", ["all types", "two links of one branch", "all types, two links of one branch"])
def test_kinetic_energy_is_that_of_the_masses(case: str) -> None:
    model, data = scene(case)
    view = soft(model, data, "soft0")
    jumble(model, data, np.random.default_rng(2), 0.02, 0.4)
    own = np.isin(model.dof_bodyid, view.bodies)
    data.qvel[own] = np.random.default_rng(3).normal(size=own.sum())
    mujoco.mj_forward(model, data)
    # MuJoCo's own inertia is that of the point masses: a rigid frame's body has the same moments
    points = 0.5 * view.mass @ (view.control_velocities**2).sum(axis=1)
    assert points == pytest.approx(0.5 * data.qvel @ rigid_inertia(model, data) @ data.qvel, rel=1e-4)
    assert points != pytest.approx(view.kinetic_energy, rel=1e-2)
    assert view.kinetic_energy == pytest.approx(0.5 * data.qvel @ point_mass(model, data, view) @ data.qvel, rel=1e-9)


def test_degrees_of_freedom() -> None:
    counts = {name: scene(name)[0].nv - 6 for name in ("point", "rigid", "affine", "quadratic", "all types")}
    assert counts == {"point": 12, "rigid": 24, "affine": 48, "quadratic": 120, "all types": 51}


@pytest.mark.parametrize("frame_type", ["point", "rigid", "affine"])
def test_one_frame_and_a_fixed_end(frame_type: str) -> None:
    made = mf.build(bar(), 1, frame_type=frame_type, supports=[mf.Fixed(ends(True))])
    model, data = compiled("<mujoco/>", (made, (0, 0, 0), (1, 0, 0, 0)), contact=False)
    jumble(model, data, np.random.default_rng(8), 0.01, 0.2)
    expected = rigid_inertia(model, data) + implicit_step(model, data)[1]
    np.testing.assert_allclose(dense_inertia(model, data), expected, atol=1e-10 * np.abs(expected).max())


@pytest.mark.parametrize("frame_type", ["point", "rigid"])
def test_one_frame_that_cannot_deform_is_refused(frame_type: str) -> None:
    with pytest.raises(mf.MjframesError, match=f"one '{frame_type}' frame cannot be deformed"):
        mf.build(bar(), 1, frame_type=frame_type)


def test_links_of_several_branches_are_held_enlarged() -> None:
    made = body("affine", ("lower", "other"), mass="lumped")
    with pytest.warns(BranchWarning, match=r"soft0: \d of \d regions couple 'other' to other branches"):
        model, data = compiled(ARM, (made, (0, 0, 0), (1, 0, 0, 0)), contact=False)
    view = soft(model, data, "soft0")
    rng = np.random.default_rng(4)
    jumble(model, data, rng, 0.02, 0.4)
    data.qvel[:] = rng.normal(size=model.nv)
    mujoco.mj_forward(model, data)
    passive, added = implicit_step(model, data)
    np.testing.assert_allclose(data.qfrc_passive, passive, atol=1e-10 * np.abs(passive).max())  # exact
    held = dense_inertia(model, data) - rigid_inertia(model, data)
    slack = np.linalg.eigvalsh(held - 0.75 * added)  # stable while K ⪯ 4/3 of what is held
    assert slack[0] > -1e-6 * slack[-1]
    jacobian = point_jacobian(model, data, view)
    assert np.linalg.matrix_rank(jacobian[:, :6]) > 3  # the arm and the other link both move points


def test_several_branches_come_to_rest() -> None:
    with pytest.warns(BranchWarning):
        stiff = compiled(
            ARM, (body("affine", ("lower", "other")), (0, 0, 0), (1, 0, 0, 0)), contact=False, timestep=0.005
        )
    model, data = stiff
    model.dof_damping[:6] = 0.05
    jumble(model, data, np.random.default_rng(5), 0.01, 0.2)
    view = soft(model, data, "soft0")
    start = view.elastic_energy
    for _ in range(4000):
        mujoco.mj_step(model, data)
    assert view.elastic_energy < 1e-6 * start
    assert np.abs(data.qvel).max() < 1e-3


@pytest.mark.parametrize("case", ["all types", "all types, two links of one branch"])
def test_saved_and_loaded_it_steps_alike(case: str) -> None:
    types, links, parent = CASES[case]
    spec = mujoco.MjSpec.from_string(ARM.replace("0 0 10", "0 0 0").replace("0 1 .2", "0 1 0"))  # of six digits
    mf.attach(spec, body(types, links), "soft", parent, contact=False)
    model = spec.compile()
    again = mujoco.MjModel.from_xml_string(spec.to_xml())
    states = []
    for some in (model, again):
        data = mujoco.MjData(some)
        data.qvel[:] = np.random.default_rng(6).normal(size=some.nv)
        mujoco.mj_step(some, data, 100)
        states.append(data.qpos.copy())
    np.testing.assert_array_equal(*states)


def test_a_link_that_is_missing_is_named() -> None:
    spec = mujoco.MjSpec.from_string(ARM)
    with pytest.raises(
        mf.MjframesError, match=r"attached names the body 'foot', but the bodies of the scene are: 'world', "
    ):
        mf.attach(spec, body("affine", ("foot",)), "soft")


@pytest.mark.parametrize("mass", ["lumped", "consistent"])
def test_consistent_mass_is_what_the_step_sees(mass: str) -> None:
    made = mf.build(bar(), 3, mass=mass, damping=(0.5, 0.0))
    model, data = compiled(ARM, (made, (0, 0, 0), (1, 0, 0, 0)), contact=False)
    view = soft(model, data, "soft0")
    mujoco.mj_forward(model, data)
    _, added = implicit_step(model, data)
    expected = rigid_inertia(model, data) + added
    np.testing.assert_allclose(dense_inertia(model, data), expected, atol=1e-10 * np.abs(expected).max())
    voxels = bar().labels.size * SPACING**3 * 1100
    assert view.mass.sum() == pytest.approx(voxels, rel=1e-4)
    for _, difference in view.mass_difference:
        np.testing.assert_allclose(difference.sum(axis=1), 0, atol=1e-12)


def test_explicit_mode_leaves_inertia_alone_and_allows_rk4() -> None:
    made = mf.build(bar(), 3, mode="explicit", mass="lumped")
    rk4 = mujoco.mjtIntegrator.mjINT_RK4
    model, data = compiled(ARM, (made, (0, 0, 0), (1, 0, 0, 0)), contact=False, integrator=rk4, timestep=1e-4)
    view = soft(model, data, "soft0")
    jumble(model, data, np.random.default_rng(7), 0.005, 0.0)
    np.testing.assert_allclose(dense_inertia(model, data), rigid_inertia(model, data), atol=1e-12)
    start = view.elastic_energy
    energies = []
    for _ in range(500):
        mujoco.mj_step(model, data)
        mujoco.mj_forward(model, data)
        energies.append(view.elastic_energy + view.kinetic_energy)
    np.testing.assert_allclose(energies, start, rtol=1e-4)
