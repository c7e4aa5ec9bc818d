"""The whole body's stiffness: condensed exactly, split exactly on cliques, and an error that keeps its promise."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import product

import mujoco
import numpy as np
import pytest
from builders.scenes import compiled
from builders.solved import Solved, rigid, solved
from builders.solved import assembled as bricks_assembled
from builders.tiers import thinned
from scipy import sparse

import mjframes as mf
from mjframes.body.frames import Frames, place
from mjframes.body.options import BuildOptions
from mjframes.elasticity.shares import groups
from mjframes.finite_elements.element import CORNERS
from mjframes.finite_elements.solver import body_solver
from mjframes.kinematics.control import control_points, control_weights
from mjframes.scene.view import soft
from mjframes.volume.grid import evened, voxel_grid
from mjframes.whole_body.error import BodyError
from mjframes.whole_body.regions import bone_frames
from mjframes.whole_body.selection import select
from mjframes.whole_body.superelement import Superelement, degrees, moments, superelement
from mjframes.whole_body.weight_correction import assembled, compliance

SPACING = 0.01
SOFT, HARD = mf.Material(1e4, 0.35, 1000), mf.Material(1e6, 0.3, 1200)
BONE = mf.Material.rigid(1900)


def bar(along: int = 12, across: int = 3) -> np.ndarray:
    """Two layers."""
    labels = np.ones((along, across, across), int)
    labels[:, across // 2 + 1 :] = 2
    return labels


@cache
def small(held: int, frame_type: str = "affine") -> tuple[Solved, Frames, Superelement]:
    """Three frames in a bar of two layers that is held at so many of its ends."""
    volume = mf.Volume.from_labels(bar(), SPACING, {1: SOFT, 2: HARD})
    grid = voxel_grid(volume)
    ends = [grid.index[:, 0] == 0, grid.index[:, 0] == 11][:held]
    cores = [np.flatnonzero(end) for end in ends]
    frames = place(grid, evened(grid), cores, BuildOptions(volume, frame_type=frame_type), 3)
    some = solved(grid, *ends)
    blocks = np.arange(len(grid.index))
    shapes, kinds = frames.shapes, groups(grid.table)
    element = superelement(
        grid, shapes.weights, shapes.control, frames.types, held, some.solver, blocks, lambda _, __: None, kinds
    )
    return some, frames, element


def least_energy(some: Solved, frames: Frames, held: int, x: np.ndarray) -> tuple[float, np.ndarray]:
    """Of all displacements (3N,) with the moments of control points at x (k, 3) [J], and these."""
    grid, solver, control = some.grid, some.solver, frames.shapes.control
    functionals, gram = moments(grid, frames.shapes.weights, control, solver)
    moving = np.flatnonzero(control.frame >= held)
    rows = sparse.kron(functionals[:, moving].T, sparse.eye_array(3)).toarray()
    wanted = (gram[moving] @ x).ravel()
    place_of = solver.mesh.position * grid.spacing
    given = np.zeros((len(place_of), 3))
    for i in range(held):
        on, own = solver.mesh.held_by == i, control.frame == i
        both = rigid(np.vstack([control.rest[own], place_of[on]]))
        count = 3 * np.count_nonzero(own)
        given[on] = (both[count:] @ np.linalg.pinv(both[:count]) @ x[own].ravel()).reshape(-1, 3)
    A, free, start = some.matrix.toarray(), some.free, given.ravel()
    a, f = A[np.ix_(free, free)], -(A @ start)[free]
    left, size, _ = np.linalg.svd(rows[:, free].T, full_matrices=False)
    rank = np.count_nonzero(size > 1e-10 * size[0])
    right = wanted - rows @ start
    particular = np.linalg.pinv(rows[:, free], rcond=1e-10) @ right
    null = np.linalg.svd(left[:, :rank].T, full_matrices=True)[2][rank:].T
    inside = null.T @ a @ null
    z = np.linalg.lstsq(inside, null.T @ (f - a @ particular), rcond=1e-14)[0]
    u = start.copy()
    u[free] += particular + null @ z
    return 0.5 * float(u @ A @ u), u


@pytest.mark.parametrize(("frame_type", "held"), thinned(product(("affine", "quadratic", "point"), range(3)), 2))
def test_its_energy_is_the_least_with_these_moments(held: int, frame_type: str) -> None:
    """And its share of the softer layer, ∂K/∂log E, is what that has of this energy."""
    some, frames, element = small(held, frame_type)
    (share,) = element.shares
    doubled = replace(some.grid, table=(replace(some.grid.table[0], young=2 * SOFT.young), some.grid.table[1]))
    of_layer = bricks_assembled(doubled, some.solver.mesh) - some.matrix
    control, rng = frames.shapes.control, np.random.default_rng(0)
    for _ in range(3):
        x = rng.normal(size=control.rest.shape)
        for i in range(held):  # pieces move rigidly
            own = control.frame == i
            motion = rigid(control.rest[own])
            x[own] = (motion @ rng.normal(size=6)).reshape(-1, 3)
        energy, u = least_energy(some, frames, held, x)
        assert 0.5 * x.ravel() @ element.matrix @ x.ravel() == pytest.approx(energy, rel=0.005)
        assert x.ravel() @ share @ x.ravel() == pytest.approx(float(u @ of_layer @ u), rel=0.005, abs=0.002 * energy)
        moved = np.tensordot(element.moved, element.lifting @ x.ravel(), (2, 0))
        exact = (some.centre @ u).reshape(-1, 3)
        still = some.solver.node[:, 0] < 0  # C has nothing of held voxels
        assert np.linalg.norm((moved - exact)[~still]) < 0.01 * np.linalg.norm(exact)


def test_moments_are_integrals_over_voxels() -> None:
    """Weighted by the root of Young's modulus; exact where functions and fields are linear, however thin a sheet is."""
    grid = voxel_grid(mf.Volume.from_labels(bar(4, 3)[:, 1:], (0.01, 0.02, 0.03), {1: SOFT, 2: HARD}))
    weights = sparse.csr_array(np.ones((len(grid.index), 1)))
    control, solver = control_points(grid, weights), body_solver(grid)
    functionals, gram = moments(grid, weights, control, solver)
    slope = np.array([0.3, -0.7, 0.5])
    integral, products = np.zeros(4), np.zeros((4, 4))
    for corner in CORNERS:  # Gauss's points
        at = grid.centers + grid.axes @ ((corner - 0.5) / np.sqrt(3) * grid.spacing)
        phi = control_weights(weights, control, at).toarray()
        scaled = phi * (grid.cell_volume * np.sqrt(grid.young / HARD.young) / 8)[:, None]
        integral += scaled.T @ (at @ slope)
        products += scaled.T @ phi
    nodes = grid.origin + solver.mesh.position * grid.spacing @ grid.axes.T
    np.testing.assert_allclose(functionals.T @ (nodes @ slope), integral, rtol=1e-12)
    np.testing.assert_allclose(gram, products, rtol=1e-9, atol=1e-12 * np.abs(products).max())


