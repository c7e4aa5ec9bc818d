"""Hyperelastic laws of the whole body: at rest its own stiffness, in large strains the law, rotations free of force."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import product

import mujoco
import numpy as np
import pytest
from builders.scenes import distorted, in_space
from builders.shapes import mixed
from builders.tiers import thinned, tiered
from scipy import sparse
from scipy.sparse.linalg import spsolve
from scipy.spatial.transform import Rotation

import mjframes as mf
from benchmarks.solids.bricks import bricks, internal_force, nodal_load
from mjframes.body.soft_body import SoftBody
from mjframes.elasticity.corotational import CorotationalRegion
from mjframes.elasticity.law_table import LAWS
from mjframes.elasticity.laws import hessian, law_of_constants, law_parameters, stress
from mjframes.scene.view import soft
from mjframes.volume.grid import voxel_grid

VOXEL, ACROSS, ALONG = 0.0125, 8, 40  # [m], [voxels]; one more layer, outside, is held
LENGTH, AREA = ALONG * VOXEL, (ACROSS * VOXEL) ** 2
YOUNG, DENSITY = 1e5, 1000.0
MOONEY = tiered(LAWS, lambda law: law != "mooney_rivlin")


@cache
def body(law: str) -> SoftBody:
    """Of three materials, with frames of all kinds that turn, the first of them held."""
    held = np.zeros(mixed().labels.shape, bool)
    held[:3] = True
    return mf.build(mixed(), 3, law=law, frame_type=("affine", "quadratic", "rigid"), supports=[mf.Fixed(held)])


@cache
def beam(law: str, poisson: float = 0.3, core: float = YOUNG) -> SoftBody:
    """Held at one end; core: Young's modulus of the middle half [Pa]."""
    return mf.build(beam_volume(poisson, core), 5, law=law, supports=[mf.Fixed(end_layer())])


