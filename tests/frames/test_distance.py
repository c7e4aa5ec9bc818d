from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from builders.shapes import bar, block, mixed
from scipy import sparse
from scipy.sparse.csgraph import dijkstra

import mjframes
from mjframes.frames.distance import VoxelGraph, compliance_distance, edge_costs, sweep, voxel_graph
from mjframes.volume.grid import Grid, voxel_grid
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume


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


def test_sources_start_at_their_cost():
    grid = bar(*[1] * 8)
    step = float(np.float32(1e-5))
    found = compliance_distance(voxel_graph(grid), [1, 7], label=[0, 1], cost=[step, 3.5 * step])
    np.testing.assert_allclose(found.distance, step * np.array([2, 1, 2, 3, 4, 5, 4.5, 3.5]))
    assert found.label.tolist() == [0] * 6 + [1] * 2


def test_extreme_contrast_is_exact_too():
    """More than the ring of buckets holds: the bucket at hand is kept in order."""
    labels = np.ones((12, 7, 5), np.uint8)
    labels[3:9, 1:6] = 2
    labels[5:7, :, 2] = 3
    materials = {1: Material(1e3, 0.3, 1000), 2: Material(1e9, 0.3, 1000), 3: Material(2e5, 0.3, 1000)}
    grid = voxel_grid(Volume.from_labels(labels, 0.01, materials))
    graph = voxel_graph(grid)
    assert graph.ordered
    found = compliance_distance(graph, [0, 300], label=[0, 1])
    expected = dijkstra(all_edges(grid), indices=[0, 300])
    np.testing.assert_allclose(found.distance, expected.min(axis=0), rtol=1e-6)
    assert np.array_equal(found.label, expected.argmin(axis=0))


NO_ZONE, NO_BOUND = np.empty(0, np.int32), np.empty(0)


def sweep_from(graph: VoxelGraph, source: int, zone=NO_ZONE, bound=NO_BOUND, reach: float | None = None) -> np.ndarray:
    n = len(graph.cell)
    distance, rank, visited = np.full(n, np.inf), np.zeros(n), np.zeros(n, np.int32)
    distance[source], rank[source], visited[0] = 0, -(reach or 0), source
    count = sweep(graph, zone, bound, reach is not None, distance, rank, visited, 1)
    assert set(visited[:count]) == set(np.flatnonzero(np.isfinite(distance)))
    return distance


def test_paths_stay_in_their_zone_below_their_bound_and_end_at_their_reach():
    graph = voxel_graph(bar(*[1] * 8))
    step = float(np.float32(1e-5))
    zone = np.array([0, 0, 0, 0, 0, 0, 1, 1], np.int32)
    assert np.array_equal(np.isfinite(sweep_from(graph, 1, zone=zone)), zone == 0)
    bound = step * np.array([9, 9, 9, 9, 3, 9, 9, 9])
    assert np.array_equal(np.flatnonzero(np.isfinite(sweep_from(graph, 1, bound=bound))), [0, 1, 2, 3])
    assert np.array_equal(np.flatnonzero(np.isfinite(sweep_from(graph, 1, reach=2.5 * step))), [0, 1, 2, 3, 4])


def test_edge_costs_have_the_bits_of_a_float():
    cost = edge_costs(0.1, 1 / 3, 1 / 7)
    assert cost == np.float32(cost)


@pytest.mark.slow
def test_a_sweep_is_compiled_once(tmp_path: Path) -> None:
    """For one set of types, whoever calls it: each more costs everybody's first build two seconds."""
    program = """
import numpy as np
from builders.shapes import bar
from mjframes.frames.distance import nearest_sources, sweep, voxel_graph
from mjframes.frames.placement import Placement
from mjframes.weights.voronoi import voronoi_weights
grid = bar(1, 1, 2, 2, 1, 1)
nearest_sources(voxel_graph(grid), [0])
voronoi_weights(grid, Placement(np.zeros((2, 3)), (np.array([0]), np.array([5]))), 2)
print(len(sweep.signatures))
"""
    folders = os.pathsep.join([str(Path(mjframes.__file__).parents[1]), str(Path(__file__).parents[1])])
    environment = {**os.environ, "PYTHONPATH": folders, "NUMBA_CACHE_DIR": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, env=environment, check=True)
    assert done.stdout.split()[-1] == "1"
