from __future__ import annotations

import numpy as np
import pytest
from builders.shapes import bar, block, mixed

from mjframes.base.errors import MjframesError
from mjframes.frames.placement import place_frames
from mjframes.volume.grid import voxel_grid
from mjframes.weights.linear import linear_weights


def test_hats_between_neighbours_and_constant_beyond_the_ends():
    grid = block(30, 4, 3)
    placement = place_frames(grid, at=[[0.235, 0.02, 0.01], [0.045, 0.02, 0.01], [0.115, 0.03, 0.02]])
    x = grid.index[:, 0]
    expected = [np.interp(x, [11, 23], [0, 1]), np.interp(x, [4, 11], [1, 0]), np.interp(x, [4, 11, 23], [0, 1, 0])]
    weights = linear_weights(grid, placement)
    np.testing.assert_allclose(weights.toarray(), np.stack(expected, axis=1), atol=1e-15)
    assert weights.has_sorted_indices
    assert weights.data.min() > 0


def test_hats_reproduce_their_coordinate():
    grid = block(24, 3, 3)
    weights = linear_weights(grid, place_frames(grid, at=grid.centers[[0, 8 * 9, 23 * 9]]))
    np.testing.assert_allclose(weights @ np.array([0.0, 8.0, 23.0]), grid.index[:, 0], atol=1e-12)


def test_hats_go_from_edge_to_edge_of_wide_seeds():
    grid = block(30, 4, 3)
    x = grid.index[:, 0]
    cores = [np.flatnonzero(x < 5), np.flatnonzero(x >= 24)]
    placement = place_frames(grid, at=[[0.115, 0.02, 0.01]], cores=cores)
    expected = {
        0: np.interp(x, [4, 11], [1, 0]),
        11: np.interp(x, [4, 11, 24], [0, 1, 0]),
        24: np.interp(x, [11, 24], [0, 1]),
    }
    weights = linear_weights(grid, placement, axis=0).toarray()
    for frame, seeds in enumerate(placement.seeds):
        np.testing.assert_allclose(weights[:, frame], expected[x[seeds].min()], atol=1e-15)


def test_along_another_axis():
    grid = block(12, 20, 3)
    placement = place_frames(grid, at=[[0.015, 0.005, 0.01], [0.105, 0.195, 0.01]])
    assert np.allclose(linear_weights(grid, placement).toarray()[:, 1], grid.index[:, 1] / 19)
    along_x = np.clip((grid.index[:, 0] - 1) / 9, 0, 1)
    assert np.allclose(linear_weights(grid, placement, axis=0).toarray()[:, 1], along_x)


def test_seeds_have_weight_one_and_rigid_pieces_one_vector():
    grid = voxel_grid(mixed())
    piece = grid.piece == 1
    core = np.flatnonzero(grid.index[:, 0] < 2)
    at = (grid.origin + grid.axes @ (grid.spacing * [8.5, 4.5, 0.5]))[None]
    weights = linear_weights(grid, place_frames(grid, at=at, cores=[core]), axis=0).toarray()
    assert np.all(weights[core] == [1, 0])
    assert np.ptp(weights[grid.piece == 0], axis=0).max() == 0
    assert 0.1 < weights[grid.piece == 0][0, 0] < 0.9
    assert np.ptp(weights[piece], axis=0).max() == 0
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-12)


def test_a_single_frame_has_all_weight():
    grid = bar(*[1] * 5)
    assert np.array_equal(linear_weights(grid, place_frames(grid, 1)).toarray(), np.ones((5, 1)))


def test_frames_side_by_side_are_refused():
    grid = block(12, 6, 3)
    placement = place_frames(grid, at=[[0.015, 0.005, 0.01], [0.105, 0.055, 0.01], [0.105, 0.005, 0.01]])
    with pytest.raises(MjframesError, match="frames 1 and 2 share a place along axis 0"):
        linear_weights(grid, placement)
    with pytest.raises(MjframesError, match="axis is 3"):
        linear_weights(grid, placement, axis=3)
