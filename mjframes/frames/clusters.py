"""A coarser graph for the compliance distance: clusters of voxels in place of voxels (the paper, §4.4, made fast).

A cluster is what lies in one block of s³ cells, is of one material and connected within the block (26 neighbours). So
neither a gap nor a thin sheet of another material disappears, however large s. An edge costs the distance of two
clusters' centroids times the mean of their compliances; for s = 1 these are the edges of the voxel graph.
"""

from __future__ import annotations

import heapq
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import sparse

from mjframes.frames.distance import edge_costs
from mjframes.volume.grid import Grid, root_of


class ClusterGraph(NamedTuple):
    """c clusters of n voxels.

    cluster: (n,) int32 of each voxel.
    size: (c,) [voxels].
    middle: (c, 3) mean voxel index.
    compliance: (c,) [1/Pa].
    start: (c + 1,), neighbour, cost: the edges of cluster a are start[a]:start[a + 1], in [m/Pa].
    """

    cluster: NDArray[np.int32]
    size: NDArray[np.int64]
    middle: NDArray[np.float64]
    compliance: NDArray[np.float64]
    start: NDArray[np.int64]
    neighbour: NDArray[np.int32]
    cost: NDArray[np.float64]


def cluster_graph(grid: Grid, block: int) -> ClusterGraph:
    """Return the graph of clusters in blocks of `block`³ cells, 1 for one cluster a voxel."""
    n = len(grid.index)
    cluster = np.arange(n, dtype=np.int32)
    count = _join(grid.index, grid.padded, grid.material, block, cluster) if block > 1 else n
    size = np.bincount(cluster)
    middle = np.stack([np.bincount(cluster, grid.index[:, a]) for a in range(3)], axis=1) / size[:, None]
    compliance = np.empty(count)
    compliance[cluster] = grid.per_material("compliance")[grid.material]
    pairs = np.sort(_pairs(grid.index, grid.padded, cluster))
    first, second = pairs >> 32, pairs & 0xFFFFFFFF
    lengths = np.linalg.norm((middle[second] - middle[first]) * grid.spacing, axis=1)
    cost = edge_costs(lengths, compliance[first], compliance[second])
    ends = np.concatenate([first, second]), np.concatenate([second, first])
    edges = sparse.csr_array(sparse.coo_array((np.tile(cost, 2), ends), shape=(count, count)))
    start, neighbour = edges.indptr.astype(np.int64), edges.indices.astype(np.int32)
    return ClusterGraph(cluster, size, middle, compliance, start, neighbour, np.asarray(edges.data, np.float64))


@njit(cache=True, nogil=True)
def improve(
    graph: ClusterGraph, sources: NDArray[np.int32], distance: NDArray[np.float64], label: NDArray[np.int32]
) -> None:
    """Run Dijkstra's algorithm in place, from `sources` of new distance and label; ties go to the smaller label."""
    heap = [(distance[u], label[u], np.int32(u)) for u in sources]
    heapq.heapify(heap)
    while len(heap) > 0:
        du, lu, u = heapq.heappop(heap)
        if du != distance[u] or lu != label[u]:
            continue  # it got a better offer since, and has been dealt with
        for e in range(graph.start[u], graph.start[u + 1]):
            v = graph.neighbour[e]
            d = du + graph.cost[e]
            if d < distance[v] or (d == distance[v] and lu < label[v]):
                distance[v], label[v] = d, lu
                heapq.heappush(heap, (d, lu, v))


@njit(cache=True, nogil=True)
def _join(
    index: NDArray[np.int32],
    padded: NDArray[np.int32],
    material: NDArray[np.unsignedinteger],
    block: int,
    cluster: NDArray[np.int32],
) -> int:
    """Return the number of clusters; each voxel's, in the order of their first voxels."""
    for v in range(len(cluster)):
        a, b, c = index[v, 0], index[v, 1], index[v, 2]
        low_a, low_b, low_c = a // block * block, b // block * block, c // block * block
        for k in range(-1, 13):  # the neighbours before v, and before all of them the one that touches all others
            x, y, z = a - 1, b, c
            if k >= 0:
                x, y, z = a + k // 9 - 1, b + k // 3 % 3 - 1, c + k % 3 - 1
            if x < low_a or y < low_b or z < low_c or y >= low_b + block or z >= low_c + block:
                continue
            u = padded[x + 1, y + 1, z + 1]
            if u >= 0 and material[u] == material[v]:
                first, second = root_of(cluster, u), root_of(cluster, v)
                cluster[max(first, second)] = min(first, second)
                if k < 0:
                    break
    count = 0
    for v in range(len(cluster)):  # parents come before children, so they have their number already
        if cluster[v] == v:
            cluster[v] = count
            count += 1
        else:
            cluster[v] = cluster[cluster[v]]
    return count


@njit(cache=True, nogil=True)
def _pairs(index: NDArray[np.int32], padded: NDArray[np.int32], cluster: NDArray[np.int32]) -> NDArray[np.int64]:
    """Return the pairs of different clusters with adjacent voxels, each once, as 2³² first + second."""
    pairs = set()
    for v in range(len(cluster)):
        a, b, c = index[v, 0] + 1, index[v, 1] + 1, index[v, 2] + 1
        for k in range(13):
            u = padded[a + k // 9 - 1, b + k // 3 % 3 - 1, c + k % 3 - 1]
            if u >= 0 and cluster[u] != cluster[v]:
                low, high = min(cluster[u], cluster[v]), max(cluster[u], cluster[v])
                pairs.add(np.int64(low) << 32 | np.int64(high))
    return np.array(list(pairs))
