"""Compliance distance on the voxels: d_c(a, b) = min over paths of ∫ ds / E (the paper, equation (5) and §4.2).

Dijkstra's algorithm on the 26-neighbour voxel graph. An edge costs its length [m] times the mean of its two voxels'
compliances [1/Pa]. A rigid piece (compliance 0) is one point of this metric: its first voxel is the node that stands
for all of it.

The queue is a ring of buckets (Dial 1969) as wide as the cheapest edge: the nodes of one bucket cannot improve each
other, so their order does not matter and a step costs O(1). With materials too different for that, the bucket at hand
is kept in a heap.

Edge costs are rounded to float32 and summed in float64. Those sums are exact (24 bits of cost leave 29 bits for the
contrast of the materials and the length of the path). So paths of the same edges in another order tie exactly, and the
rule for ties chooses among them, not rounding.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from mjframes.base.rows import members_of
from mjframes.volume.grid import Grid

Integer = int | np.integer  # loops say np.int64(0), which compiles to one type where 0 compiles to two

BUCKETS = 1 << 14  # [-] at most in the ring: that many empty ones are still skipped faster than a heap is kept
BUCKET_MARGIN = 1e-6  # [-] by which a bucket is narrower than the cheapest edge, for rounding


class VoxelGraph(NamedTuple):
    """The 26-neighbour graph of n voxels; a border of outside cells makes bounds checks needless.

    lookup: (c,) int32, the padded image of nodes, −1 outside.
    cell: (n,) the voxel's place in it.
    node: (n,) int32 the voxel that stands for each: the first of its rigid piece, else itself.
    offset: (26,) int64, from a cell to its neighbours.
    material: (n,) unsigned.
    cost: (m, 26, m) [m/Pa] of an edge by the material it leaves, its direction and the material it enters.
    piece: (n,) int32, −1 where soft.
    shell: the cells of the pieces next to soft ones, from start[piece] on.
    width: of a bucket [m/Pa].
    slots: how many make the ring, a power of two.
    ordered: if edges may be narrower.
    """

    lookup: NDArray[np.int32]
    cell: NDArray[np.integer]
    node: NDArray[np.int32]
    offset: NDArray[np.int64]
    material: NDArray[np.unsignedinteger]
    cost: NDArray[np.float64]
    piece: NDArray[np.int32]
    start: NDArray[np.int64]
    shell: NDArray[np.integer]
    width: float
    slots: int
    ordered: bool


@dataclass(frozen=True, eq=False)
class Reached:
    """The nearest source of every voxel.

    distance: (n,) [m/Pa], inf where none is.
    label: (n,) int32, −1 there.
    """

    distance: NDArray[np.float64]
    label: NDArray[np.int32]


def edge_costs(lengths: ArrayLike, first: ArrayLike, second: ArrayLike) -> NDArray[np.float64]:
    """Return costs [m/Pa] of edges from their lengths [m] and the compliances [1/Pa] of their ends, in the 24 bits that
    make sums exact.
    """
    exact = np.asarray(lengths) * 0.5 * (np.asarray(first) + np.asarray(second))
    return exact.astype(np.float32).astype(np.float64)


def voxel_graph(grid: Grid) -> VoxelGraph:
    """Return the graph whose shortest paths are compliance distances."""
    shape = grid.padded.shape
    strides = np.array([shape[1] * shape[2], shape[2], 1], np.int64)
    steps = np.argwhere(np.ones((3, 3, 3))) - 1
    steps = steps[np.any(steps != 0, axis=1)]
    compliance = grid.per_material("compliance")
    lengths = np.linalg.norm(steps * grid.spacing, axis=1)
    cost = edge_costs(lengths[None, :, None], compliance[:, None, None], compliance[None, None, :])
    cell = _cells(grid.index, strides, np.empty(len(grid.index), np.min_scalar_type(-int(grid.padded.size))))
    lookup, node, start, shell = grid.padded.ravel(), np.arange(len(cell), dtype=np.int32), np.zeros(1, int), cell[:0]
    if (pieces := int(grid.piece.max()) + 1) > 0:
        lookup, node, is_shell = _collapse(lookup, cell, steps @ strides, grid.piece)
        shells = members_of(np.where(is_shell, grid.piece, -1), pieces)
        start, shell = np.cumsum([0, *map(len, shells)]), cell[np.concatenate(shells)]
    positive = cost[cost > 0] if (cost > 0).any() else np.ones(1)
    width = max(float(positive.min()) * (1 - BUCKET_MARGIN), float(positive.max()) / (BUCKETS - 4))
    return VoxelGraph(
        lookup=lookup,
        cell=cell,
        node=node,
        offset=steps @ strides,
        material=grid.material,
        cost=cost,
        piece=grid.piece,
        start=start,
        shell=shell,
        width=width,
        slots=1 << int(positive.max() / width + 2).bit_length(),
        ordered=bool(positive.min() < width),
    )


def nearest_sources(graph: VoxelGraph, sources: ArrayLike, label: ArrayLike = 0, cost: ArrayLike = 0.0) -> Reached:
    """Return the nearest of several sources at every *node*; its label makes the Voronoi cells.

    sources: (s,) voxel numbers.  label, cost: one for all or (s,) each: what the source is called, and the distance it
    starts with [m/Pa].  At equal distance the smaller label wins.
    Voxels for which another one stands have none, as if they were never reached.
    """
    n = len(graph.cell)
    ids = graph.node[np.atleast_1d(np.asarray(sources, np.int64))]
    distance, rank = np.full(n, np.inf), np.full(n, -1.0)
    visited = np.empty(n, np.int32)
    costs = np.array(np.broadcast_to(np.asarray(cost, np.float64), ids.shape))
    labels = np.array(np.broadcast_to(np.asarray(label, np.float64), ids.shape))
    count = _offer_all(ids, costs, labels, distance, rank, visited)
    sweep(graph, np.empty(0, np.int32), np.empty(0), False, distance, rank, visited, count)
    return Reached(distance, rank.astype(np.int32))


def sources_of(seeds: Sequence[NDArray[np.integer]]) -> tuple[NDArray[np.integer], NDArray[np.int64]]:
    """Return the voxels of several seeds as sources, and the label of each: the number of its seed."""
    return np.concatenate(seeds), np.repeat(np.arange(len(seeds)), [len(seed) for seed in seeds])


def compliance_distance(graph: VoxelGraph, sources: ArrayLike, label: ArrayLike = 0, cost: ArrayLike = 0.0) -> Reached:
    """Return what `nearest_sources` does, but at every voxel."""
    found = nearest_sources(graph, sources, label, cost)
    return Reached(found.distance[graph.node], found.label[graph.node]) if len(graph.start) > 1 else found


@njit(cache=True, nogil=True)
def sweep(
    graph: VoxelGraph,
    zone: NDArray[np.int32],
    bound: NDArray[np.float64],
    cut: bool | np.bool_,
    distance: NDArray[np.float64],
    rank: NDArray[np.float64],
    visited: NDArray[np.int32],
    count: Integer,
) -> Integer:
    """Run Dijkstra's algorithm from the `count` first of `visited`, which have a distance; return how many it visited.

    distance: (n,) inf where unvisited.  rank: (n,) carried from the source; at equal distance the smaller wins.
    visited: (n,) int32, gets the nodes visited.
    zone: (n,) or empty: paths stay among nodes of equal zone.
    bound: (n,) [m/Pa] or empty: only smaller distances count.
    cut: paths are not continued from where the distance is −rank or more.

    Numba compiles this anew for each combination of types, and for literal numbers and bools: callers have the same.
    """
    zoned, bounded = len(zone) > 0, len(bound) > 0
    scale = 1.0 / graph.width
    one_material, uniform = len(graph.cost) == 1, graph.cost[0, :, 0].copy()
    mask = graph.slots - 1
    head = np.full(graph.slots, -1, np.int32)  # each bucket is a linked list of entries
    item: Any = np.empty(1024, np.int32)
    link: Any = np.arange(1, 1025).astype(np.int32)  # to the next entry, of a bucket or among the free ones
    link[-1] = -1
    free = 0
    heap: Any = [(0.0, np.int32(-1)) for _ in range(0)]  # empty, of entries of this type
    first = visited[:count].copy()
    begin = distance[first]
    order = np.argsort(begin)
    sources, injected = count, 0
    waiting, bucket = 0, np.int64(0)
    while True:
        if waiting == 0:
            if injected == sources:
                break
            bucket = np.int64(begin[order[injected]] * scale)
        entry = head[bucket & mask]
        head[bucket & mask] = -1
        while True:
            # The next node of this bucket: a source, an entry of its list, or in an ordered one the heap's nearest.
            u = np.int32(-1)
            if injected < sources and np.int64(begin[order[injected]] * scale) == bucket:
                u = first[order[injected]]
                injected += 1
            elif entry >= 0:
                u = item[entry]
                following = link[entry]
                link[entry] = free
                free = entry
                entry = following
                waiting -= 1
            if u >= 0:
                if np.int64(distance[u] * scale) != bucket:
                    continue  # it got a better offer since, and has been dealt with
                if graph.ordered:
                    heapq.heappush(heap, (distance[u], u))
                    continue
            elif len(heap) > 0:
                key, u = heapq.heappop(heap)
                if key != distance[u] or (len(heap) > 0 and heap[0] == (key, u)):
                    continue
            else:
                break
            du = distance[u]
            ru = rank[u]
            if cut and du >= -ru:
                continue
            costs = graph.cost[graph.material[u]]
            p = graph.piece[u]
            low, high = np.int64(0), np.int64(1)
            if p >= 0:
                low, high = graph.start[p], graph.start[p + 1]
            for q in range(low, high):
                here = np.int64(graph.cell[u]) if p < 0 else np.int64(graph.shell[q])
                for k in range(26):
                    v = graph.lookup[here + graph.offset[k]]
                    if v < 0:
                        continue
                    old = distance[v]
                    if old <= du:
                        continue
                    d = du + (uniform[k] if one_material else costs[k, graph.material[v]])
                    if d > old:
                        continue
                    if zoned and zone[v] != zone[u]:
                        continue
                    if d == old:
                        rank[v] = min(rank[v], ru)
                        continue
                    if bounded and d >= bound[v]:
                        continue
                    distance[v] = d
                    rank[v] = ru
                    target = np.int64(d * scale)
                    if old == np.inf:
                        visited[count] = v
                        count += 1
                    elif graph.ordered and target == bucket:
                        pass
                    elif np.int64(old * scale) == target:
                        continue
                    if graph.ordered and target == bucket:
                        heapq.heappush(heap, (d, v))
                        continue
                    if free < 0:
                        item, link = more(item), more(link)
                        free = len(item) // 2
                        for e in range(free, len(item)):
                            link[e] = e + 1
                        link[-1] = -1
                    new = free
                    free = link[new]
                    item[new] = v
                    link[new] = head[target & mask]
                    head[target & mask] = new
                    waiting += 1
        bucket += 1
    return count


@njit(cache=True, nogil=True)
def offer(
    v: Any,
    d: Any,
    r: float,
    distance: NDArray[np.float64],
    rank: NDArray[np.float64],
    visited: NDArray[np.int32],
    count: Integer,
) -> Integer:
    """Make v a source at distance d unless it has a better offer; the count of sources after that."""
    old = distance[v]
    if d < old or (d == old and r < rank[v]):
        if old == np.inf:
            visited[count] = v
            count += 1
        distance[v] = d
        rank[v] = r
    return count


@njit(cache=True, nogil=True)
def _offer_all(
    ids: NDArray[np.int32],
    costs: NDArray[np.float64],
    labels: NDArray[np.float64],
    distance: NDArray[np.float64],
    rank: NDArray[np.float64],
    visited: NDArray[np.int32],
) -> Integer:
    count = np.int64(0)
    for s in range(len(ids)):
        count = offer(ids[s], costs[s], labels[s], distance, rank, visited, count)
    return count


@njit(cache=True, nogil=True)
def more(array: Any) -> Any:
    """Return an array twice as long that begins with a given one."""
    larger = np.empty(2 * len(array), array.dtype)
    for k in range(len(array)):  # to assign a slice takes 2 s to compile
        larger[k] = array[k]
    return larger


@njit(cache=True, nogil=True)
def _cells(index: NDArray[np.int32], strides: NDArray[np.int64], cell: NDArray[np.integer]) -> NDArray[np.integer]:
    """Fill the place (n,) of each voxel in the padded image."""
    for v in range(len(index)):
        cell[v] = (index[v, 0] + 1) * strides[0] + (index[v, 1] + 1) * strides[1] + index[v, 2] + 1
    return cell


@njit(cache=True, nogil=True)
def _collapse(
    voxels: NDArray[np.int32], cell: NDArray[np.integer], offset: NDArray[np.int64], piece: NDArray[np.int32]
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.bool_]]:
    """Return the image of nodes, the node of each voxel, and whether it is in the shell of a piece."""
    lookup = voxels.copy()
    node = np.arange(len(cell)).astype(np.int32)
    first = np.full(piece.max() + 1, -1, np.int32)
    is_shell = np.zeros(len(cell), np.bool_)
    for v in range(len(cell)):
        p = piece[v]
        if p < 0:
            continue
        if first[p] < 0:
            first[p] = v
        node[v] = first[p]
        lookup[cell[v]] = first[p]
        for k in range(26):
            u = voxels[cell[v] + offset[k]]
            if u >= 0 and piece[u] < 0:
                is_shell[v] = True
    return lookup, node, is_shell
