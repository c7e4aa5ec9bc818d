from __future__ import annotations

import numpy as np
import pytest
from builders.shapes import bar, block, mixed

from mjframes.frames.clusters import ClusterGraph, cluster_graph, improve
from mjframes.frames.distance import compliance_distance, voxel_graph
from mjframes.volume.grid import voxel_grid


def nearest(graph: ClusterGraph, sources: list[int]) -> tuple[np.ndarray, np.ndarray]:
    distance, label = np.full(len(graph.size), np.inf), np.full(len(graph.size), -1, np.int32)
    distance[sources], label[sources] = 0.0, np.arange(len(sources))
    improve(graph, np.array(sources), distance, label)
    return distance, label


def test_clusters_of_single_voxels_are_the_voxel_graph():
    grid = voxel_grid(mixed())
    found = compliance_distance(voxel_graph(grid), [3, 200, 640], [0, 1, 2])
    distance, label = nearest(cluster_graph(grid, 1), [3, 200, 640])
    np.testing.assert_allclose(distance, found.distance, rtol=1e-6, atol=1e-20)
    assert np.array_equal(label[distance > 0], found.label[distance > 0])


def test_ties_go_to_the_smaller_label():
    for sources in ([0, 8], [8, 0]):
        assert nearest(cluster_graph(bar(*[1] * 9), 1), sources)[1][4] == 0


@pytest.mark.parametrize("size", [2, 3, 5])
def test_a_cluster_is_what_is_connected_in_a_block_and_of_one_material(size):
    grid = voxel_grid(mixed())
    graph = cluster_graph(grid, size)
    key = np.column_stack([grid.index // size, grid.material])
    for cluster in range(len(graph.size)):
        inside = graph.cluster == cluster
        assert len(np.unique(key[inside], axis=0)) == 1
        assert graph.size[cluster] == np.count_nonzero(inside)
        np.testing.assert_allclose(graph.middle[cluster], grid.index[inside].mean(axis=0))
    # Parts of one block and one material are apart.
    first, second = np.nonzero(np.abs(grid.index[:, None] - grid.index[None]).max(axis=2) == 1)
    together = (key[first] == key[second]).all(axis=1)
    assert np.array_equal(graph.cluster[first[together]], graph.cluster[second[together]])


def test_distances_of_clusters_are_near_those_of_voxels():
    grid = block(48, 24, 12)
    graph = cluster_graph(grid, 4)
    source = grid.lookup[1, 1, 1]
    exact = compliance_distance(voxel_graph(grid), source).distance
    coarse = nearest(graph, [int(graph.cluster[source])])[0][graph.cluster]
    assert np.abs(coarse - exact).max() < 0.15 * exact.max()
