from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import dijkstra
from shapes import bar, block, mixed

from mjframes.distance import compliance_distance, voxel_graph
from mjframes.grid import Grid, voxel_grid


def all_edges(grid: Grid) -> sparse.csr_array:
    """The 26-neighbour graph by brute force."""
    step = np.abs(grid.index[:, None] - grid.index[None]).astype(int)
    u, v = np.nonzero(step.max(axis=2) == 1)
    cost = np.linalg.norm(step[u, v] * grid.spacing, axis=1) * (grid.compliance[u] + grid.compliance[v]) / 2
    return sparse.csr_array((np.maximum(cost, 1e-300), (u, v)))  # SciPy takes a zero for no edge


def test_distance_is_the_shortest_path():
    grid = voxel_grid(mixed())
    sources = [3, 200, 640]
    found = compliance_distance(voxel_graph(grid), sources, label=[0, 1, 2])
    expected = dijkstra(all_edges(grid), indices=sources)
    np.testing.assert_allclose(found.distance, expected.min(axis=0), rtol=1e-6, atol=1e-20)
    assert np.array_equal(found.label, expected.argmin(axis=0))


def test_bar_sums_compliance_along_its_length():
    grid = bar(1, 1, 2, 3)
    found = compliance_distance(voxel_graph(grid), 0)
    np.testing.assert_allclose(
        found.distance, 0.01 * np.cumsum([0, 1e-3, 0.6e-3, (2e-4 + 1.25e-5) / 2]), rtol=1e-6, atol=1e-20
    )


def test_sums_of_edge_costs_are_exact():
    grid = bar(*[1] * 300, spacing=0.0073)
    step = float(np.float32(0.0073e-3))
    assert np.array_equal(compliance_distance(voxel_graph(grid), 0).distance, step * np.arange(300))


def test_a_rigid_piece_is_one_point():
    grid = voxel_grid(mixed())
    found = compliance_distance(voxel_graph(grid), [0, len(grid.index) - 1], label=[0, 1])
    for piece in (0, 1):
        assert np.ptp(found.distance[grid.piece == piece]) == 0
        assert np.ptp(found.label[grid.piece == piece]) == 0


def test_symmetric_volume_has_exactly_symmetric_distances_and_ties_go_to_the_first_label():
    grid = block(19, 18, 7, label=2, spacing=0.0073)
    ends = [grid.lookup[0, 5, 3], grid.lookup[18, 5, 3]]
    found = compliance_distance(voxel_graph(grid), ends, label=[0, 1])
    image = found.distance[grid.lookup]
    assert np.array_equal(image, image[::-1])
    assert np.all(found.label[grid.lookup[9]] == 0)
    other = compliance_distance(voxel_graph(grid), ends, label=[1, 0])
    assert np.all(other.label[grid.lookup[9]] == 0)


def test_later_sources_improve_an_earlier_result():
    grid = voxel_grid(mixed())
    graph = voxel_graph(grid)
    both = compliance_distance(graph, [10, 500], label=[0, 1])
    before = compliance_distance(graph, 10, label=0)
    kept = before.distance.copy()
    after = compliance_distance(graph, 500, label=1, start=before)
    assert np.array_equal(after.distance, both.distance)
    assert np.array_equal(after.label, both.label)
    assert np.array_equal(before.distance, kept)


def test_paths_start_at_their_cost_end_at_their_reach_and_stay_in_their_zone():
    grid = bar(*[1] * 8)
    step = float(np.float32(1e-5))
    zone = np.array([0, 0, 0, 0, 0, 0, 1, 1], np.int32)
    found = compliance_distance(voxel_graph(grid), 1, cost=step, reach=3.5 * step, zone=zone)
    np.testing.assert_allclose(found.distance[:5], step * np.array([2, 1, 2, 3, 4]))
    assert np.all(np.isinf(found.distance[5:]))
    assert np.all(found.label[5:] == -1)
    far = compliance_distance(voxel_graph(grid), 1, zone=zone)
    assert np.array_equal(np.isfinite(far.distance), zone == 0)
