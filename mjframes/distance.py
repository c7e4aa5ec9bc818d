"""Compliance distance on the voxels: d_c(a, b) = min over paths of ∫ ds / E (the paper, equation (5) and §4.2).

Dijkstra's algorithm on the 26-neighbour voxel graph. An edge costs its length [m] times the mean of its two voxels'
compliances [1/Pa], so a rigid piece (compliance 0) is one point of this metric.

Edge costs are rounded to float32 and summed in float64. Those sums are exact (24 bits of cost leave 29 bits for the
contrast of the materials and the length of the path). So paths of the same edges in another order tie exactly, and the
rule for ties chooses among them, not rounding.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from mjframes.grid import Grid


@dataclass(frozen=True, eq=False)
class VoxelGraph:
    """The 26-neighbour graph of n voxels; a border of outside cells makes bounds checks needless.

    cell: (n,) int64, the voxel's place in lookup.  lookup: (c,) int32, the padded image of voxel numbers, −1 outside.
    offset: (26,) int64, from a cell to its neighbours.  length: (26,) [m].  compliance: (n,) [1/Pa].
    """

    cell: NDArray[np.int64]
    lookup: NDArray[np.int32]
    offset: NDArray[np.int64]
    length: NDArray[np.float64]
    compliance: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Reached:
    """What a sweep finds at each of the n voxels: the best offer, carried there from its source.

    distance: (n,) [m/Pa], inf where nothing arrived.  label: (n,) int32 of the source, −1 there.
    reach: (n,) [m/Pa] of the source, 0 there.
    """

    distance: NDArray[np.float64]
    label: NDArray[np.int32]
    reach: NDArray[np.float64]


def voxel_graph(grid: Grid) -> VoxelGraph:
    """The graph whose shortest paths are compliance distances."""
    lookup = np.pad(grid.lookup, 1, constant_values=-1)
    strides = np.array([lookup.shape[1] * lookup.shape[2], lookup.shape[2], 1], np.int64)
    steps = np.argwhere(np.ones((3, 3, 3))) - 1
    steps = steps[np.any(steps != 0, axis=1)]
    return VoxelGraph(
        cell=(grid.index + 1) @ strides,
        lookup=lookup.ravel(),
        offset=steps @ strides,
        length=np.linalg.norm(steps * grid.spacing, axis=1),
        compliance=grid.compliance,
    )


def compliance_distance(
    graph: VoxelGraph,
    sources: ArrayLike,
    *,
    label: ArrayLike = 0,
    cost: ArrayLike = 0.0,
    reach: ArrayLike = np.inf,
    zone: NDArray[np.int32] | None = None,
    start: Reached | None = None,
) -> Reached:
    """The nearest of several sources at every voxel; its label makes the Voronoi cells.

    sources: (s,) voxel numbers.  label, cost, reach: one for all or (s,) each: what the source is called, the distance
    it starts with [m/Pa], and the distance at which its paths end (they are not continued from there on).
    zone: (n,) int32; paths stay among voxels of equal zone.
    start: an earlier result, which the new sources only improve.
    At equal distance the larger reach wins, then the smaller label.
    """
    n = len(graph.cell)
    ids = np.atleast_1d(np.asarray(sources, np.int64))
    if start is None:
        found = Reached(np.full(n, np.inf), np.full(n, -1, np.int32), np.zeros(n))
    else:
        found = Reached(start.distance.copy(), start.label.copy(), start.reach.copy())
    _sweep(
        graph.cell,
        graph.lookup,
        graph.offset,
        graph.length,
        graph.compliance,
        np.zeros(n, np.int32) if zone is None else zone,
        ids,
        np.array(np.broadcast_to(np.asarray(cost, np.float64), ids.shape)),
        np.array(np.broadcast_to(np.asarray(reach, np.float64), ids.shape)),
        np.array(np.broadcast_to(np.asarray(label, np.int32), ids.shape)),
        found.distance,
        found.reach,
        found.label,
    )
    return found


@njit(cache=True, inline="always")
def edge_cost(length: float, compliance_u: float, compliance_v: float) -> float:
    """Cost of an edge [m/Pa], with the 24 bits that make sums exact."""
    return np.float64(np.float32(length * 0.5 * (compliance_u + compliance_v)))


@njit(cache=True, inline="always")
def _better(d, reach, label, d_old, reach_old, label_old):
    """Lexicographic: distance, then reach (descending), then label."""
    if d != d_old:
        return d < d_old
    if reach != reach_old:
        return reach > reach_old
    return label < label_old


@njit(cache=True)
def _raise(heap, place, hole, v, distance, reach, label):
    """Put voxel v into the hole of a 4-ary heap and lift it to its place."""
    d, r, t = distance[v], reach[v], label[v]
    while hole > 0:
        parent = (hole - 1) >> 2
        u = heap[parent]
        if not _better(d, r, t, distance[u], reach[u], label[u]):
            break
        heap[hole] = u
        place[u] = hole
        hole = parent
    heap[hole] = v
    place[v] = hole


@njit(cache=True)
def _pop(heap, size, place, distance, reach, label):
    """Take the best voxel off a 4-ary heap of `size` entries."""
    top = heap[0]
    size -= 1
    if size > 0:
        v = heap[size]
        d, r, t = distance[v], reach[v], label[v]
        hole = 0
        while True:
            first = 4 * hole + 1
            if first >= size:
                break
            best = first
            b = heap[best]
            for child in range(first + 1, min(first + 4, size)):
                c = heap[child]
                if _better(distance[c], reach[c], label[c], distance[b], reach[b], label[b]):
                    best = child
                    b = c
            if not _better(distance[b], reach[b], label[b], d, r, t):
                break
            heap[hole] = b
            place[b] = hole
            hole = best
        heap[hole] = v
        place[v] = hole
    return top


@njit(cache=True)
def _sweep(
    cell,
    lookup,
    offset,
    length,
    compliance,
    zone,
    sources,
    source_cost,
    source_reach,
    source_label,
    distance,
    reach,
    label,
):
    """Dijkstra's algorithm; improves distance, reach and label in place."""
    heap = np.empty(len(cell), np.int32)
    place = np.full(len(cell), -1, np.int32)  # where a voxel is in the heap; −1: not in it
    size = 0
    for s in range(len(sources)):
        v = sources[s]
        d, r, t = source_cost[s], source_reach[s], source_label[s]
        if _better(d, r, t, distance[v], reach[v], label[v]):
            distance[v], reach[v], label[v] = d, r, t
            if place[v] < 0:
                place[v] = size
                size += 1
            _raise(heap, place, place[v], v, distance, reach, label)
    while size > 0:
        u = _pop(heap, size, place, distance, reach, label)
        size -= 1
        place[u] = -1
        du, r, t = distance[u], reach[u], label[u]
        if du >= r:
            continue
        cu, here, own = compliance[u], cell[u], zone[u]
        for k in range(len(offset)):
            v = lookup[here + offset[k]]
            if v < 0 or zone[v] != own:
                continue
            d = du + edge_cost(length[k], cu, compliance[v])
            if _better(d, r, t, distance[v], reach[v], label[v]):
                distance[v], reach[v], label[v] = d, r, t
                if place[v] < 0:
                    place[v] = size
                    size += 1
                _raise(heap, place, place[v], v, distance, reach, label)
