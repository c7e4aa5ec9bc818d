from __future__ import annotations

import numpy as np
import pytest
from builders.shapes import MATERIALS, bar, block, check_kernel, mixed, plate_of_figure_6, thread_of_three_arms

from mjframes.base import threads
from mjframes.base.constants import NEGLIGIBLE_WEIGHT
from mjframes.frames.placement import place_frames
from mjframes.volume.grid import voxel_grid
from mjframes.volume.volume import Volume
from mjframes.weights import voronoi
from mjframes.weights.voronoi import voronoi_weights


@pytest.mark.parametrize("subdivisions", [1, 2, 3, 6, 12])
def test_bar_has_the_ideal_weights_however_often_it_is_subdivided(subdivisions):
    grid = bar(*[1] * 7, *[3] * 5, *[4] * 3, *[2] * 9)
    step = (grid.compliance[1:] + grid.compliance[:-1]) / 2
    ideal = 1 - np.concatenate([[0], np.cumsum(step)]) / step.sum()  # equation (5)
    ideal[np.abs(ideal) < NEGLIGIBLE_WEIGHT] = 0
    weights = voronoi_weights(grid, place_frames(grid, at=grid.centers[[0, -1]]), subdivisions).toarray()
    np.testing.assert_allclose(weights, np.stack([ideal, 1 - ideal], axis=1), atol=1e-6)


def test_interpolation_and_extrapolation_on_a_forked_thread():
    """Frame 0 at distance a from the fork, frame 1 at b < a, frame 2 at the far end of the third arm, at length."""
    grid, at, arm, a, b, length = thread_of_three_arms()
    placement = place_frames(grid, at=at)
    voxels, t = arm[0][15:-1], arm[1][15:-1]
    third = 1 - (length - t) / (b + length)  # frame 2 sees nothing but frame 1, at the end of a thread: linear

    weights = voronoi_weights(grid, placement, 1).toarray()[voxels]
    first = np.maximum(
        0, 1 - (a + t) / (a + b)
    )  # straight on from the seed over the frontier, which lies before the fork
    np.testing.assert_allclose(weights[:, 0] / weights[:, 2], first / third, atol=1e-5)
    assert np.all((weights[:, 0] == 0) == (t > b - 1e-9))

    weights = voronoi_weights(grid, placement, 2).toarray()[voxels]
    half = (a - b) / 2 + t  # from the surface of ½ …
    reach = (length - (a - b) / 2) / 2  # … to that of ¼, there along the third arm, or back into the second one:
    quarter = np.minimum(np.abs(reach - t), t + (3 * b - a) / 4)
    inside = (half / 4 + quarter / 2) / (half + quarter)
    quarter = t - reach
    beyond = np.maximum(0, (half / 4 - quarter / 2) / (half - quarter))
    np.testing.assert_allclose(weights[:, 0] / weights[:, 2], np.where(t < reach, inside, beyond) / third, atol=3e-3)
    assert np.all(weights[t < length - 0.02, 0] > 0)


def test_two_surfaces_may_cross_the_same_edge():
    """Frame 0 is two soft steps c from the fork, frame 1 one of 0.6 c: ½ and ¼ both lie on the edge at the fork."""
    grid, at, arm, _, _, length = thread_of_three_arms(2, 1, label=2)
    weights = voronoi_weights(grid, place_frames(grid, at=at), 3).toarray()[arm[0][5:-5]]
    t, c = arm[1][5:-5], 0.01 * np.sqrt(2)
    third = 1 - (length - t) / (0.6 * c + length)
    quarter = 0.05 * c + t
    eighth = np.minimum(np.abs((length - 0.05 * c) / 2 - t), t + 0.275 * c)
    before = t < (length - 0.05 * c) / 2
    expected = (quarter / 8 + eighth / 4) / (quarter + eighth)
    np.testing.assert_allclose((weights[:, 0] / weights[:, 2])[before], (expected / third)[before], rtol=1e-5)


def test_figure_6():
    grid, placement, places = plate_of_figure_6()
    weight = {n: voronoi_weights(grid, placement, n).toarray()[:, 0] for n in (1, 2, 5)}
    # One subdivision: the extrapolation ends on the way into the arm, where d_1 < 2 d_½.
    assert np.all(weight[1][places["arm, upper half"]] == 0)
    assert np.all(weight[1][places["arm, foot"]] > 0.1)
    # Two: it reaches all of the arm but not what lies behind the other node.
    assert np.all(weight[2][places["arm, upper half"]] > 0.01)
    assert np.all(weight[2][places["right end"]] == 0)
    # Five: unrealistically, that too.
    assert np.all(weight[5][places["right end"]] > 0.05)
    assert np.all(weight[5][places["right end"]] < 0.1)
    for w in weight.values():
        assert np.all(w[places["between the nodes"]] > 0.35)


CASES = {
    "mixed": (voxel_grid(mixed()), 6),
    "plate": (block(20, 12, 1), 5),
    "thread": (thread_of_three_arms()[0], 4),
    "bar with bones": (bar(*[4] * 6, *[1] * 8, *[4] * 3, *[2] * 8, *[4] * 9), 3),
    "single frame": (block(5, 4, 3), 1),
    "frames side by side": (block(4, 3, 2), 12),
}


@pytest.mark.parametrize("subdivisions", [1, 2, 5])
@pytest.mark.parametrize("name", CASES)
def test_partition_of_unity_interpolating_and_constant_in_rigid_pieces(name, subdivisions):
    grid, frames = CASES[name]
    placement = place_frames(grid, frames)
    weights = voronoi_weights(grid, placement, subdivisions)
    assert weights.has_sorted_indices
    check_kernel(grid, placement, weights)


def test_subdivisions_converge():
    grid = block(24, 14, 3)
    placement = place_frames(grid, 5)
    dense = [voronoi_weights(grid, placement, n).toarray() for n in (1, 4, 8, 9)]
    assert np.abs(dense[3] - dense[2]).max() < 0.01
    assert np.abs(dense[3] - dense[2]).max() < 0.2 * np.abs(dense[3] - dense[1]).max()


def test_the_number_of_threads_changes_nothing(monkeypatch: pytest.MonkeyPatch):
    grid = voxel_grid(mixed())
    placement = place_frames(grid, 6)
    found = []
    for count in (1, 3):
        monkeypatch.setattr(threads, "workers", lambda count=count: count)
        monkeypatch.setattr(voronoi, "workers", lambda count=count: count)
        found.append(voronoi_weights(grid, placement, 3))
    assert np.array_equal(found[0].data, found[1].data)
    assert np.array_equal(found[0].indices, found[1].indices)


def test_extreme_contrast_takes_the_ordered_queue():
    labels = np.ones((14, 8, 5), np.uint8)
    labels[4:8, 1:7] = 3
    materials = {1: MATERIALS[1], 3: type(MATERIALS[1])(1e9, 0.3, 1000)}
    grid = voxel_grid(Volume.from_labels(labels, 0.01, materials))
    weights = voronoi_weights(grid, place_frames(grid, at=[[0.005, 0.035, 0.02], [0.135, 0.035, 0.02]])).toarray()
    stiff = weights[grid.material == 1]
    assert np.ptp(stiff[:, 0]) < 1e-3
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-12)
