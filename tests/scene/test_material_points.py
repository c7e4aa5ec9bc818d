"""Views of material points and frames: positions, F, stress, energy, and the forces on frames."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from builders.lengthwise import LAWS, MATERIAL, block, centers
from builders.linked import scene
from builders.scenes import FLOOR, TILTED, beam, compiled, distort, distorted, in_space, jumble, lump, move_points

import mjframes as mf
from mjframes.base.errors import MjframesError
from mjframes.elasticity.corotational import CorotationalRegion
from mjframes.scene import forces, identity
from mjframes.scene.material_points import material_points
from mjframes.scene.view import Soft
from mjframes.volume.grid import voxel_grid


def axes(data: mujoco.MjData, view: Soft) -> np.ndarray:
    return data.xmat[view.holder].reshape(3, 3)


@pytest.mark.parametrize("body", [beam(), lump()], ids=["beam", "lump"])
def test_rest_is_where_the_body_was_put_and_free_of_stress(body: mf.SoftBody) -> None:
    model, data = in_space(body)
    view = mf.soft(model, data, "soft0")
    mujoco.mj_forward(model, data)
    points = centers(body)
    np.testing.assert_allclose(view.positions(points), data.xpos[view.holder] + points @ axes(data, view).T, atol=1e-14)
    np.testing.assert_allclose(view.deformation_gradients(points), np.tile(axes(data, view), (len(points), 1, 1)),
                               atol=1e-12)  # fmt: skip
    assert np.abs(view.strains(points)).max() < 1e-12
    stiffest = max(2 * material.lame[1] for material in voxel_grid(body.fields.volume).table)
    assert np.abs(view.stresses(points)).max() < 1e-11 * stiffest
    assert not view.velocities(points).any()


@pytest.mark.parametrize("law", LAWS)
def test_a_turn_is_no_strain(law: str) -> None:
    model, data = in_space(block(law))
    view = mf.soft(model, data, "soft0")
    mujoco.mj_kinematics(model, data)
    turn, _ = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))
    turn *= np.linalg.det(turn)
    move_points(model, data, view, view.rest @ turn.T + [1, 2, 3])
    mujoco.mj_forward(model, data)
    points = centers(block(law))
    F = view.deformation_gradients(points)
    np.testing.assert_allclose(F, np.tile(turn, (len(points), 1, 1)), atol=1e-12)
    assert np.abs(view.stresses(points)).max() < 1e-11 * MATERIAL.young


def test_material_points_are_those_of_the_skin() -> None:
    """By the paper's method; else the skin goes without the modes that points have."""
    made = lump(method="paper")
    model, data = in_space(made)
    view = mf.soft(model, data, "soft0")
    distort(model, data, np.random.default_rng(0), speed=1.0)
    skin = made.skin
    size = np.ptp(skin.vertices, axis=0).max()
    np.testing.assert_allclose(view.positions(skin.vertices), skin.weights @ view.control_positions, atol=1e-5 * size)


