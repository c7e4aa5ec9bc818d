"""Voronoi kernels in compliance distance, normalised to a partition of unity (the paper, §4.3).

Frame i's kernel is 1 at its seed and ½ on the frontier of its Voronoi cell. The surface of value 2⁻⁽ᵏ⁺¹⁾ is the Voronoi
surface between that of value 2⁻ᵏ and the other frames' seeds; between two surfaces lies a band, which is halved by
the Voronoi surface between them until n subdivisions have made every multiple of 2⁻ⁿ from 2⁻ⁿ to 1 a surface. With d_a,
d_b the distances to the surfaces of values a > b around a voxel, w_i = (a d_b + b d_a) / (d_a + d_b). Beyond the last
surface the kernel goes on as it fell on that path: w_i = 2⁻⁽ⁿ⁻¹⁾ (1 − d / 2D) ≥ 0, d being the length of the path from
the surface before the last, D that up to the last. For n = 2 this is (¼ d_½ − ½ d_¼) / (d_½ − d_¼); the paper's signs
are a slip.

On an edge of cost c from u to v a Voronoi surface lies where both distances are equal, (d(u) + d(v) + c) / 2, within
the edge. So a bar between two frames gets equation (5) exactly. A band may end on the edge on which it begins; so the
`link` from a node to a surface, the part of the edge up to it, is kept.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from queue import SimpleQueue
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import sparse

from mjframes.base.rows import members_of
from mjframes.base.threads import workers
from mjframes.frames.distance import Integer, VoxelGraph, more, nearest_sources, offer, sources_of, sweep, voxel_graph
from mjframes.frames.placement import Placement
from mjframes.volume.grid import Grid
from mjframes.weights.partition import Kernel, partition_of_unity


class Scratch(NamedTuple):
    """What one thread keeps for each of the n voxels between frames; the last five only where bands are halved.

    distance, rank, visited: of a sweep; distance is inf where unvisited.
    zone: the band, 0 in none.
    high, low: distance to the surfaces of the larger and of the smaller value [m/Pa].
    link_high, link_low, link_middle: links to them and to the one in the middle [m/Pa], inf without.
    """

    distance: NDArray[np.float64]
    rank: NDArray[np.float64]
    visited: NDArray[np.int32]
    zone: NDArray[np.int32]
    high: NDArray[np.float64]
    low: NDArray[np.float64]
    link_high: NDArray[np.float64]
    link_low: NDArray[np.float64]
    link_middle: NDArray[np.float64]


def voronoi_weights(grid: Grid, placement: Placement, subdivisions: int = 1) -> sparse.csr_array:
    """Return the frames' weights at the voxel centres, (n, f) with sorted indices."""
    graph = voxel_graph(grid)
    kernels, node = _kernels(graph, placement, subdivisions), graph.node
    del graph  # the memory is needed
    return partition_of_unity(kernels, node)


def _kernels(graph: VoxelGraph, placement: Placement, subdivisions: int) -> list[Kernel]:
    nearest = nearest_sources(graph, *sources_of(placement.seeds))
    cells = members_of(nearest.label, len(placement.seeds))
    threads = min(workers(), len(cells))
    idle: SimpleQueue[Scratch] = SimpleQueue()
    for _ in range(threads):
        idle.put(_scratch(len(graph.cell), subdivisions))

    def kernel(cell: NDArray[np.int32]) -> Kernel:
        scratch = idle.get()
        result = _kernel(graph, nearest.distance, cell, subdivisions, scratch)
        idle.put(scratch)
        return result

    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(kernel, cells))


def _scratch(n: int, subdivisions: int) -> Scratch:
    for_bands = [np.empty(n if subdivisions > 1 else 0) for _ in range(5)]
    return Scratch(np.full(n, np.inf), np.empty(n), np.empty(n, np.int32), np.zeros(n, np.int32), *for_bands)