def beam_volume(poisson: float, core: float, coarser: int = 1) -> mf.Volume:
    across, voxel = ACROSS // coarser, VOXEL * coarser
    labels = np.ones((ALONG // coarser + 1, across, across), int)
    labels[:, :, across // 4 : -across // 4] = 2
    materials = {1: mf.Material(YOUNG, poisson, DENSITY), 2: mf.Material(core, poisson, DENSITY)}
    return mf.Volume.from_labels(labels, voxel, materials, origin=(-voxel, 0, 0))


def end_layer() -> np.ndarray:
    held = np.zeros((ALONG + 1, ACROSS, ACROSS), bool)
    held[0] = True
    return held


def regions(law: str) -> list[CorotationalRegion]:
    found = [some for some in soft(*in_space(body(law)), "soft0").regions if isinstance(some, CorotationalRegion)]
    assert [bool(region.cells) for region in found] == [True, True, True, False]  # the last keeps a bone in shape
    return found[:-1]


def assembled(made: SoftBody, matrices: list[np.ndarray] | tuple[np.ndarray, ...]) -> np.ndarray:
    total = np.zeros((3 * len(made.control.frame),) * 2)
    for points, matrix in zip(made.stiffness.points, matrices, strict=True):
        dof = (3 * points[:, None] + np.arange(3)).ravel()
        total[np.ix_(dof, dof)] += matrix
    return total


def cell_stiffness(made: SoftBody) -> list[np.ndarray]:
    """Σ_q V_q E_qᵀ C E_q of each region."""
    assert made.cells is not None
    tangent = [hessian(law_of_constants(made.law, c), np.eye(3)[None])[0] for c in made.law_constants.tolist()]
    parts = zip(made.cells.volume, made.cells.material, made.cells.slope, strict=True)
    return [
        sum((v * E.T @ tangent[n] @ E for v, n, E in zip(volume, number, slope, strict=True)), np.zeros(()))
        if len(volume)
        else np.zeros((slope.shape[2],) * 2)
        for volume, number, slope in parts
    ]


@pytest.mark.parametrize("law", thinned(product(LAWS), 2))
def test_at_rest_the_stiffness_is_that_of_the_whole_body(law: str) -> None:
    for made in (body(law), beam(law), beam(law, 0.49)):
        assert made.cells is not None
        total = assembled(made, made.stiffness.matrix)
        found = assembled(made, made.cells.remainder) + assembled(made, cell_stiffness(made))
        # pieces that are held, and rigid frames, are not strained
        moves = np.repeat(made.control.frame >= made.held, 3) & np.repeat(
            [made.types[i] != "rigid" for i in made.control.frame], 3
        )
        moves = np.ix_(moves, moves)
        np.testing.assert_allclose(found[moves], total[moves], atol=1e-9 * np.abs(total).max())


@pytest.mark.parametrize("law", thinned(product(LAWS), 2))
def test_what_remains_is_positive_and_the_law_has_most(law: str) -> None:
    made = beam(law)
    assert made.cells is not None
    for matrix, remainder in zip(made.stiffness.matrix, made.cells.remainder, strict=True):
        assert np.linalg.eigvalsh(remainder)[0] > -1e-12 * np.abs(matrix).max()
    middle = ACROSS * VOXEL / 2
    strain = (made.control.rest - (0, middle, middle)) * (1, -0.3, -0.3)
    strain[made.control.frame < made.held] = 0
    energies = [
        strain.ravel() @ assembled(made, part) @ strain.ravel() for part in (cell_stiffness(made), made.cells.remainder)
    ]
    assert energies[0] > 4 * energies[1]


@pytest.mark.parametrize("law", MOONEY)
def test_force_is_the_slope_of_the_energy_and_balanced(law: str) -> None:
    rng = np.random.default_rng(0)
    for region in regions(law):
        size = np.ptp(region.rest, axis=0).max()
        for _ in range(20):
            x = distorted(region.rest, rng, 0.15)
            force = region.response(x)[0]
            assert np.abs(force.sum(axis=0)).max() < 1e-10 * np.abs(force).max()
            assert np.abs(np.cross(x - x.mean(axis=0), force).sum(axis=0)).max() < 1e-9 * np.abs(force).max() * size
            along = rng.normal(size=x.shape)
            ahead, behind = (region.energy(x + s * 1e-6 * size * along) for s in (1, -1))
            slope = (ahead - behind) / (2e-6 * size)
            assert abs(slope + np.sum(force * along)) < 1e-6 * np.linalg.norm(force) * np.linalg.norm(along)


@pytest.mark.parametrize("law", thinned(product(LAWS), 2))
def test_rotations_change_neither_energy_nor_force(law: str) -> None:
    rng = np.random.default_rng(1)
    for region in regions(law):
        x = distorted(region.rest, rng, 0.1)
        R = Rotation.from_rotvec([1, 2, -3]).as_matrix()
        assert region.energy(x @ R.T) == pytest.approx(region.energy(x), rel=1e-9)
        force = region.response(x)[0]
        np.testing.assert_allclose(region.response(x @ R.T)[0], force @ R.T, atol=1e-8 * np.abs(force).max())


@pytest.mark.parametrize("law", MOONEY)
def test_stiffness_of_a_step_is_positive_and_at_rest_the_slope_of_the_force(law: str) -> None:
    rng = np.random.default_rng(3)
    for region in regions(law):
        for x in (region.rest, distorted(region.rest, rng, 0.5), -region.rest):
            matrix = region.response(x)[1]
            assert np.linalg.eigvalsh(matrix)[0] > -1e-9 * np.abs(matrix).max()
        matrix, size = region.response(region.rest)[1], np.ptp(region.rest, axis=0).max()
        along = rng.normal(size=region.rest.shape)
        ahead, behind = (region.response(region.rest + s * 1e-6 * size * along)[0] for s in (1, -1))
        expected = -(matrix @ along.ravel()).reshape(-1, 3)
        np.testing.assert_allclose((ahead - behind) / (2e-6 * size), expected, atol=1e-5 * np.abs(expected).max())


def test_other_constants_are_those_of_the_whole_stiffness() -> None:
    stiffer = law_parameters("neo_hookean", mf.Material(2 * YOUNG, 0.4, DENSITY))
    given = {"mu": stiffer["mu"], "bulk": stiffer["bulk"]}
    held = [mf.Fixed(end_layer())]
    soft = beam_volume(0.3, YOUNG)
    same = {label: replace(material, law_constants=given) for label, material in soft.materials.items()}
    made = mf.build(replace(soft, materials=same), 3, law="neo_hookean", supports=held)
    material = mf.Material(2 * YOUNG, 0.4, DENSITY)
    labels = beam_volume(0.3, YOUNG).labels
    volume = mf.Volume.from_labels(labels, VOXEL, {1: material, 2: material}, origin=(-VOXEL, 0, 0))
    plain = mf.build(volume, 3, law="neo_hookean", supports=held)
    for found, expected in zip(made.stiffness.matrix, plain.stiffness.matrix, strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-4 * np.abs(expected).max())


def test_a_sheet_of_one_voxel_has_cells_free_of_stress_across_it() -> None:
    volume = mf.Volume.from_labels(np.ones((20, 10, 1), int), 0.01, {1: mf.Material(YOUNG, 0.4, DENSITY)})
    made = mf.build(volume, 3, law="neo_hookean")
    assert made.cells is not None
    total = assembled(made, made.cells.remainder) + assembled(made, cell_stiffness(made))
    expected = assembled(made, made.stiffness.matrix)
    np.testing.assert_allclose(total, expected, atol=1e-9 * np.abs(expected).max())
    assert sum(v.sum() for v in made.cells.volume) > 0.5 * len(volume.labels.nonzero()[0]) * 1e-6


def rested(made: SoftBody, gravity: float = 0.0, pull: float = 0.0) -> np.ndarray:
    """Mean displacement (3,) [m] of the end face at rest, under gravity along −z [m/s²] or a pull of the face [N]."""
    spec = mujoco.MjSpec()
    spec.option.timestep, spec.option.gravity = (0.01 if pull else 0.05), (0, 0, -gravity)  # implicit steps damp
    mf.attach(spec, made, "bar", contact=False)
    model = spec.compile()
    data = mujoco.MjData(model)
    view = soft(model, data, "bar")
    face = made.skin.vertices[:, 0] > LENGTH - 1e-6
    share = np.asarray(made.skin.weights[np.flatnonzero(face)].mean(axis=0)).ravel()
    data.xfrc_applied[view.bodies, 0] += pull * share
    mujoco.mj_step(model, data, nstep=3000)
    mujoco.mj_forward(model, data)
    assert np.abs(data.qvel).max() < 1e-4
    return (made.skin.weights @ view.control_positions - made.skin.vertices)[face].mean(axis=0)


@cache
def small_sag(core: float) -> float:
    """[m] per [m/s²] of the end face under the beam's own weight: quadratic bricks, four across."""
    grid = voxel_grid(beam_volume(0.3, core, 2))
    mesh = bricks(grid, grid.index[:, 0] == 0, 2, 1)
    weight = np.zeros((len(grid.index), 3))
    weight[grid.index[:, 0] > 0, 2] = -DENSITY * grid.cell_volume
    load, free, tip = nodal_load(mesh, weight), mesh.moving, mesh.nodes[:, 0] > mesh.nodes[:, 0].max() - 1e-9
    moved = np.zeros_like(mesh.nodes)
    _, tangent = internal_force(mesh, moved)
    assert tangent is not None
    moved.ravel()[free] = np.asarray(spsolve(sparse.csc_array(tangent[free][:, free]), load.ravel()[free]))
    return -np.average(moved[tip, 2], weights=np.bincount(mesh.element.ravel())[tip])


@pytest.mark.parametrize("core", [YOUNG, YOUNG / 10])
@pytest.mark.parametrize("law", thinned(product(LAWS), 2))
def test_a_beam_bends_as_finite_elements_say(law: str, core: float) -> None:
    assert -rested(beam(law, core=core), gravity=0.05)[2] / 0.05 == pytest.approx(small_sag(core), rel=0.05)


@pytest.mark.parametrize(("law", "stretch"), [(law, stretch) for law in LAWS for stretch in (1.3, 1.7)])
def test_a_bar_stretches_as_its_law_says(law: str, stretch: float) -> None:
    """Uniaxial: the sides are free of stress."""
    parameters = law_parameters(law, mf.Material(YOUNG, 0.3, DENSITY))  # pyright: ignore[reportArgumentType]
    across = np.linspace(0.5, 1, 10001)
    F = np.stack([np.diag([stretch, a, a]) for a in across])
    P = stress(parameters, F)
    pull = AREA * np.interp(0, P[:, 1, 1], P[:, 0, 0])
    assert rested(beam(law), pull=pull)[0] / LENGTH == pytest.approx(stretch - 1, rel=0.1)