@pytest.mark.parametrize("law", LAWS)
def test_uniform_strain_has_the_stress_and_energy_of_the_law(law: str) -> None:
    body = block(law)
    model, data = in_space(body)
    view = mf.soft(model, data, "soft0")
    mujoco.mj_kinematics(model, data)
    turn = axes(data, view)
    stretch = np.diag([1.2, 0.9, 1.05])
    twist, _ = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))
    twist *= np.linalg.det(twist)
    F = twist @ stretch
    move_points(model, data, view, view.rest @ F.T @ turn.T + [1, 2, 3])
    mujoco.mj_forward(model, data)
    points = centers(body)
    np.testing.assert_allclose(view.deformation_gradients(points), np.tile(turn @ F, (len(points), 1, 1)), atol=1e-9)
    np.testing.assert_allclose(view.positions(points), points @ F.T @ turn.T + [1, 2, 3], atol=1e-9)
    np.testing.assert_allclose(view.strains(points)[0], (F.T @ F - np.eye(3)) / 2, atol=1e-9)
    density, stress = view.energy_densities(points), view.stresses(points)
    volume = 0.12 * 0.04**2
    np.testing.assert_allclose(density, view.elastic_energy / volume, rtol=1e-6)  # six digits of rest
    if law == "corotational":
        lam, mu = MATERIAL.lame
        strain = np.diag(stretch) - 1
        principal = lam * strain.sum() + 2 * mu * strain
        assert density[0] == pytest.approx(lam / 2 * strain.sum() ** 2 + mu * strain @ strain, rel=1e-9)
    else:  # virtual work: J σ n·n = ∂ψ/∂s s for a further stretch s along a principal direction
        principal, step = np.empty(3), 1e-5
        for a in range(3):
            energy = []
            for sign in (1, -1):
                move_points(model, data, view, view.rest @ (twist @ stretch @ np.diag(1 + sign * step * np.eye(3)[a])).T
                            @ turn.T)  # fmt: skip
                mujoco.mj_forward(model, data)
                energy.append(view.elastic_energy)
            principal[a] = (energy[0] - energy[1]) / (2 * step) / volume / np.linalg.det(stretch)
    expected = turn @ twist @ np.diag(principal) @ twist.T @ turn.T
    np.testing.assert_allclose(stress, np.tile(expected, (len(points), 1, 1)), atol=1e-7 * np.abs(expected).max())


@pytest.mark.parametrize("frame_type", ["affine", "quadratic", "point", ("rigid", "affine", "quadratic")])
def test_densities_sum_up_to_the_elastic_energy(frame_type: str) -> None:
    body = block(frame_type=frame_type)
    model, data = in_space(body)
    view = mf.soft(model, data, "soft0")
    jumble(model, data, np.random.default_rng(1), 0.02, 0.5)
    strained = (
        0.0  # without what keeps rotations determined and frames from folding, which is no strain of the material
    )
    for region in view.regions:
        assert isinstance(region, CorotationalRegion)
        x = view.control_positions[region.points]
        y = ((x - x.mean(axis=0)) @ region.rotation(x) - region.rest + region.rest.mean(axis=0)).ravel()
        strained += 0.5 * float(y @ region.stiffness @ y)
    assert 0 < strained <= view.elastic_energy
    assert view.energy_densities(centers(body)).sum() * 0.01**3 == pytest.approx(strained, rel=1e-6)


@pytest.mark.parametrize("frame_type", ["affine", "quadratic", "point"])
def test_deformation_gradients_are_slopes_of_positions(frame_type: str) -> None:
    volume = mf.Volume.from_labels(np.ones((12, 4, 4), int), 0.01, {1: MATERIAL})
    ends = [(0.015, 0.02, 0.02), (0.105, 0.02, 0.02)]
    body = mf.build(volume, at=ends, frame_type=frame_type, weights="linear", method="paper")
    rng, step, rest = np.random.default_rng(5), 1e-5, body.control.rest
    x = distorted(rest, rng)

    def positions(points: np.ndarray) -> np.ndarray:
        at = material_points(body, rest, points)
        return at.weights @ x + at.offset

    points = rng.uniform((0.03, 0, 0), (0.09, 0.04, 0.04), (50, 3))  # between the kinks of the hats
    slope = np.stack([(positions(points + step * e) - positions(points - step * e)) / (2 * step)
                      for e in np.eye(3)], axis=2)  # fmt: skip
    at = material_points(body, rest, points)
    F = at.deformation_gradients(mf.soft(*in_space(body), "soft0").regions, x)
    np.testing.assert_allclose(F, slope, atol=1e-8 * np.abs(F).max())