@njit(cache=True, nogil=True)
def _kernel(
    graph: VoxelGraph, near: NDArray[np.float64], cell: NDArray[np.int32], subdivisions: int, s: Scratch
) -> Kernel:
    """Frame i's kernel: the nodes (b,) to which it extends, those of its cell first, and its values there.

    near: (n,) distance to the nearest seed.  Scratch is left as it was found.
    """
    halves = subdivisions > 1
    found, values = np.empty(0, np.int32), np.empty(0, np.float32)
    base = np.int64(1)
    members = cell
    for u in members:
        s.zone[u] = base
        if halves:
            s.high[u] = near[u]
            s.link_high[u] = np.inf  # seeds are nearer to themselves than to any other surface
    rejected, rejected_at = np.empty(0, np.int32), np.empty(0)
    arrived, arrival = rejected, rejected_at
    for k in range(subdivisions):
        high = s.high if halves else near
        top = 0.5**k  # the value at its upper surface
        arrived, arrival = _front(graph, near, members, high, rejected, rejected_at, s)
        levels = subdivisions - 1 - k
        if halves:
            for _ in range(levels):
                _halve(graph, members, base, s)
        band_values = np.empty(len(members), np.float32)
        step = top * 0.5 / (1 << levels)
        for m in range(len(members)):
            u = members[m]
            to_high, to_low = high[u], s.low[u] if halves else s.distance[u]
            a = top - step * (s.zone[u] - base)
            if halves and to_high + to_low == np.inf:
                band_values[m] = a
            elif halves:
                band_values[m] = (a * to_low + (a - step) * to_high) / (to_low + to_high)
            else:
                band_values[m] = 1.0 - to_high / (2.0 * (to_high + to_low))
                s.distance[u] = np.inf
        found, values = np.concatenate((found, members)), np.concatenate((values, band_values))
        base += 1 << levels
        if k < subdivisions - 1:
            members, rejected, rejected_at = _next_band(graph, near, arrived, arrival, base, s)
    members, last_values = _extrapolate(graph, near, arrived, arrival, 0.5 ** (subdivisions - 1), s)
    for u in found:
        s.zone[u] = 0
    return np.concatenate((found, members)), np.concatenate((values, last_values))


