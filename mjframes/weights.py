"""Voronoi kernels in compliance distance, normalised to a partition of unity (the paper, §4.3).

Frame i's kernel falls linearly along shortest paths, from 1 at its seed to ½ on its Voronoi frontier and on to 0:
w_i(p) = 1 − d_i(p) / (2 D_i(p)), where D_i is the distance at which that path meets the frontier. On an edge of cost c
from voxel u in cell i to voxel v in cell j both distances equal D = (d_i(u) + d_j(v) + c) / 2, within the edge. So a
bar between two frames gets equation (5) exactly.

Weights (n voxels, f frames) are sparse, ≥ 0, their rows sum to 1; 1 at the frame's own seed, constant in rigid pieces.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from mjframes.constants import NEGLIGIBLE_WEIGHT
from mjframes.distance import Reached, VoxelGraph, compliance_distance, edge_cost, voxel_graph
from mjframes.grid import Grid
from mjframes.placement import Placement


class Frontier(NamedTuple):
    """The edges (u, v) that leave a cell, both directions of each: cost and distance D of the frontier [m/Pa]."""

    u: NDArray[np.int64]
    v: NDArray[np.int64]
    cost: NDArray[np.float64]
    distance: NDArray[np.float64]


def voronoi_weights(grid: Grid, placement: Placement) -> sparse.csr_array:
    """The frames' weights at the voxel centres, (n, f) with sorted indices."""
    graph = voxel_graph(grid)
    frames = len(placement.seeds)
    owner = np.repeat(np.arange(frames), [len(s) for s in placement.seeds])
    nearest = compliance_distance(graph, np.concatenate(placement.seeds), label=owner)
    frontier = Frontier(*_frontier(graph.cell, graph.lookup, graph.offset, graph.length, graph.compliance,
                                   nearest.distance, nearest.label))  # fmt: skip
    voxels, values = [np.arange(len(grid.index))], [_inside(graph, nearest, frontier)]
    labels = [nearest.label]
    for i in range(frames):
        beyond, value = _beyond(graph, nearest, frontier, i)
        voxels.append(beyond)
        values.append(value)
        labels.append(np.full(len(beyond), i, np.int32))
    kernels = sparse.csr_array(
        (np.concatenate(values), (np.concatenate(voxels), np.concatenate(labels))), shape=(len(grid.index), frames)
    )
    return _partition_of_unity(kernels)


def _inside(graph: VoxelGraph, nearest: Reached, frontier: Frontier) -> NDArray[np.float64]:
    """Each voxel's own kernel, ≥ ½: D is its distance to the seed plus that to the frontier."""
    # A path across the frontier is never shorter than one that ends at it: no need to keep the paths in their cells.
    onward = compliance_distance(graph, frontier.u, cost=frontier.distance - nearest.distance[frontier.u])
    return 1 - nearest.distance / (2 * (nearest.distance + onward.distance))