def test_lifted_deformation_gradients_are_differences_of_positions() -> None:
    """Of neighbouring voxels, those of the same material and frames: two layers, ten to one, sheared and bent."""
    labels = np.ones((24, 6, 6), int)
    labels[:, 3:] = 2
    held = np.zeros(labels.shape, bool)
    held[0] = True
    materials = {1: MATERIAL, 2: mf.Material(young=1e6, poisson=0.3, density=1000)}
    volume = mf.Volume.from_labels(labels, 0.01, materials)
    body = mf.build(volume, 3, supports=[mf.Fixed(held)])
    model, data = in_space(body)
    data.xfrc_applied[1:, 2] = -1.0
    mujoco.mj_step(model, data, 200)
    mujoco.mj_forward(model, data)
    view, step = mf.soft(model, data, "soft0"), 0.01 * np.eye(3)
    points = centers(body)[(np.abs(centers(body) - [0.12, 0.03, 0.045]) < [0.1, 0.015, 0.01]).all(axis=1)]
    slope = np.stack([(view.positions(points + e) - view.positions(points - e)) / 0.02 for e in step], axis=2)
    F = view.deformation_gradients(points)
    strain = np.abs(F - np.eye(3)).max()
    assert strain > 0.01
    assert np.median(np.abs(F - slope).max(axis=(1, 2))) < 0.02 * strain


@pytest.mark.parametrize("case", ["all types", "all types, two links of one branch", "mocap body and a link"])
def test_velocities_are_rates_of_positions(case: str) -> None:
    model, data = scene(case)
    view = mf.soft(model, data, "soft0")
    jumble(model, data, np.random.default_rng(6), 0.01, 0.3)
    data.qvel[:] = np.random.default_rng(7).normal(size=model.nv)
    mujoco.mj_forward(model, data)
    points = centers(view.body)[::7]
    velocity, start, found = view.velocities(points), data.qpos.copy(), []
    for time in (1e-6, -1e-6):
        data.qpos[:] = start
        mujoco.mj_integratePos(model, data.qpos, data.qvel, time)
        mujoco.mj_kinematics(model, data)
        found.append(view.positions(points))
    np.testing.assert_allclose(velocity, (found[0] - found[1]) / 2e-6, atol=1e-7 * np.abs(velocity).max())


def test_inverted_material_has_finite_stress() -> None:
    model, data = in_space(block("neo_hookean"))
    view = mf.soft(model, data, "soft0")
    mujoco.mj_kinematics(model, data)
    move_points(model, data, view, distorted(view.control_positions, np.random.default_rng(0), mirrored=True))
    mujoco.mj_forward(model, data)
    assert np.isfinite(view.stresses(centers(block("neo_hookean")))).all()


@pytest.mark.parametrize(
    ("points", "words"),
    [
        ([[0.06, 0.02, 0.0551]], r"points\[0\] is \(0.06, 0.02, 0.0551\), 1.5 voxels outside the volume"),
        ([[0.06, 0.02, 0.02], [9, 9, 9]], r"points\[1\]"),
        ([0.06, 0.02, 0.02], r"shape \(3,\)"),
        ([[np.nan, 0, 0]], "finite"),
    ],
)
def test_points_that_are_none_of_the_material_are_refused(points: list, words: str) -> None:
    view = mf.soft(*in_space(block()), "soft0")
    with pytest.raises(MjframesError, match=words):
        view.positions(points)


def test_no_points_have_no_stress() -> None:
    view = mf.soft(*in_space(block()), "soft0")
    assert view.stresses(np.zeros((0, 3))).shape == (0, 3, 3)


