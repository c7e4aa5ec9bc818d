"""Static deflections against voxel FEM: the same voxels, trilinear displacements."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.linalg import spsolve
from shapes import mixed

from mjframes.body import build
from mjframes.control import ControlPoints, control_points, control_weights
from mjframes.grid import Grid, voxel_grid
from mjframes.harmonic import harmonic_weights
from mjframes.material import Material
from mjframes.null_modes import hold_null_modes, null_modes
from mjframes.placement import place_frames
from mjframes.regions import Regions, split_regions
from mjframes.stiffness import Stiffness, region_stiffness
from mjframes.supports import Fixed
from mjframes.surfaces import surface_weights
from mjframes.tree import elimination_tree
from mjframes.volume import Volume
from mjframes.voxel_fem import CellGrid, cell_grid, cell_stiffness, rigid_motions
from mjframes.weights import voronoi_weights

LENGTH, GRAVITY = 0.4, 9.81
CONVERGED = {0.0: 0.03954, 0.3: 0.03926, 0.45: 0.03828}  # [m] tip, extrapolated from 6, 12 and 18 voxels across


class Bar:
    """0.4 × 0.1 × 0.1 m, held at x = 0, with frames equally spaced, hats along x, regions between neighbours."""

    def __init__(self, poisson: float, core: float | None = None, across: int = 8) -> None:
        labels = np.ones((4 * across, across, across), np.uint8)
        materials = {1: Material(1e6, poisson, 1000)}
        if core is not None:
            labels[:, across // 4 : -(across // 4), across // 4 : -(across // 4)] = 2
            materials[2] = Material(1e6 * core, poisson, 1000)
        self.grid: Grid = voxel_grid(Volume.from_labels(labels, 0.1 / across, materials))
        grid = self.grid
        self.cells: CellGrid = cell_grid(grid.index, grid.spacing, grid.axes, 1)
        volume = grid.cell_volume
        nodes = self.cells.nodes
        end, corners = nodes[:, 0] > LENGTH - 1e-9, self.cells.cell_nodes.ravel()
        stiff = np.bincount(corners, np.repeat(grid.young, 8)) * end
        self.load = {name: np.zeros((len(nodes), 3)) for name in ("weight", "pull", "twist")}
        self.load["weight"][:, 2] = -GRAVITY * np.bincount(corners, np.repeat(grid.density * volume / 8, 8))
        self.load["pull"][:, 0] = stiff / stiff.sum()
        arm = nodes - 0.05
        self.load["twist"][:, 1:] = np.column_stack([-arm[:, 2], arm[:, 1]]) * (stiff / stiff.sum())[:, None]
        share = np.bincount(corners) * end
        self.tip = np.outer(share / share.sum(), [0, 0, -1])

    def measure(self, load: str, moved: np.ndarray) -> float:
        """Mean deflection of the end face under weight [m]; else the work of the load."""
        return float(np.sum((self.tip if load == "weight" else self.load[load]) * moved))

    @cache  # noqa: B019  bars live as long as the module
    def reference(self, load: str) -> float:
        volume = self.grid.cell_volume
        matrix = sparse.csc_array(cell_stiffness(self.cells, self.grid.lam * volume, self.grid.mu * volume))
        free = np.repeat(self.cells.nodes[:, 0] > 1e-9, 3)
        moved = np.zeros(self.load[load].size)
        moved[free] = np.asarray(spsolve(matrix[free][:, free], self.load[load].ravel()[free]))
        return self.measure(load, moved.reshape(-1, 3))

    def hats(self, x: np.ndarray, frames: int) -> sparse.csr_array:
        apart = LENGTH / (frames - 1)
        return sparse.csr_array(np.maximum(0, 1 - np.abs(x[:, None] / apart - np.arange(frames))))

    def reduced(self, frames: int, relax: bool) -> tuple[Stiffness, ControlPoints]:
        weights = self.hats(self.grid.centers[:, 0], frames)
        label = (self.grid.centers[:, 0] * (frames - 1) / LENGTH).astype(np.int32)
        sets = tuple((e, e + 1) for e in range(frames - 1))
        control, tree = control_points(self.grid, weights), elimination_tree(sets, frames)
        regions = Regions(label, sets, np.zeros(len(sets)))
        return region_stiffness(self.grid, weights, control, regions, tree, relax), control

    def response(self, frames: int, load: str = "weight", relax: bool = True) -> float:
        stiffness, control = self.reduced(frames, relax)
        shapes = control_weights(self.hats(self.cells.nodes[:, 0], frames), control, self.cells.nodes)
        return self.solve(stiffness, control, shapes, load)

    def solve(self, stiffness: Stiffness, control: ControlPoints, shapes: sparse.csr_array, load: str) -> float:
        """With the first frame held; shapes: (N, k) control weights at the nodes."""
        free = np.repeat(control.frame > 0, 3)
        matrix, force = assembled(stiffness, len(control.frame))[free][:, free], (shapes.T @ self.load[load]).ravel()
        moved = np.zeros(len(free))
        moved[free] = np.linalg.solve(matrix, force[free])
        return self.measure(load, shapes @ moved.reshape(-1, 3))

    def error(self, frames: int, load: str, relax: bool = True) -> float:
        return self.response(frames, load, relax) / self.reference(load) - 1


def assembled(stiffness: Stiffness, points: int) -> np.ndarray:
    total = np.zeros((3 * points, 3 * points))
    for some, matrix in zip(stiffness.points, stiffness.matrix, strict=True):
        dof = (3 * some[:, None] + np.arange(3)).ravel()
        total[np.ix_(dof, dof)] += matrix
    return total


@cache
def homogeneous(poisson: float, across: int = 8) -> Bar:
    return Bar(poisson, across=across)


@cache
def cored() -> Bar:
    return Bar(0.3, core=1e3)


@pytest.mark.parametrize("poisson", CONVERGED)
@pytest.mark.parametrize(("frames", "bound"), [(2, 0.35), (3, 0.10), (5, 0.04), (9, 0.05)])
def test_deflection_under_own_weight(poisson, frames, bound):
    assert abs(homogeneous(poisson, 12).response(frames) / CONVERGED[poisson] - 1) < bound


def test_voxel_fem_approaches_the_converged_deflection():
    assert 0.97 < homogeneous(0.3).reference("weight") / CONVERGED[0.3] < 1


def test_without_relaxation_bending_locks():
    assert homogeneous(0.45).response(5, relax=False) < 0.4 * CONVERGED[0.45]


@pytest.mark.parametrize(
    ("load", "low", "high"), [("weight", -0.05, 0.05), ("pull", -0.02, 0.01), ("twist", -0.03, 0.07)]
)
def test_a_stiff_core_in_a_soft_coat(load, low, high):
    assert low < cored().error(5, load) < high


def test_torsion_warps_the_cross_section():
    assert abs(homogeneous(0.3).error(3, "twist")) < 0.06
    assert homogeneous(0.3).error(3, "twist", relax=False) < -0.09


def test_cells_follow_the_layers_that_monomials_cannot(monkeypatch):
    with_cells = cored().error(2, "pull")
    monkeypatch.setattr("mjframes.relaxation.COARSEST", 1000)
    assert cored().error(2, "pull") < with_cells < 0.005


def test_bent_weights_of_single_voxels_are_straightened_where_the_material_is_even(monkeypatch):
    bar = homogeneous(0.3)
    size = np.array(bar.grid.lookup.shape)
    across = np.array([[0, size[1] // 2, size[2] // 2]])
    seeds = across + np.round(np.linspace(0, size[0] - 1, 3)).astype(int)[:, None] * [1, 0, 0]
    placement = place_frames(bar.grid, at=(seeds + 0.5) * bar.grid.spacing)
    weights = voronoi_weights(bar.grid, placement)
    regions = split_regions(bar.grid, weights, 3)
    control, tree = control_points(bar.grid, weights), elimination_tree(regions.frames, 3)
    shapes = control_weights(surface_weights(bar.grid, weights, bar.cells.nodes), control, bar.cells.nodes)

    def response() -> float:
        stiffness = region_stiffness(bar.grid, weights, control, regions, tree)
        return bar.solve(stiffness, control, shapes, "weight")

    straight = response()
    monkeypatch.setattr("mjframes.relaxation.NEARLY_LINEAR", 0.0)
    assert response() < 0.9 * straight
    assert 0.7 < straight / CONVERGED[0.3] < 1.1


def test_frames_that_overlap_widely_keep_their_stiffness(monkeypatch):
    """Linear fits of many frames' weights would let their motions cancel: the bar would turn twice as far."""
    bar = homogeneous(0.3)
    size = np.array(bar.grid.lookup.shape)
    at = np.tile(size * bar.grid.spacing / 2, (8, 1))
    at[:, 0] = (np.arange(1, 9) / 8 * (size[0] - 1) + 0.5) * bar.grid.spacing[0]
    placement = place_frames(bar.grid, at=at, cores=[np.flatnonzero(bar.grid.index[:, 0] == 0)])
    weights = harmonic_weights(bar.grid, placement)
    regions = split_regions(bar.grid, weights, 8)
    control, tree = control_points(bar.grid, weights), elimination_tree(regions.frames, 9)
    shapes = control_weights(surface_weights(bar.grid, weights, bar.cells.nodes), control, bar.cells.nodes)

    def error() -> float:
        stiffness = region_stiffness(bar.grid, weights, control, regions, tree)
        return bar.solve(stiffness, control, shapes, "twist") / bar.reference("twist") - 1

    assert max(len(some) for some in regions.frames) > 4
    kept = error()
    monkeypatch.setattr("mjframes.relaxation.MOST_STRAIGHT", 100)
    assert error() > 0.5
    assert -0.3 < kept < 0.05


