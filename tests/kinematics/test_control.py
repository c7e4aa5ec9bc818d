from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from builders.shapes import block, mixed
from scipy import sparse

from mjframes.base.errors import MjframesError
from mjframes.frames.placement import place_frames
from mjframes.kinematics.control import POINTS, ControlPoints, control_points, control_weights, frame_types, points_of
from mjframes.kinematics.gradients import product_rule
from mjframes.volume.grid import Grid, voxel_grid
from mjframes.weights.voronoi import voronoi_weights

GRIDS = {"mixed": voxel_grid(mixed()), "plate": block(14, 9, 1), "bar": block(20, 1, 1)}


@pytest.fixture(params=GRIDS, ids=str)
def case(request: pytest.FixtureRequest) -> tuple[Grid, sparse.csr_array]:
    grid = GRIDS[request.param]
    return grid, voronoi_weights(grid, place_frames(grid, 4))


MIXED_TYPES = ("affine", "quadratic", "affine", "quadratic")


def corners(grid: Grid) -> np.ndarray:
    """27 Gauss points a voxel (27 n, 3): with `GAUSS` they integrate products of quadratic functions exactly."""
    offset = (np.argwhere(np.ones((3, 3, 3))) - 1) * np.sqrt(0.15) * grid.spacing @ grid.axes.T
    return (grid.centers[:, None] + offset).reshape(-1, 3)


GAUSS = np.einsum("a,b,c->abc", *[[5 / 18, 8 / 18, 5 / 18]] * 3).ravel()


def functions(control: ControlPoints, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """φ_j (s, k) and ∇φ_j (s, k, 3) at points (s, 3): what the weights 1 make."""
    shape = len(points), control.frame[-1] + 1
    return product_rule(control, np.arange(shape[1]), np.ones(shape), np.zeros((*shape, 3)), points)


def test_control_points_are_equimomental(case):
    grid, weights = case
    control = control_points(grid, weights, MIXED_TYPES)
    k = len(control.frame)
    phi = functions(control, corners(grid))[0].reshape(len(grid.index), 27, k)
    share = weights.toarray() * grid.density[:, None] * grid.cell_volume
    for i, mass in enumerate(share.sum(axis=0)):
        own = phi[:, :, control.frame == i]
        d = POINTS[MIXED_TYPES[i]]
        assert own.shape[2] == d
        moment = np.einsum("v,q,vqk,vql->kl", share[:, i], GAUSS, own, own, optimize=True)
        np.testing.assert_allclose(moment, mass / d * np.eye(d), atol=1e-9 * mass)
        np.testing.assert_allclose(own.sum(axis=2), 1, atol=1e-10)
        np.testing.assert_allclose(control.mass[control.frame == i], mass / d)


def test_gradients_are_those_of_the_functions(case):
    grid, weights = case
    control = control_points(grid, weights, MIXED_TYPES)
    step = 1e-6 * np.eye(3) * grid.spacing
    gradient = functions(control, grid.centers)[1]
    for axis in range(3):
        ahead, _ = functions(control, grid.centers + step[axis])
        behind, _ = functions(control, grid.centers - step[axis])
        slope = (ahead - behind) / (2 * step[axis, axis])
        np.testing.assert_allclose(gradient[:, :, axis], slope, atol=1e-6 * np.abs(gradient).max())


@pytest.mark.parametrize(
    ("types", "words"), [("cubic", "types are 'affine'"), (("affine",), "names 1 types for 4 frames")]
)
def test_wrong_types_are_refused(types, words):
    with pytest.raises(MjframesError, match=words):
        frame_types(types, 4)


def test_control_functions_reproduce_points(case):
    grid, weights = case
    control = control_points(grid, weights, MIXED_TYPES)
    phi, _ = functions(control, grid.centers)
    for i in range(4):
        own = control.frame == i
        np.testing.assert_allclose(phi[:, own] @ control.rest[own], grid.centers, atol=1e-12)


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
    expected = weights.toarray()[rows][:, control.frame] * functions(control, points)[0]
    np.testing.assert_allclose(found, expected, atol=1e-14)


def test_far_origin_costs_no_digits():
    near = block(6, 5, 4)
    far = replace(near, origin=near.origin + 1000.0)
    weights = voronoi_weights(near, place_frames(near, 2))
    shifted = control_points(far, weights).rest - 1000
    np.testing.assert_allclose(shifted, control_points(near, weights).rest, atol=1e-11)


def test_points_of_frames_come_frame_by_frame():
    grid = block(10, 3, 3)
    control = control_points(grid, voronoi_weights(grid, place_frames(grid, 3)))
    point, place = points_of(control, np.array([2, 0]))
    assert point.tolist() == [8, 9, 10, 11, 0, 1, 2, 3]
    assert place.tolist() == [0, 0, 0, 0, 1, 1, 1, 1]