def test_the_body_is_found_or_asked_for(tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    model, data = in_space(block())
    mujoco.mj_forward(model, data)
    block().save(str(tmp_path / "block.npz"))
    loaded = mf.SoftBody.load(str(tmp_path / "block.npz"))
    expected = mf.soft(model, data, "soft0").positions([[0.06, 0.02, 0.02]])
    monkeypatch.setattr(identity, "_known", {})
    with pytest.raises(MjframesError, match=r"or is gone; keep it, and give it: soft\(model, data, 'soft0', body=…\)"):
        mf.soft(model, data, "soft0").positions([[0.06, 0.02, 0.02]])
    given = mf.soft(model, data, "soft0", body=loaded).positions([[0.06, 0.02, 0.02]])
    np.testing.assert_allclose(given, expected, atol=1e-12)
    with pytest.raises(MjframesError, match="body is not the one that 'soft0' was made of"):
        mf.soft(model, data, "soft0", body=block(weights="linear"))


@pytest.mark.parametrize("frame_type", ["affine", ("rigid", "affine", "rigid")])
@pytest.mark.parametrize("cone", ["elliptic", "pyramidal"])
def test_the_forces_on_each_frame_of_a_body_that_lies_are_balanced(frame_type: str, cone: str) -> None:
    body = block(frame_type=frame_type, damping=(2.0, 0.005))
    model, data = compiled(
        FLOOR, (body, (0, 0, 0.001), (1, 0, 0, 0)), cone=getattr(mujoco.mjtCone, f"mjCONE_{cone.upper()}")
    )
    view = mf.soft(model, data, "soft0")
    for _ in range(2000):
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    weight = -9.81 * view.mass.sum()
    gravity = -9.81 * np.bincount(body.control.frame, view.mass)
    contact = view.contact_forces
    np.testing.assert_allclose(contact[:, 2].sum(), -weight, rtol=1e-6)
    np.testing.assert_allclose(contact.sum(axis=0), view.patch_forces.sum(axis=0), atol=1e-10)
    np.testing.assert_allclose(contact, view.constraint_forces, atol=1e-10)
    total = view.frame_forces + contact + gravity[:, None] * [0, 0, 1]
    assert np.abs(total).max() < 1e-5 * -weight
    assert np.abs(view.frame_forces).max() > 1e-3 * -weight


@pytest.mark.parametrize("condim", [1, 3, 4, 6])
@pytest.mark.parametrize("cone", ["elliptic", "pyramidal"])
def test_the_forces_on_patches_are_those_of_mujoco(cone: str, condim: int) -> None:
    """One block slides and turns on the floor, another one on it."""
    places = [(block(), (0, 0, -0.001), (1, 0, 0, 0)), (block(), (0.02, 0, 0.038), (1, 0, 0, 0.1))]
    touch = mf.Contact(condim=condim, friction=(0.5, 0.01, 0.01), priority=1)
    model, data = compiled(FLOOR, *places, contact=touch, cone=getattr(mujoco.mjtCone, f"mjCONE_{cone.upper()}"))
    mujoco.mj_step(model, data, nstep=50)
    data.qvel[:] = np.random.default_rng(0).normal(size=model.nv, scale=0.02)
    mujoco.mj_forward(model, data)
    for name in ("soft0", "soft1"):
        view = mf.soft(model, data, name)
        expected = np.zeros((len(view.patches), 3))
        for one in forces.touches_of(model, data, view.patches):
            expected[view.patches == one.geom] += one.force
        assert np.abs(expected).max() > 0.01
        np.testing.assert_allclose(view.patch_forces, expected, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("ends", [(0,), (0, -1)], ids=["one", "two"])
def test_contact_forces_count_on_held_frames_too(ends: tuple[int, ...]) -> None:
    masks = [np.zeros((12, 4, 4), bool) for _ in ends]
    for mask, end in zip(masks, ends, strict=True):
        mask[end] = True
    body = block(supports=tuple(mf.Fixed(mask) for mask in masks))
    model, data = compiled(FLOOR, (body, (0, 0, -0.001), (1, 0, 0, 0)))
    view = mf.soft(model, data, "soft0")
    for _ in range(50):
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    found, held = view.contact_forces, len(ends)
    assert (found[:held, 2] > 0.01 * found[:, 2].sum()).all()
    np.testing.assert_allclose(found.sum(axis=0), view.patch_forces.sum(axis=0), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found[held:], view.constraint_forces[held:], atol=1e-9)
    assert np.isnan(view.constraint_forces[:held]).all()
    if held == 2:  # the ends are pressed alike, but touch at other points
        assert (found[:2, 2] > 0.2 * found[:, 2].sum()).all()


def test_contact_forces_turn_with_the_body() -> None:
    model, data = compiled(FLOOR, (beam(), (0, 0, 0.05), TILTED))
    view = mf.soft(model, data, "soft0")
    seen = False
    for _ in range(200):
        mujoco.mj_step(model, data)
        seen = seen or data.ncon > 1
        np.testing.assert_allclose(view.contact_forces.sum(axis=0), view.patch_forces.sum(axis=0), atol=1e-8)
    assert seen
