from __future__ import annotations

import numpy as np
import pytest
from builders.shapes import MATERIALS, bar, block, mixed

from mjframes.base.errors import MjframesError
from mjframes.frames.distance import compliance_distance, voxel_graph
from mjframes.frames.placement import CLUSTERS, Placement, _clusters, place_frames
from mjframes.volume.grid import Grid, voxel_grid
from mjframes.volume.volume import Volume


def voxels(placement: Placement) -> list[int]:
    return [int(s[0]) for s in placement.seeds]


def test_frames_spread_evenly_over_a_homogeneous_bar():
    grid = bar(*[1] * 31)
    placement = place_frames(grid, 3)
    np.testing.assert_allclose(np.sort(placement.centers[:, 0]), [0.05, 0.155, 0.26], atol=0.011)
    np.testing.assert_allclose(placement.centers, grid.centers[voxels(placement)])


def test_frames_gather_where_the_material_is_compliant():
    grid = bar(*[1] * 15, *[3] * 15)
    assert np.count_nonzero(place_frames(grid, 4).centers[:, 0] < 0.15) >= 3


def test_a_frame_is_at_the_centre_of_the_compliance_of_its_cell():
    grid = bar(*[1] * 10, *[3] * 30)
    assert 0.03 < place_frames(grid, 1).centers[0, 0] < 0.08  # the middle of all would be 0.2


def test_every_rigid_piece_has_a_frame_largest_first():
    grid = voxel_grid(mixed())
    placement = place_frames(grid, 5)
    assert np.array_equal(placement.seeds[0], np.flatnonzero(grid.piece == 0))
    assert np.array_equal(placement.seeds[1], np.flatnonzero(grid.piece == 1))
    assert np.count_nonzero(grid.piece == 0) > np.count_nonzero(grid.piece == 1)
    assert [len(s) for s in placement.seeds[2:]] == [1, 1, 1]
    np.testing.assert_allclose(placement.centers[0], grid.centers[grid.piece == 0].mean(axis=0))


def test_with_few_frames_only_the_largest_pieces_have_one():
    grid = bar(4, 4, 1, 1, 4, 4, 4, 1, 4)
    assert [s.tolist() for s in place_frames(grid, 2).seeds] == [[4, 5, 6], [0, 1]]


def cost(grid: Grid, placement: Placement) -> float:
    label = np.repeat(np.arange(len(placement.seeds)), [len(s) for s in placement.seeds])
    found = compliance_distance(voxel_graph(grid), np.concatenate(placement.seeds), label=label)
    return float(grid.compliance @ found.distance**2)


def test_relaxation_brings_voxels_nearer_than_sampling(monkeypatch: pytest.MonkeyPatch):
    grid = block(20, 10, 5)
    relaxed = place_frames(grid, 5)
    monkeypatch.setattr("mjframes.frames.placement.LLOYD_ITERATIONS", 0)
    monkeypatch.setattr("mjframes.frames.placement.FINE_ITERATIONS", 0)
    assert cost(grid, relaxed) < 0.6 * cost(grid, place_frames(grid, 5))


def test_same_seed_same_frames():
    grid = block(12, 7, 5)
    assert voxels(place_frames(grid, 4, seed=3)) == voxels(place_frames(grid, 4, seed=3))


def test_all_places_can_be_taken():
    grid = bar(1, 4, 4, 1, 1)
    assert sorted(voxels(place_frames(grid, 4))) == [0, 1, 3, 4]


def test_given_positions_are_kept():
    grid = voxel_grid(mixed())
    in_bone = int(np.flatnonzero(grid.piece == 1)[2])
    at = grid.centers[[0, in_bone]] + 0.002
    placement = place_frames(grid, at=at)
    assert placement.seeds[0].tolist() == [0]
    assert np.array_equal(placement.seeds[1], np.flatnonzero(grid.piece == 1))
    assert len(place_frames(grid, 2, at=at).seeds) == 2


def test_distance_from_the_volume_counts_voxels_along_its_axes():
    volume = mixed()
    grid = voxel_grid(volume)
    outside = grid.centers[0] - volume.axes[:, 1] * 0.013 * 1.9
    assert place_frames(grid, at=[outside]).seeds[0].tolist() == [0]
    with pytest.raises(MjframesError, match=r"2\.3 voxels away"):
        place_frames(grid, at=[grid.centers[0] - volume.axes[:, 2] * 0.008 * 2.3])


