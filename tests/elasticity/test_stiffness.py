from __future__ import annotations

import numpy as np
import pytest
from builders.shapes import block, mixed

from mjframes.elasticity.regions import split_regions
from mjframes.elasticity.stiffness import control_gradients, region_stiffness
from mjframes.frames.placement import place_frames
from mjframes.kinematics.control import control_points, points_of
from mjframes.kinematics.shape_functions import ShapeFunctions
from mjframes.kinematics.tree import depths, elimination_tree
from mjframes.volume.grid import Grid, voxel_grid
from mjframes.weights.voronoi import voronoi_weights


class Model:
    """All stages up to the stiffness."""

    def __init__(self, grid: Grid, frames: int, samples: int) -> None:
        self.grid = grid
        self.weights = voronoi_weights(grid, place_frames(grid, frames))
        self.control = control_points(grid, self.weights)
        self.regions = split_regions(grid, self.weights, samples)
        self.tree = elimination_tree(self.regions.frames, frames)
        self.stiffness = region_stiffness(grid, ShapeFunctions(self.weights, self.control), self.regions, self.tree)

    def energies(self, moved: np.ndarray) -> np.ndarray:
        """½ uᵀ K_e u of each region for the displacements (k, 3) of the control points."""
        parts = zip(self.stiffness.points, self.stiffness.matrix, strict=True)
        return np.array([0.5 * moved[p].ravel() @ k @ moved[p].ravel() for p, k in parts])


MODELS = {
    "merged": Model(voxel_grid(mixed()), 6, 5),
    "split": Model(voxel_grid(mixed()), 6, 40),
    "plate": Model(block(15, 9, 1, label=2), 4, 12),
    "more than one block of voxels": Model(block(30, 18, 16), 2, 3),
}


@pytest.fixture(params=MODELS, ids=str)
def model(request: pytest.FixtureRequest) -> Model:
    return MODELS[request.param]


def test_gradients_reproduce_linear_fields_at_every_voxel(model):
    for e, members in enumerate(model.regions.frames):
        voxels, frames = np.flatnonzero(model.regions.label == e), np.array(members)
        gradient = control_gradients(model.grid, model.weights, model.control, voxels, frames, model.regions.label)
        rest = model.control.rest[points_of(model.control, frames)[0]]
        assert np.abs(np.einsum("ja,vjb->vab", rest, gradient) - np.eye(3)).max() < 1e-12
        assert np.abs(gradient.sum(axis=1)).max() < 1e-10  # of gradients around 100 / m


def test_uniform_strain_has_the_exact_energy(model):
    slope = np.random.default_rng(1).normal(size=(3, 3))
    strain = (slope + slope.T) / 2
    grid = model.grid
    density = 0.5 * grid.lam * np.trace(strain) ** 2 + grid.mu * np.sum(strain**2)
    exact = np.bincount(model.regions.label, weights=density * grid.cell_volume)
    np.testing.assert_allclose(model.energies(model.control.rest @ slope.T), exact, rtol=1e-10)


def test_rigid_motions_cost_nothing(model):
    scale = [np.abs(k).max() for k in model.stiffness.matrix]
    turned = np.cross([0.3, -0.2, 0.5], model.control.rest)
    for moved in (turned, np.tile([1.0, -2.0, 0.5], (len(turned), 1))):
        for points, matrix, size in zip(model.stiffness.points, model.stiffness.matrix, scale, strict=True):
            assert np.abs(matrix @ moved[points].ravel()).max() < 1e-11 * size


def test_matrices_are_symmetric_and_positive_semidefinite(model):
    for matrix in model.stiffness.matrix:
        assert np.abs(matrix - matrix.T).max() <= 1e-15 * np.abs(matrix).max()
        values = np.linalg.eigvalsh(matrix)
        assert values[0] > -1e-12 * values[-1]


def test_matrix_is_the_sum_over_the_voxels():
    model = MODELS["split"]
    e = int(np.argmax([len(f) for f in model.regions.frames]))
    grid, control, points = model.grid, model.control, model.stiffness.points[e]
    voxels, frames = np.flatnonzero(model.regions.label == e), control.frame[points[::4]]
    expected = np.zeros_like(model.stiffness.matrix[e])
    gradients = control_gradients(grid, model.weights, control, voxels, frames, model.regions.label)
    for v, g in zip(voxels, gradients, strict=True):
        strain = np.zeros((6, 3 * len(g)))  # xx yy zz, and engineering yz zx xy
        for j, (x, y, z) in enumerate(g):
            strain[:, 3 * j : 3 * j + 3] = [[x, 0, 0], [0, y, 0], [0, 0, z], [0, z, y], [z, 0, x], [y, x, 0]]
        hooke = np.diag([2.0] * 3 + [1.0] * 3) * grid.mu[v]
        hooke[:3, :3] += grid.lam[v]
        expected += grid.cell_volume * strain.T @ hooke @ strain
    np.testing.assert_allclose(model.stiffness.matrix[e], expected, atol=1e-12 * np.abs(expected).max())


def test_mean_gradient_is_weighted_by_stiffness():
    model = MODELS["split"]
    for e, points in enumerate(model.stiffness.points):
        voxels, frames = np.flatnonzero(model.regions.label == e), model.control.frame[points[::4]]
        gradient = control_gradients(model.grid, model.weights, model.control, voxels, frames, model.regions.label)
        expected = np.average(gradient, axis=0, weights=model.grid.young[voxels])
        np.testing.assert_allclose(model.stiffness.gradient[e], expected, atol=1e-11)


def test_points_go_down_the_tree_and_volumes_add_up(model):
    depth = depths(model.tree)
    for points, frames in zip(model.stiffness.points, model.regions.frames, strict=True):
        of_frame = model.control.frame[points]
        assert np.array_equal(of_frame, np.repeat(of_frame[::4], 4))
        assert np.all(np.diff(depth[of_frame[::4]]) > 0)
        assert sorted(of_frame[::4]) == list(frames)
    assert np.isclose(model.stiffness.volume.sum(), len(model.grid.index) * model.grid.cell_volume)
