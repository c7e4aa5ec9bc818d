from __future__ import annotations

import numpy as np
import pytest
from builders.shapes import bar, block, mixed

from mjframes.base.constants import NEGLIGIBLE_WEIGHT
from mjframes.base.errors import MjframesError
from mjframes.frames.placement import Placement, place_frames
from mjframes.volume.grid import Grid, voxel_grid
from mjframes.weights.kernels import Voronoi, weights_of
from mjframes.weights.voronoi import voronoi_weights
from mjframes.weights.weights import weight_gradients, weights_at

CASES = {
    "mixed": (voxel_grid(mixed()), 6),
    "few frames for the bones": (voxel_grid(mixed()), 1),
    "plate": (block(20, 12, 1), 5),
    "bar": (bar(*[1] * 10, *[4] * 5, *[2] * 15), 4),
    "frameless bone": (bar(*[4] * 6, *[1] * 8, *[4] * 3, *[2] * 8, *[4] * 9), 2),
}


@pytest.fixture(params=CASES, ids=str)
def case(request: pytest.FixtureRequest) -> tuple[Grid, Placement]:
    grid, frames = CASES[request.param]
    return grid, place_frames(grid, frames)


def at_ends(grid: Grid) -> Placement:
    return place_frames(grid, at=grid.centers[[0, -1]])


def test_bar_of_three_materials_has_the_ideal_weights():
    grid = bar(*[1] * 7, *[3] * 9, *[2] * 12)
    step = (grid.compliance[1:] + grid.compliance[:-1]) / 2
    ideal = 1 - np.concatenate([[0], np.cumsum(step)]) / step.sum()  # equation (5)
    ideal[np.abs(ideal) < NEGLIGIBLE_WEIGHT] = 0
    np.testing.assert_allclose(
        voronoi_weights(grid, at_ends(grid)).toarray(), np.stack([ideal, 1 - ideal], axis=1), atol=1e-6
    )


def test_weights_are_a_partition_of_unity(case):
    grid, placement = case
    weights = voronoi_weights(grid, placement)
    assert weights.shape == (len(grid.index), len(placement.seeds))
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-12)
    assert weights.data.min() >= NEGLIGIBLE_WEIGHT
    assert weights.data.max() <= 1
    assert weights.has_sorted_indices


def test_weights_interpolate_at_the_seeds(case):
    grid, placement = case
    weights = voronoi_weights(grid, placement).toarray()
    for i, seed in enumerate(placement.seeds):
        np.testing.assert_array_equal(weights[seed], np.tile(np.eye(len(placement.seeds))[i], (len(seed), 1)))


def test_rigid_pieces_have_one_weight_vector():
    grid = bar(*[1] * 8, *[4] * 3, *[2] * 8)
    weights = voronoi_weights(grid, at_ends(grid)).toarray()
    assert np.ptp(weights[8:11], axis=0).max() == 0
    assert 0.1 < weights[9, 0] < 0.9
    grid = voxel_grid(mixed())
    weights = voronoi_weights(grid, place_frames(grid, at=grid.centers[[0, 400, 700]])).toarray()
    for piece in (0, 1):
        assert np.ptp(weights[grid.piece == piece], axis=0).max() < 1e-15


def test_weight_is_half_on_the_frontier_and_constant_behind_the_last_frame():
    grid = bar(*[1] * 21)
    weights = voronoi_weights(grid, place_frames(grid, at=grid.centers[[4, 10, 18]])).toarray()
    np.testing.assert_allclose(weights[[7, 14]], [[0.5, 0.5, 0], [0, 0.5, 0.5]], atol=1e-6)
    np.testing.assert_array_equal(weights[:5, 0], 1)
    np.testing.assert_array_equal(weights[18:, 2], 1)


def test_symmetric_volume_has_symmetric_weights():
    grid = block(15, 8, 4)
    weights = voronoi_weights(grid, place_frames(grid, at=[[0.025, 0.035, 0.02], [0.125, 0.035, 0.02]])).toarray()
    image = weights[grid.lookup]
    np.testing.assert_allclose(image, image[::-1, :, :, ::-1], atol=1e-14)


def test_one_frame_has_all_the_weight():
    grid = voxel_grid(mixed())
    weights = voronoi_weights(grid, place_frames(grid, at=grid.centers[[5]]))
    assert np.all(weights.toarray() == 1)


