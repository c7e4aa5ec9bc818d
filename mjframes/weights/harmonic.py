"""Harmonic weights: div(E ∇w_i) = 0 with w_i = 1 on frame i's core and 0 on the others', natural boundary elsewhere.

A potential counts all load paths from frame to frame, not only the stiffest one, as the compliance distance does (the
limit that the paper names in §4.2). Finite volumes on the voxels: the face between u and v conducts
A / (h (c_u + c_v) / 2), by the harmonic mean of the moduli, so that a bar gets equation (5) exactly. A rigid piece is
one unknown.

In two and three dimensions a potential does not see a single voxel: its value there reaches no farther than a few
voxels. So such a seed grows to a core, all that is near it compared with the frontier of its Voronoi cell.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import cg, splu

from mjframes.base.errors import MjframesError
from mjframes.base.packages import optional
from mjframes.frames.distance import VoxelGraph, nearest_sources, sources_of, voxel_graph
from mjframes.frames.placement import Placement
from mjframes.volume.grid import Grid
from mjframes.weights.partition import Kernel, partition_of_unity

CORE = 0.25  # [-] of the way from a frame to the nearest frontier of its cell: enough to be seen, small beside the cell
DIRECT = 20_000  # [unknowns] up to which a factorization is faster than multigrid
TOLERANCE = 1e-9  # [-] of the residual: errors of weights stay far below those that are negligible
ITERATIONS = 300  # multigrid needs 5 to 20; up to 50 where random voxels are 1e6 times as stiff and begin to connect


def harmonic_weights(grid: Grid, placement: Placement) -> sparse.csr_array:
    """Return the frames' weights at the voxel centres, (n, f) with sorted indices.

    Raise MjframesError if the volume is large and pyamg is not installed.
    """
    graph = voxel_graph(grid)
    core = _cores(graph, placement)
    frames, nodes = len(placement.seeds), np.flatnonzero(graph.node == np.arange(len(graph.node)))
    unknown = np.full(len(graph.node), -1, np.int64)
    free = nodes[core[nodes] < 0]
    unknown[free] = np.arange(len(free))
    matrix, sources = _system(_conductances(grid, graph), unknown, core, frames)
    solve = _solver(matrix)
    kernels: list[Kernel] = []
    rest = np.ones(len(free))
    for i in range(frames):
        held = nodes[core[nodes] == i]
        # The last frame has what the others leave: one solution less.
        value = np.clip(solve(sources[:, [i]].toarray().ravel()) if i < frames - 1 else rest, 0.0, 1.0)
        rest -= value
        kept = np.flatnonzero(value)
        values = np.concatenate([np.ones(len(held)), value[kept]]).astype(np.float32)
        kernels.append((np.concatenate([held, free[kept]]).astype(np.int32), values))
    return partition_of_unity(kernels, graph.node)


def _cores(graph: VoxelGraph, placement: Placement) -> NDArray[np.int32]:
    """(n,) the frame whose core a node belongs to, −1 for none."""
    frames = len(placement.seeds)
    nearest = nearest_sources(graph, *sources_of(placement.seeds))
    reach = np.full(frames, np.inf)
    _frontier(graph, nearest.distance, nearest.label, reach)
    reach *= CORE
    for i, seed in enumerate(placement.seeds):
        around = graph.lookup[graph.cell[seed[0]] + graph.offset]
        if len(seed) > 1 or np.count_nonzero(around >= 0) <= 2 or np.isinf(reach[i]):  # no point, or on a thread
            reach[i] = 0.0
    inside = (nearest.label >= 0) & (nearest.distance <= reach[nearest.label])
    return np.where(inside, nearest.label, -1).astype(np.int32)


def _conductances(grid: Grid, graph: VoxelGraph) -> sparse.csr_array:
    """(n, n) of each pair of nodes [m Pa], both directions."""
    n = len(graph.node)
    steps = [np.array(s) for s in itertools.product((-1, 0, 1), repeat=3) if s > (0, 0, 0)]
    faces = [_links(grid, graph, step) for step in steps if np.abs(step).sum() == 1]
    joined = _symmetric(faces, n)
    used = graph.node == np.arange(n)
    part = connected_components(joined, directed=False)[1]
    if len(np.unique(part[used])) > 1:  # voxels that touch along edges or at corners only
        for step in steps:
            if np.abs(step).sum() > 1:
                first, second, value = _links(grid, graph, step)
                apart = part[first] != part[second]
                faces.append((first[apart], second[apart], value[apart]))
        joined = _symmetric(faces, n)
    return joined


def _links(grid: Grid, graph: VoxelGraph, step: NDArray[np.int64]) -> tuple[NDArray, NDArray, NDArray]:
    """Pairs of different nodes that are one step apart, and V / (length² (c_u + c_v) / 2): for a face A E / h."""
    strides = np.array([grid.padded.shape[1] * grid.padded.shape[2], grid.padded.shape[2], 1])
    second = graph.lookup[graph.cell.astype(np.int64) + step @ strides]
    first = graph.node
    differ = (second >= 0) & (second != first)
    first, second = first[differ], second[differ]
    compliance = grid.per_material("compliance")[grid.material]
    mean = 0.5 * (compliance[first] + compliance[second])
    return first, second, grid.cell_volume / (np.sum((step * grid.spacing) ** 2) * mean)


def _symmetric(links: list[tuple[NDArray, NDArray, NDArray]], n: int) -> sparse.csr_array:
    first, second, value = (np.concatenate(column) for column in zip(*links, strict=True))
    one_way = sparse.coo_array((value, (first, second)), shape=(n, n)).tocsr()
    return sparse.csr_array(one_way + one_way.T)


def _system(
    conductance: sparse.csr_array, unknown: NDArray[np.int64], core: NDArray[np.int32], frames: int
) -> tuple[sparse.csr_array, sparse.csc_array]:
    """The matrix (u, u) of the unknown nodes, and what each core at 1 contributes to their equations (u, f)."""
    free = np.flatnonzero(unknown >= 0)
    rows = sparse.csr_array(conductance[free])
    of_core = sparse.csr_array(
        (np.ones(np.count_nonzero(core >= 0)), (np.flatnonzero(core >= 0), core[core >= 0])), shape=(len(core), frames)
    )
    matrix = sparse.diags_array(rows.sum(axis=1)) - rows[:, free]
    return sparse.csr_array(matrix), sparse.csc_array(rows @ of_core)


def _solver(matrix: sparse.csr_array) -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
    """A function that solves matrix · x = b; the same to the last bit each time."""
    size = len(matrix.indptr) - 1
    if size == 0:
        return lambda b: b
    if size <= DIRECT:
        return splu(sparse.csc_array(matrix)).solve
    user = f"weights='harmonic' of {size} voxels"
    pyamg = optional("pyamg", user, "harmonic", instead="choose weights='voronoi'")
    # Classical coarsening follows the strong links, whatever the contrast, and draws no random numbers.
    hierarchy = pyamg.ruge_stuben_solver(sparse.csr_matrix(matrix), max_coarse=300, coarse_solver="splu")
    cycle = hierarchy.aspreconditioner()

    def solve(b: NDArray[np.float64]) -> NDArray[np.float64]:
        x, failed = cg(matrix, b, rtol=TOLERANCE, maxiter=ITERATIONS, M=cycle)
        if failed:
            raise MjframesError("harmonic weights did not converge; choose weights='voronoi' for such contrasts.")
        return x

    return solve


@njit(cache=True, nogil=True)
def _frontier(
    graph: VoxelGraph, distance: NDArray[np.float64], label: NDArray[np.int32], reach: NDArray[np.float64]
) -> None:
    """Lower `reach` (f,) to the distance at which each Voronoi cell's frontier is nearest to its seed."""
    for w in range(len(label)):
        u = graph.node[w]
        for k in range(26):
            v = graph.lookup[graph.cell[w] + graph.offset[k]]
            if v >= 0 and label[v] != label[u]:
                cost = graph.cost[graph.material[u], k, graph.material[v]]
                reach[label[u]] = min(reach[label[u]], 0.5 * (distance[u] + distance[v] + cost))