def _beyond(
    graph: VoxelGraph, nearest: Reached, frontier: Frontier, i: int
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Voxels outside cell i to which kernel i extends, and its values there, < ½."""
    mine = nearest.label[frontier.u] == i
    u, v, half = frontier.u[mine], frontier.v[mine], frontier.distance[mine]
    found = compliance_distance(
        graph,
        v,
        cost=nearest.distance[u] + frontier.cost[mine],
        reach=2 * half,
        zone=(nearest.label == i).astype(np.int32),
    )
    voxels = np.nonzero(found.distance < found.reach)[0]
    return voxels, 1 - found.distance[voxels] / found.reach[voxels]


def _partition_of_unity(kernels: sparse.csr_array) -> sparse.csr_array:
    """Kernels scaled to sum 1 in each row, without the weights that are negligible then."""
    weights = _rows_to_one(kernels)
    weights.data[weights.data < NEGLIGIBLE_WEIGHT] = 0
    weights.eliminate_zeros()
    return _rows_to_one(weights)


def _rows_to_one(kernels: sparse.csr_array) -> sparse.csr_array:
    scale = np.repeat(1 / kernels.sum(axis=1), np.diff(kernels.indptr))
    return sparse.csr_array((kernels.data * scale, kernels.indices, kernels.indptr), shape=kernels.shape)


def frame_count(weights: sparse.csr_array) -> int:
    """f of weights (n, f)."""
    return int(weights.shape[1])  # pyright: ignore[reportOptionalSubscript]  SciPy's own annotation allows None


def weights_at(weights: sparse.csr_array, voxels: ArrayLike, frames: ArrayLike) -> NDArray[np.float64]:
    """Dense (v, i): the weights of some frames at some voxels."""
    return _gather(weights.indptr, weights.indices, weights.data, np.asarray(voxels), _column(weights, frames))


def weight_gradients(
    grid: Grid, weights: sparse.csr_array, voxels: ArrayLike, frames: ArrayLike
) -> NDArray[np.float64]:
    """Gradients (v, i, 3) [1/m] of some frames' weights at some voxel centres, in volume coordinates.

    Along an index axis with step h the slope towards a face neighbour n of u is ± (w_n − w_u)/h · 2 c_u/(c_u + c_n):
    the share of the step that falls to u's compliance c_u, exact for weights linear in compliance distance, 0 in rigid
    voxels. The derivative is the mean over the neighbours inside the volume, 0 without any.
    `frames` must hold all frames with weight at these voxels. A frame left out may still have weight at a neighbour;
    its slope is shared out by weight, so that Σ_i ∇w_i = 0 over `frames` (the gradient of w_i / Σ w).
    """
    ids, column = np.asarray(voxels), _column(weights, frames)
    own = _gather(weights.indptr, weights.indices, weights.data, ids, column)
    along = _slopes(
        weights.indptr, weights.indices, weights.data, ids, column, own,
        grid.index, grid.lookup, grid.compliance, grid.spacing,
    )  # fmt: skip
    return (along.reshape(-1, 3) @ grid.axes.T).reshape(along.shape)


def _column(weights: sparse.csr_array, frames: ArrayLike) -> NDArray[np.int64]:
    """(f,) the place of each frame in `frames`, −1 if it is not there."""
    chosen = np.asarray(frames)
    column = np.full(frame_count(weights), -1, np.int64)
    column[chosen] = np.arange(len(chosen))
    return column


@njit(cache=True)
def _frontier(cell, lookup, offset, length, compliance, distance, label):
    """Columns of Frontier, in the order of u."""
    count = 0
    from_, to, cost, half = np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0), np.empty(0)
    for fill in (False, True):  # the first pass only counts
        if fill:
            from_, to = np.empty(count, np.int64), np.empty(count, np.int64)
            cost, half = np.empty(count), np.empty(count)
            count = 0
        for u in range(len(cell)):
            for k in range(len(offset)):
                v = lookup[cell[u] + offset[k]]
                if v >= 0 and label[v] != label[u]:
                    if fill:
                        c = edge_cost(length[k], compliance[u], compliance[v])
                        from_[count], to[count], cost[count] = u, v, c
                        half[count] = 0.5 * (distance[u] + distance[v] + c)
                    count += 1
    return from_, to, cost, half


@njit(cache=True)
def _gather(indptr, indices, data, voxels, column):
    dense = np.zeros((len(voxels), column.max() + 1))
    for a in range(len(voxels)):
        for k in range(indptr[voxels[a]], indptr[voxels[a] + 1]):
            i = column[indices[k]]
            if i >= 0:
                dense[a, i] = data[k]
    return dense


@njit(cache=True)
def _slopes(indptr, indices, data, voxels, column, own, index, lookup, compliance, spacing):
    slope = np.zeros((len(voxels), own.shape[1], 3))
    at = np.empty(3, np.int64)
    for a in range(len(voxels)):
        u = voxels[a]
        if compliance[u] == 0.0:
            continue
        for axis in range(3):
            found = 0
            for side in (-1, 1):
                at[:] = index[u]
                at[axis] += side
                if at[axis] < 0 or at[axis] >= lookup.shape[axis]:
                    continue
                n = lookup[at[0], at[1], at[2]]
                if n < 0:
                    continue
                found += 1
                factor = side / spacing[axis] * 2 * compliance[u] / (compliance[u] + compliance[n])
                slope[a, :, axis] -= factor * own[a]
                for k in range(indptr[n], indptr[n + 1]):
                    i = column[indices[k]]
                    if i >= 0:
                        slope[a, i, axis] += factor * data[k]
            if found == 2:
                slope[a, :, axis] *= 0.5
            slope[a, :, axis] -= own[a] * slope[a, :, axis].sum()  # that of the frames left out
    return slope