def test_chosen_weights_are_gathered():
    grid = voxel_grid(mixed())
    weights = voronoi_weights(grid, place_frames(grid, 6))
    np.testing.assert_array_equal(weights_at(weights, [7, 300, 2], [4, 0]), weights.toarray()[[7, 300, 2]][:, [4, 0]])


def test_gradient_on_the_bar_is_the_ideal_slope():
    grid = bar(*[1] * 7, *[3] * 9, *[2] * 12)
    weights = voronoi_weights(grid, at_ends(grid))
    gradient = weight_gradients(grid, weights, np.arange(28), [0, 1])
    total = 0.01 * np.sum(grid.compliance[1:] + grid.compliance[:-1]) / 2
    full = weights.toarray().min(axis=1) > 5 * NEGLIGIBLE_WEIGHT  # away from the weights that were dropped
    np.testing.assert_allclose(gradient[full, 0, 0], -grid.compliance[full] / total, rtol=1e-5)
    assert np.all(gradient[:, :, 1:] == 0)


def test_gradient_is_in_volume_coordinates_and_zero_in_rigid_pieces():
    volume = mixed()
    grid = voxel_grid(volume)
    weights = voronoi_weights(grid, place_frames(grid, 6))
    everywhere = weight_gradients(grid, weights, np.arange(len(grid.index)), np.arange(6))
    assert np.abs(everywhere.sum(axis=1)).max() < 1e-12
    assert np.all(everywhere[grid.piece >= 0] == 0)
    around, dense = grid.lookup[12:15, 1:4, 1:4], weights.toarray()  # of one material
    slope = [
        (dense[around[2, 1, 1]] - dense[around[0, 1, 1]]) / 0.02,
        (dense[around[1, 2, 1]] - dense[around[1, 0, 1]]) / 0.026,
        (dense[around[1, 1, 2]] - dense[around[1, 1, 0]]) / 0.016,
    ]
    np.testing.assert_allclose(everywhere[around[1, 1, 1]], (volume.axes @ slope).T, atol=1e-11)


def test_gradients_of_some_frames_sum_to_zero():
    grid = bar(*[1] * 21)
    weights = voronoi_weights(grid, place_frames(grid, at=grid.centers[[4, 10, 18]]))
    gradient = weight_gradients(grid, weights, [10], [1])  # frames 0 and 2 have weight at its neighbours
    np.testing.assert_array_equal(gradient, 0)
    dense = weights.toarray()
    w, frames = dense[[9, 10, 11]], [0, 1]
    expected = (w[2, frames] - w[0, frames]) / 0.02
    expected -= w[1, frames] * expected.sum()
    np.testing.assert_allclose(weight_gradients(grid, weights, [10], frames)[0, :, 0], expected, atol=1e-12)


@pytest.mark.parametrize("kind", ["voronoi", "harmonic", "linear"])
def test_every_kind_is_a_partition_of_unity_that_interpolates(kind):
    grid = bar(*[1] * 8, *[4] * 3, *[2] * 8)
    placement = place_frames(grid, at=grid.centers[[0, 5, -1]])
    weights = weights_of(kind).at_voxels(grid, placement)
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-12)
    assert np.array_equal(weights.toarray()[[0, 5, 18]], np.eye(3))
    assert np.ptp(weights.toarray()[8:11], axis=0).max() == 0
    assert weights.has_sorted_indices


def test_subdivisions_reach_the_kernels():
    grid = block(14, 9, 2)
    placement = place_frames(grid, 4)
    assert abs(Voronoi(3).at_voxels(grid, placement) - Voronoi().at_voxels(grid, placement)).max() > 0.01


@pytest.mark.parametrize(
    ("kind", "subdivisions", "words"),
    [
        ("gaussian", 1, "weights is 'gaussian'"),
        ("voronoi", 0, "subdivisions is 0"),
        ("voronoi", 1.5, "subdivisions is 1.5"),
    ],
)
def test_unknown_kernels_are_refused(kind, subdivisions, words):
    grid = bar(1, 1, 1)
    with pytest.raises(MjframesError, match=words):
        weights_of(Voronoi(subdivisions) if kind == "voronoi" else kind).at_voxels(grid, place_frames(grid, 1))
