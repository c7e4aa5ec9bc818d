from __future__ import annotations

import numpy as np
import pytest
from scipy import sparse
from shapes import block, mixed

from mjframes.control import control_functions, control_points, control_weights, points_of
from mjframes.grid import Grid, voxel_grid
from mjframes.placement import place_frames
from mjframes.weights import voronoi_weights

GRIDS = {"mixed": voxel_grid(mixed()), "plate": block(14, 9, 1), "bar": block(20, 1, 1)}


@pytest.fixture(params=GRIDS, ids=str)
def case(request: pytest.FixtureRequest) -> tuple[Grid, sparse.csr_array]:
    grid = GRIDS[request.param]
    return grid, voronoi_weights(grid, place_frames(grid, 4))


def corners(grid: Grid) -> np.ndarray:
    """Eight Gauss points a voxel (8 n, 3): they integrate quadratic functions over voxels exactly."""
    offset = (np.argwhere(np.ones((2, 2, 2))) - 0.5) / np.sqrt(3) * grid.spacing @ grid.axes.T
    return (grid.centers[:, None] + offset).reshape(-1, 3)


def test_control_points_are_equimomental(case):
    grid, weights = case
    control = control_points(grid, weights)
    phi = control_functions(control, np.arange(16), corners(grid)).reshape(len(grid.index), 8, 16)
    share = weights.toarray() * grid.density[:, None] * grid.cell_volume
    for i, mass in enumerate(share.sum(axis=0)):
        own = phi[:, :, control.frame == i]
        moment = np.einsum("v,vqk,vql->kl", share[:, i] / 8, own, own)
        np.testing.assert_allclose(moment, mass / 4 * np.eye(4), atol=1e-10 * mass)
        np.testing.assert_allclose(own.sum(axis=2), 1, atol=1e-10)
        np.testing.assert_allclose(control.mass[control.frame == i], mass / 4)


def test_control_functions_reproduce_points(case):
    grid, weights = case
    control = control_points(grid, weights)
    for i in range(4):
        chosen = np.flatnonzero(control.frame == i)
        phi = control_functions(control, chosen, grid.centers)
        np.testing.assert_allclose(phi @ control.rest[chosen], grid.centers, atol=1e-12)


def test_mass_and_centre_of_mass_are_kept(case):
    grid, weights = case
    control = control_points(grid, weights)
    mass = grid.density * grid.cell_volume
    assert np.isclose(control.mass.sum(), mass.sum())
    np.testing.assert_allclose(control.mass @ control.rest, mass @ grid.centers)


def test_control_weights_reproduce_points(case):
    grid, weights = case
    control = control_points(grid, weights)
    rows = np.array([5, 0, 11])
    points = grid.centers[rows] + 0.003
    found = control_weights(weights[rows], control, points).toarray()
    np.testing.assert_allclose(found.sum(axis=1), 1, atol=1e-12)
    np.testing.assert_allclose(found @ control.rest, points, atol=1e-12)
    expected = weights.toarray()[rows][:, control.frame] * control_functions(control, np.arange(16), points)
    np.testing.assert_allclose(found, expected, atol=1e-14)


def test_far_origin_costs_no_digits():
    near, far = block(6, 5, 4), block(6, 5, 4)
    far.centers[:] += 1000.0
    weights = voronoi_weights(near, place_frames(near, 2))
    shifted = control_points(far, weights).rest - 1000
    np.testing.assert_allclose(shifted, control_points(near, weights).rest, atol=1e-11)


def test_points_of_frames_come_frame_by_frame():
    grid = block(10, 3, 3)
    control = control_points(grid, voronoi_weights(grid, place_frames(grid, 3)))
    point, place = points_of(control, np.array([2, 0]))
    assert point.tolist() == [8, 9, 10, 11, 0, 1, 2, 3]
    assert place.tolist() == [0, 0, 0, 0, 1, 1, 1, 1]