def test_to_strain_a_rigid_frame_costs_as_much_as_to_move_it() -> None:
    _, frames, element = small(0, "rigid")
    for i in range(len(frames.types)):
        dof = degrees(np.flatnonzero(frames.shapes.control.frame == i))
        motion = np.linalg.qr(rigid(frames.shapes.control.rest[dof[::3] // 3]))[0]
        own = element.matrix[np.ix_(dof, dof)]
        strain = np.linalg.svd(motion, full_matrices=True)[0][:, 6:]
        assert np.linalg.eigvalsh(strain.T @ own @ strain)[0] > 0.1 * np.trace(motion.T @ own @ motion) / 6


def test_quadratic_frames_need_more_than_a_voxel() -> None:
    flap = np.ones((30, 12, 6), int)
    flap[10:, :, 1:] = 0
    volume = mf.Volume.from_labels(flap, 0.008, {1: mf.Material(2e5, 0.3, 900)})
    with pytest.raises(mf.MjframesError, match=r"^a quadratic frame, near \(0\.193, .*\) m, has one voxel of the body"):
        mf.build(volume, 4, frame_type="quadratic")


@pytest.mark.parametrize("held", [0, 2])
def test_rigid_motions_cost_nothing(held: int) -> None:
    _, frames, element = small(held)
    motion = rigid(frames.shapes.control.rest)
    assert np.abs(element.matrix @ motion).max() < 1e-6 * np.abs(element.matrix).max()


def schur(matrix: np.ndarray, kept: np.ndarray) -> np.ndarray:
    others = np.setdiff1d(np.arange(len(matrix)), kept)
    across = matrix[np.ix_(kept, others)]
    inverse = np.linalg.pinv(matrix[np.ix_(others, others)], rcond=1e-11, hermitian=True)
    return matrix[np.ix_(kept, kept)] - across @ inverse @ across.T


@pytest.mark.parametrize("frame_type", ["affine", "quadratic"])
def test_parts_are_exact_on_every_clique(frame_type: str) -> None:
    """The sum of all parts, with all other frames free, is K with all others free."""
    _, frames, element = small(1, frame_type)
    control, count = frames.shapes.control, len(frames.types)
    assert frames.parents is not None
    assert sum(map(len, frames.parents.values())) < count * (count - 1) / 2  # not all are coupled
    parts = select(element.matrix, control, frames.parents, element.shares)
    total = np.zeros_like(element.matrix)
    motion = rigid(control.rest)
    for part in parts:
        dof = degrees(part.points)
        total[np.ix_(dof, dof)] += part.matrix
        values = np.linalg.eigvalsh(part.matrix)
        assert values[0] > -1e-12 * max(values[-1], 1)
        assert np.abs(part.matrix @ motion[dof]).max() < 1e-9 * max(values[-1], 1)
    size = np.abs(element.matrix).max()
    for part in parts:
        dof = degrees(part.points)
        np.testing.assert_allclose(schur(total, dof), schur(element.matrix, dof), atol=1e-6 * size)


@pytest.mark.parametrize(("frame_type", "held"), [("affine", 0), ("rigid", 0), ("point", 1)])
def test_parts_are_blind_to_rigid_motions(frame_type: str, held: int) -> None:
    """Even those of points, whose weights do not turn with the body."""
    _, frames, element = small(held, frame_type)
    control = frames.shapes.control
    for part in select(element.matrix, control, {i: range(i) for i in range(len(frames.types))}, element.shares):
        motion = rigid(control.rest[part.points])
        assert np.abs(part.matrix @ motion).max() < 1e-12 * np.abs(element.matrix).max()


def test_whole_families_are_exact() -> None:
    """Where every frame is coupled to every other the parts sum up to K itself."""
    _, frames, element = small(0)
    count = len(frames.types)
    parts = select(element.matrix, frames.shapes.control, {i: range(i) for i in range(count)}, element.shares)
    total = np.zeros_like(element.matrix)
    for part in parts:
        total[np.ix_(degrees(part.points), degrees(part.points))] += part.matrix
    np.testing.assert_allclose(total, element.matrix, atol=1e-6 * np.abs(total).max())


@cache
def lame(held: bool, frames: int = 4) -> mf.SoftBody:
    """A block of flesh on a bone that sticks out at one end."""
    labels = np.ones((24, 8, 8), int)
    labels[:14, 3:5, 3:5] = 2
    fixed = [mf.Fixed(labels == 2)] if held else []
    return mf.build(mf.Volume.from_labels(labels, SPACING, {1: SOFT, 2: BONE}), frames, supports=fixed)


def error_of(made: mf.SoftBody) -> BodyError:
    assert made.error is not None
    return made.error


@pytest.mark.parametrize("held", [False, True])
def test_weights_that_follow_the_body_are_still_a_partition_of_unity(held: bool) -> None:
    made = lame(held)
    grid = voxel_grid(made.fields.volume)
    weights = made.shapes.at_voxels(grid)
    assert made.shapes.correction is not None
    assert abs(made.shapes.correction).max() > 0.01
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-9)
    np.testing.assert_allclose(weights @ made.control.rest, grid.centers, atol=1e-9)


@pytest.mark.parametrize("held", [False, True])
def test_modes_are_blind_to_rigid_motions(held: bool) -> None:
    made = lame(held)
    motion = rigid(made.control.rest)
    assert made.fields.lifting is not None
    for points, share in zip(made.stiffness.points, made.fields.lifting.share, strict=True):
        assert np.abs(share @ motion[degrees(points)]).max(initial=0) < 1e-9 * np.abs(share).max(initial=1)


def test_a_free_body_with_a_bone_is_as_right_as_one_that_is_held() -> None:
    """What modes made of the motion of the whole was once hundreds of per cent."""
    assert error_of(lame(False, 8)).pushes < 1.3 * error_of(lame(True, 8)).pushes < 0.5


def test_a_bone_takes_the_strain_from_its_frame() -> None:
    """Else other frames follow a strain of it that is none but its turning: shapes far from rest would cost nothing."""
    made = lame(False)
    own = [points for points in made.stiffness.points if len(set(made.control.frame[points])) == 1]
    bone = voxel_grid(made.fields.volume).material == 1
    frame = int(np.argmax(made.fields.weights[bone].sum(axis=0)))
    assert any(set(made.control.frame[points]) == {frame} for points in own)
    total = assembled(made.stiffness, len(made.control.frame))
    dof = degrees(np.flatnonzero(made.control.frame == frame))
    values = np.linalg.eigvalsh(schur(total, dof))
    assert values[6] > 100 * np.median(np.linalg.eigvalsh(total))


def test_only_frames_that_can_strain_are_kept_from_it_by_their_bone() -> None:
    made = lame(False)
    grid, weights = voxel_grid(made.fields.volume), made.fields.weights
    (frame,) = bone_frames(grid, weights, made.types, 0)
    assert weights[grid.piece >= 0][:, [frame]].min() == pytest.approx(1)
    assert bone_frames(grid, weights, made.types, frame + 1) == []
    for kind in ("rigid", "point"):
        assert bone_frames(grid, weights, (kind,) * len(made.types), 0) == []
    assert bone_frames(grid, sparse.csr_array(weights.sum(axis=1)[:, None]), ("affine",), 0) == []


def test_a_stiffness_of_rounding_is_none() -> None:
    """A frame of one point may move across the line of its parents' points for nothing: scaled up it was 10¹⁶ off."""
    made = mf.build(mf.Volume.from_labels(bar(), SPACING, {1: SOFT, 2: HARD}), 3, frame_type="point")
    assert error_of(made).pushes < 1


def hook() -> mf.Volume:
    """A bent bar of one material with a soft joint, and a hard rib."""
    labels = np.zeros((20, 14, 4), int)
    labels[:, :4] = 1
    labels[16:] = 1
    labels[8:11, :4] = 2
    labels[12:, 1:3, 1:3] = 3
    return mf.Volume.from_labels(
        labels,
        SPACING,
        {1: mf.Material(5e4, 0.4, 1000), 2: mf.Material(1e4, 0.45, 1000), 3: mf.Material(1e6, 0.3, 1500)},
    )


def slab() -> mf.Volume:
    """A plate with a hard lower side, a hole and a thick rim."""
    labels = np.ones((18, 18, 4), int)
    labels[:, :, 0] = 2
    labels[6:11, 7:12] = 0
    return mf.Volume.from_labels(labels, (0.01, 0.01, 0.005), {1: SOFT, 2: mf.Material(2e5, 0.3, 1100)})


@pytest.mark.parametrize(
    ("volume", "weight"), [(hook(), 0.09), pytest.param(slab(), 0.14, marks=pytest.mark.slow)], ids=["hook", "slab"]
)
def test_the_error_that_is_promised_is_that_of_a_step(volume: mf.Volume, weight: float) -> None:
    """Own weight along each axis, small, in mj_step at rest, against a direct solution with other elements' code."""
    held = np.zeros(volume.labels.shape, bool)
    held[:2] = volume.labels[:2] > 0
    made = mf.build(volume, 6, supports=[mf.Fixed(held)], damping=(20.0, 0.0))
    promised = error_of(made).weight
    assert promised is not None
    assert promised < weight
    grid = voxel_grid(volume)
    some = solved(grid, held.ravel()[np.ravel_multi_index(tuple(grid.index.T), volume.labels.shape)])
    exact, found = [], []
    for axis in np.eye(3):
        force = np.outer(grid.density * grid.cell_volume, 1e-3 * axis)
        exact.append((some.centre @ some.solve(some.centre.T @ force.reshape(-1, 1))).ravel())
        model, data = compiled("<mujoco/>", (made, (0, 0, 0), (1, 0, 0, 0)), contact=False, timestep=0.02)
        model.opt.gravity[:] = 1e-3 * axis
        mujoco.mj_step(model, data, 3000)
        mujoco.mj_forward(model, data)
        assert np.abs(data.qvel).max() < 1e-8
        found.append((soft(model, data, "soft0").positions(grid.centers) - grid.centers).ravel())
    difference, size = np.transpose(np.array(found) - exact), np.transpose(exact)
    scale = 1 / np.linalg.norm(size, axis=0)
    square, whole = (scale[:, None] * (some.T @ some) * scale for some in (difference, size))
    error = np.sqrt(np.linalg.eigvals(np.linalg.solve(whole, square)).real.max())
    assert error == pytest.approx(promised, rel=0.1, abs=0.002)


@pytest.mark.slow
def test_an_error_chooses_the_number_of_frames() -> None:
    held = np.zeros(hook().labels.shape, bool)
    held[:2] = hook().labels[:2] > 0
    made = mf.build(hook(), error=0.1, supports=[mf.Fixed(held)])
    assert error_of(made).largest <= 0.1
    fewer = mf.build(hook(), len(made.types) - 1 - made.held, supports=[mf.Fixed(held)])
    assert error_of(fewer).largest > 0.1
    with pytest.raises(mf.MjframesError, match=r"error is 0\.0001, but of up to 40 frames \d+ do best, with 0\.\d+ "):
        mf.build(mf.Volume.from_labels(bar(), SPACING, {1: SOFT, 2: HARD}), error=1e-4)


def test_compliance_is_that_of_all_frames_together() -> None:
    _, frames, element = small(1)
    control = frames.shapes.control
    found = compliance(element.matrix, control, frames.types, 1)
    free = degrees(np.flatnonzero(control.frame > 0))
    np.testing.assert_allclose(
        found[np.ix_(free, free)], np.linalg.inv(element.matrix[np.ix_(free, free)]), rtol=0, atol=1e-6 * found.max()
    )
    assert not found[: 3 * np.count_nonzero(control.frame == 0)].any()