@pytest.mark.parametrize(
    ("frames", "at", "words"),
    [
        (0, None, "frames is 0"),
        (6, None, "from 1 to 5"),
        (None, None, "frames is None"),
        (2.0, None, "frames is 2.0"),
        (3, [[0, 0, 0]], "at has 1 positions"),
        (None, [[0.1, 0.005, 0.005]], r"at\[0\] = .* 4.5 voxels away"),
        (None, [[0.005] * 3, [0.006] * 3], r"at\[0\] and at\[1\] fall into the same voxel"),
        (None, [[0.015, 0, 0], [0.025, 0, 0]], "same rigid piece"),
        (None, [0.0, 0.0, 0.0], r"\(n, 3\)"),
        (None, [[0, 0, np.nan]], r"\(n, 3\)"),
        (None, "center", r"\(n, 3\)"),
    ],
)
def test_what_cannot_be_placed_is_named(frames, at, words):
    with pytest.raises(MjframesError, match=words):
        place_frames(bar(1, 4, 4, 1, 1, 1), frames, at=at)


@pytest.mark.parametrize("shape", [(60, 50, 12), (400, 90, 1), (36000, 1, 1)])
def test_clusters_place_frames_as_well_as_voxels(shape, monkeypatch: pytest.MonkeyPatch):
    grid = block(*shape)
    assert 1000 < cluster_count(grid, 12) < 2 * CLUSTERS
    coarse = cost(grid, place_frames(grid, 12))
    monkeypatch.setattr("mjframes.frames.placement.CLUSTERS", 10**9)
    assert coarse < 1.1 * cost(grid, place_frames(grid, 12))


def cluster_count(grid: Grid, frames: int) -> int:
    return len(_clusters(grid, frames, [])[0].size)


def test_clusters_see_gaps():
    labels = np.ones((60, 41, 30), int)
    labels[1:, 20] = 0  # two slabs that only one layer of voxels joins
    grid = voxel_grid(Volume.from_labels(labels, 0.01, MATERIALS))
    graph, _, block_size = _clusters(grid, 4, [])
    assert block_size > 1
    side = grid.index[:, 1] > 20
    free = grid.index[:, 0] >= block_size
    assert not set(graph.cluster[side & free]) & set(graph.cluster[~side & free])
    placement = place_frames(grid, 4)
    assert np.count_nonzero(placement.centers[:, 1] > 0.205) == 2


def test_hundreds_of_frames():
    grid = block(30, 30, 12)
    placement = place_frames(grid, 300)
    assert len(set(voxels(placement))) == 300
    with_one = np.array(
        [np.count_nonzero((grid.index[voxels(placement)] // 6 == cell).all(axis=1)) for cell in np.ndindex(5, 5, 2)]
    )
    assert with_one.min() >= 1


def test_cores_come_first_and_stay():
    grid = block(20, 10, 5)
    left, right = np.flatnonzero(grid.index[:, 0] == 0), np.flatnonzero(grid.index[:, 0] == 19)
    placement = place_frames(grid, 1, cores=[right, left])
    assert np.array_equal(placement.seeds[0], right)
    assert np.array_equal(placement.seeds[1], left)
    np.testing.assert_allclose(placement.centers[2], [0.1, 0.05, 0.025], atol=0.011)
    assert len(place_frames(grid, 0, cores=[left]).seeds) == 1
    assert len(place_frames(grid, at=[[0.1, 0.05, 0.02]], cores=[left]).seeds) == 2


def test_a_core_takes_the_rigid_piece_it_touches():
    grid = voxel_grid(mixed())
    core = [0, int(np.flatnonzero(grid.piece == 1)[0])]
    placement = place_frames(grid, 2, cores=[core])
    assert np.array_equal(placement.seeds[0], np.union1d([0], np.flatnonzero(grid.piece == 1)))
    assert np.array_equal(placement.seeds[1], np.flatnonzero(grid.piece == 0))
    assert len(placement.seeds[2]) == 1


@pytest.mark.parametrize(
    ("cores", "at", "words"),
    [
        ([[0], [1, 0]], None, r"cores\[0\] and cores\[1\] overlap"),
        ([[2], [4]], None, "share a rigid piece"),
        ([[]], None, r"cores\[0\] must be numbers"),
        ([[9]], None, r"from 0 to 7"),
        ([[0.5]], None, r"cores\[0\] must be numbers"),
        ([[0, 1]], [[0.012, 0.005, 0.005]], r"at\[0\] falls into cores\[0\]"),
        ([[0, 1]], None, "frames is 9; it must be an integer from 0 to 4"),
    ],
)
def test_wrong_cores_are_named(cores, at, words):
    with pytest.raises(MjframesError, match=words):
        place_frames(bar(1, 1, 4, 4, 4, 1, 1, 1), None if at else 9, at, cores=cores)


def test_cores_leave_room_for_large_numbers_of_frames():
    """Cores in every cluster: clusters of single voxels are what is left."""
    grid = block(40, 40, 12)
    core = np.flatnonzero((grid.index % 2 == 0).all(axis=1))
    placement = place_frames(grid, 20, cores=[core])
    assert not set(voxels(placement)[1:]) & set(core.tolist())
    assert len(set(voxels(placement)[1:])) == 20