def test_stiff_crumbs_do_not_turn_for_the_soft_layer_under_them():
    """A layer sheared between a held face and a few stiff voxels on it resists as a layer does."""
    labels, h = np.zeros((13, 12, 4), np.uint8), 0.01
    labels[:, :, :3] = 1
    labels[4:9:2, 3:8:2, 3] = 2
    soft = Material(1e4, 0.3, 1000)
    grid = voxel_grid(Volume.from_labels(labels, h, {1: soft, 2: Material(1e7, 0.3, 1000)}))
    share = np.minimum(grid.index[:, 2] / 2.5, 1.0)
    weights = sparse.csr_array(np.stack([1 - share, share], axis=1))
    control, tree = control_points(grid, weights), elimination_tree(((0, 1),), 2)
    regions = Regions(np.zeros(len(share), np.int32), ((0, 1),), np.zeros(1))
    stiffness = region_stiffness(grid, weights, control, regions, tree)
    moved = np.zeros((len(control.frame), 3))
    moved[control.frame == 1, 0] = 1.0
    moved = moved[stiffness.points[0]].ravel()
    layer = soft.lame[1] * (13 * 12 * h * h) / (2.5 * h)  # [N/m] μ A / thickness
    assert 0.8 < moved @ stiffness.matrix[0] @ moved / layer < 1.3