@njit(cache=True, nogil=True)
def _front(
    graph: VoxelGraph,
    near: NDArray[np.float64],
    members: NDArray[np.int32],
    high: NDArray[np.float64],
    rejected: NDArray[np.int32],
    rejected_at: NDArray[np.float64],
    s: Scratch,
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Distance to the surface that bounds a band, and how far beyond it the first nodes outside are.

    The bounding surface is halfway between the band's upper one and the other seeds. Nodes (b,) outside all bands that
    edges lead to, and their distances (b,) from the upper surface; `rejected`: some that were known before.
    The distance to the bounding surface goes to s.low with its links, or just to s.distance without subdivision.
    """
    halves = len(s.low) > 0
    outside, count = np.empty(64, np.int32), np.int64(0)
    inner = np.int64(0)
    for r in range(len(rejected)):
        if s.zone[rejected[r]] == 0:
            outside, count = _append(outside, count, rejected[r])
            s.distance[rejected[r]] = rejected_at[r]
    for u in members:
        costs = graph.cost[graph.material[u]]
        p = graph.piece[u]
        first, last = np.int64(0), np.int64(1)
        if p >= 0:
            first, last = graph.start[p], graph.start[p + 1]
        for q in range(first, last):
            here = np.int64(graph.cell[u]) if p < 0 else np.int64(graph.shell[q])
            for k in range(26):
                v = graph.lookup[here + graph.offset[k]]
                if v < 0 or s.zone[v] != 0:
                    continue
                at = high[u] + costs[k, graph.material[v]]
                if at < s.distance[v]:
                    if s.distance[v] == np.inf:
                        outside, count = _append(outside, count, v)
                    s.distance[v] = at
                inner = offer(u, 0.5 * (at + near[v]) - high[u], 0.0, s.distance, s.rank, s.visited, inner)
    arrived = outside[:count].copy()
    arrival = s.distance[arrived]
    for v in arrived:
        s.distance[v] = np.inf
    if halves:
        for u in members:
            s.link_low[u] = s.distance[u]
    sweep(graph, s.zone, near[:0], np.bool_(False), s.distance, s.rank, s.visited, inner)
    if halves:
        for u in members:
            s.low[u] = s.distance[u]
            s.distance[u] = np.inf
    return arrived, arrival


@njit(cache=True, nogil=True)
def _next_band(
    graph: VoxelGraph,
    near: NDArray[np.float64],
    arrived: NDArray[np.int32],
    arrival: NDArray[np.float64],
    base: Integer,
    s: Scratch,
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.float64]]:
    """Return the next band's nodes; and those (r,) beyond even that to which its upper surface has links, and these."""
    count, refused = np.int64(0), 0
    rejected, rejected_at = np.empty(len(arrived), np.int32), np.empty(len(arrived))
    for b in range(len(arrived)):
        v = arrived[b]
        link = 0.5 * (arrival[b] - near[v])  # from the surface halfway on
        if link < near[v]:
            count = offer(v, link, 0.0, s.distance, s.rank, s.visited, count)
        else:
            rejected[refused], rejected_at[refused] = v, link
            refused += 1
    linked = s.visited[:count].copy()
    link = s.distance[linked]
    members = s.visited[: sweep(graph, s.zone, near, np.bool_(False), s.distance, s.rank, s.visited, count)].copy()
    for u in members:
        s.zone[u] = base
        s.high[u] = s.distance[u]
        s.link_high[u] = np.inf
        s.distance[u] = np.inf
    for b in range(len(linked)):
        s.link_high[linked[b]] = link[b]
    return members, rejected[:refused], rejected_at[:refused]


@njit(cache=True, nogil=True)
def _halve(graph: VoxelGraph, members: NDArray[np.int32], base: Integer, s: Scratch) -> None:
    """Every zone of a band becomes two, with the Voronoi surface between its two surfaces in the middle."""
    count = np.int64(0)
    for u in members:
        if s.high[u] > s.low[u]:
            if s.link_high[u] < np.inf:
                count = offer(u, 0.5 * (s.link_high[u] - s.low[u]), 0.0, s.distance, s.rank, s.visited, count)
            continue
        if s.link_low[u] < np.inf:
            count = offer(u, 0.5 * (s.link_low[u] - s.high[u]), 0.0, s.distance, s.rank, s.visited, count)
        costs = graph.cost[graph.material[u]]
        p = graph.piece[u]
        first, last = np.int64(0), np.int64(1)
        if p >= 0:
            first, last = graph.start[p], graph.start[p + 1]
        for q in range(first, last):
            here = np.int64(graph.cell[u]) if p < 0 else np.int64(graph.shell[q])
            for k in range(26):
                v = graph.lookup[here + graph.offset[k]]
                if v < 0 or s.zone[v] != s.zone[u] or s.high[v] <= s.low[v]:
                    continue
                c = costs[k, graph.material[v]]
                to_middle = 0.5 * (s.low[v] + c - s.high[u])
                count = offer(u, to_middle, 0.0, s.distance, s.rank, s.visited, count)
                count = offer(v, c - to_middle, 0.0, s.distance, s.rank, s.visited, count)
    for u in members:
        s.link_middle[u] = s.distance[u]
    sweep(graph, s.zone, s.high[:0], np.bool_(False), s.distance, s.rank, s.visited, count)
    for u in members:
        part = s.zone[u] - base
        if s.high[u] <= s.low[u]:
            s.low[u], s.link_low[u] = s.distance[u], s.link_middle[u]
            s.zone[u] = base + 2 * part
        else:
            s.high[u], s.link_high[u] = s.distance[u], s.link_middle[u]
            s.zone[u] = base + 2 * part + 1
        s.distance[u] = np.inf


@njit(cache=True, nogil=True)
def _extrapolate(
    graph: VoxelGraph,
    near: NDArray[np.float64],
    arrived: NDArray[np.int32],
    arrival: NDArray[np.float64],
    top: float,
    s: Scratch,
) -> Kernel:
    """Nodes beyond the last surface where the kernel is not 0 yet, and its values there."""
    count = np.int64(0)
    for b in range(len(arrived)):
        v = arrived[b]
        count = offer(v, arrival[b], -(arrival[b] + near[v]), s.distance, s.rank, s.visited, count)
    count = sweep(graph, s.zone, near[:0], np.bool_(True), s.distance, s.rank, s.visited, count)
    positive = 0
    values = np.empty(count, np.float32)
    for b in range(count):
        v = s.visited[b]
        d, reach = s.distance[v], -s.rank[v]
        s.distance[v] = np.inf
        if d < reach:
            s.visited[positive] = v
            values[positive] = top * (1.0 - d / reach)
            positive += 1
    return s.visited[:positive].copy(), values[:positive].copy()


@njit(cache=True, nogil=True)
def _append(array: NDArray[np.int32], count: Integer, value: Any) -> tuple[NDArray[np.int32], Integer]:
    """Append a value to the first `count` of an array, which doubles where it is full."""
    if count == len(array):
        array = more(array)
    array[count] = value
    return array, count + 1