@pytest.fixture(scope="module")
def uneven() -> tuple[Grid, ControlPoints, Regions, Stiffness, Stiffness]:
    """Materials, bones and a hole; quadratic frames as well; weights as they are, never their linear fit."""
    grid = voxel_grid(mixed())
    weights = voronoi_weights(grid, place_frames(grid, 6))
    control = control_points(grid, weights, ("affine", "quadratic") * 3)
    regions = split_regions(grid, weights, 12)
    tree = elimination_tree(regions.frames, 6)
    free, plain = (region_stiffness(grid, weights, control, regions, tree, relax=relax) for relax in (True, False))
    return grid, control, regions, free, plain


def test_uniform_strain_keeps_the_exact_energy(uneven):
    grid, control, regions, free, _ = uneven
    slope = np.random.default_rng(1).normal(size=(3, 3))
    strain = (slope + slope.T) / 2
    density = 0.5 * grid.lam * np.trace(strain) ** 2 + grid.mu * np.sum(strain**2)
    exact = np.bincount(regions.label, weights=density * grid.cell_volume)
    moved = control.rest @ slope.T
    energy = [0.5 * moved[p].ravel() @ k @ moved[p].ravel() for p, k in zip(free.points, free.matrix, strict=True)]
    np.testing.assert_allclose(energy, exact, rtol=1e-10)


def test_rigid_motions_cost_nothing(uneven):
    _, control, _, free, _ = uneven
    for moved in (np.cross([0.3, -0.2, 0.5], control.rest), np.tile([1.0, -2.0, 0.5], (len(control.rest), 1))):
        for points, matrix in zip(free.points, free.matrix, strict=True):
            assert np.abs(matrix @ moved[points].ravel()).max() < 1e-11 * np.abs(matrix).max()


def test_translations_cost_nothing_to_the_last_digit(uneven):
    *_, free, _ = uneven
    for matrix in free.matrix:  # as relaxed 4e-14, elsewhere 4e-11: at h²K/m of 3e11 free bodies took off
        push = matrix.reshape(len(matrix), -1, 3).sum(axis=1)
        assert np.abs(push).max() < 1e-15 * np.abs(matrix).max()


def test_matrices_are_symmetric_and_positive_semidefinite(uneven):
    *_, free, _ = uneven
    for matrix, values in zip(free.matrix, free.spectrum, strict=True):
        assert np.array_equal(matrix, matrix.T)
        assert values[0] > -1e-12 * values[-1]


def test_relaxation_never_stiffens():
    for bar, frames in ((homogeneous(0.3), 2), (cored(), 2)):  # one region: no kinks of the weights, the same slopes
        (free, _), (plain, _) = bar.reduced(frames, True), bar.reduced(frames, False)
        gain = np.linalg.eigvalsh(plain.matrix[0] - free.matrix[0])
        assert gain[0] > -0.02 * gain[-1]  # thin cores take two points a voxel, which see more bending than one
        assert gain[-1] > 0.01 * free.spectrum[0][-1]


def test_mean_gradients_reproduce_linear_fields(uneven):
    _, control, _, free, _ = uneven
    for points, gradient in zip(free.points, free.gradient, strict=True):
        np.testing.assert_allclose(control.rest[points].T @ gradient, np.eye(3), atol=1e-10)


def test_hats_have_a_null_mode_and_holding_it_changes_no_deflection():
    bar = homogeneous(0.3)
    stiffness, control = bar.reduced(3, True)
    modes = null_modes(stiffness, control)
    shapes = control_weights(bar.hats(bar.cells.nodes[:, 0], 3), control, bar.cells.nodes)
    assert len(modes) == 1
    assert np.abs(shapes @ modes[0]).max() < 1e-9 * np.abs(modes).max()

    held = hold_null_modes(stiffness, control)
    zeros = [
        int(np.sum(np.linalg.eigvalsh(matrix) < 1e-9 * np.abs(matrix).max()))
        for matrix in (assembled(stiffness, len(control.frame)), assembled(held, len(control.frame)))
    ]
    assert zeros == [9, 6]
    # forces of equilibrium, through the shapes: the material moves as before
    force = np.random.default_rng(0).normal(size=(len(shapes.indptr) - 1, 3))
    motions = rigid_motions(bar.cells.nodes)
    force -= (motions @ np.linalg.lstsq(motions, force.ravel(), rcond=None)[0]).reshape(-1, 3)
    strains = []
    for some in (stiffness, held):
        moved = (
            np.linalg.pinv(assembled(some, len(control.frame)), rcond=1e-11, hermitian=True)
            @ (shapes.T @ force).ravel()
        )
        field = (shapes @ moved.reshape(-1, 3)).ravel()
        strains.append(field - motions @ np.linalg.lstsq(motions, field, rcond=None)[0])
    np.testing.assert_allclose(strains[1], strains[0], atol=1e-7 * np.abs(strains[0]).max())


def test_bodies_without_null_modes_are_left_as_they_are():
    grid = voxel_grid(mixed())
    weights = voronoi_weights(grid, place_frames(grid, 3))
    regions = split_regions(grid, weights, 6)
    control = control_points(grid, weights)
    stiffness = region_stiffness(grid, weights, control, regions, elimination_tree(regions.frames, 3))
    assert len(null_modes(stiffness, control)) == 0
    assert all(a is b for a, b in zip(hold_null_modes(stiffness, control).matrix, stiffness.matrix, strict=True))


def test_uniform_strain_moves_no_held_mode():
    stiffness, control = homogeneous(0.3).reduced(5, True)
    moved = control.rest @ np.random.default_rng(3).normal(size=(3, 3)).T
    held = hold_null_modes(stiffness, control)
    for points, before, after in zip(stiffness.points, stiffness.matrix, held.matrix, strict=True):
        u = moved[points].ravel()
        assert abs(u @ (after - before) @ u) < 1e-12 * (u @ before @ u)
    assert any(a is not b for a, b in zip(stiffness.matrix, held.matrix, strict=True))


def test_a_plate_of_one_layer_resists_torsion():
    """Kirchhoff's plate: u_z = θ x y costs 2 μ θ² h²/12 a volume, and is what a turned end becomes when it relaxes."""
    labels, h = np.ones((24, 12, 1), np.uint8), 0.01
    soft = Material(1e5, 0.3, 1000.0)
    volume = Volume.from_labels(labels, h, {1: soft})
    end = np.zeros(labels.shape, bool)
    end[0] = True
    tip = voxel_grid(volume).centers[-1] * [1, 0, 0] + [0, 0.06, 0.005]
    body = build(volume, at=[tip], samples=1, weights="linear", fixed=[Fixed(end)])
    arm = body.control.rest - tip
    turned = np.stack([0 * arm[:, 0], -arm[:, 2], arm[:, 1]], axis=1) * (body.control.frame == 1)[:, None]
    found = sum(
        0.5 * turned[points].ravel() @ matrix @ turned[points].ravel()
        for points, matrix in zip(body.stiffness.points, body.stiffness.matrix, strict=True)
    )
    length = 23 * h
    exact = 2 * soft.lame[1] / length**2 * h**2 / 12 * (length * 12 * h * h)
    assert found == pytest.approx(exact, rel=0.15)
