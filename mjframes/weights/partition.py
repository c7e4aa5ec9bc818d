"""Kernels made a partition of unity: w_i = k_i / Σ_j k_j, without the weights that are negligible (the paper, §3)."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import sparse

from mjframes.base.constants import NEGLIGIBLE_WEIGHT

Kernel = tuple[NDArray[np.int32], NDArray[np.float32]]  # nodes (b,) where it is positive, each once, and its values


def partition_of_unity(kernels: list[Kernel], node: NDArray[np.int32]) -> sparse.csr_array:
    """Return weights (n, f) with sorted indices from the kernels of f frames, which are used up: the list ends empty.

    node: (n,) the voxel whose weights each voxel has: itself, or for a rigid piece always the same.
    """
    n, frames = len(node), len(kernels)
    total, kept, count = np.zeros(n), np.zeros(n), np.zeros(n, np.int32)
    for nodes, values in kernels:
        _add(nodes, values, total)
    for nodes, values in kernels:
        _drop_negligible(nodes, values, total, kept, count)
    del total
    indptr = np.zeros(n + 1, np.int64)
    np.cumsum(count[node], out=indptr[1:])
    indptr = indptr.astype(np.int32 if indptr[-1] < 2**31 else np.int64)
    indices, data = np.empty(indptr[-1], np.int32), np.empty(indptr[-1])
    count[:] = 0  # from here on: how many are filled in
    for i in range(frames):
        nodes, values = kernels[i]
        _fill(nodes, values, i, kept, indptr, count, indices, data)
        kernels[i] = (nodes[:0].copy(), values[:0].copy())  # the memory is needed
    kernels.clear()
    _copy_to_pieces(node, indptr, indices, data)
    weights = sparse.csr_array((data, indices, indptr), shape=(n, frames))
    weights.has_sorted_indices = True
    return weights


@njit(cache=True, nogil=True)
def _add(nodes: NDArray[np.int32], values: NDArray[np.float32], total: NDArray[np.float64]) -> None:
    for b in range(len(nodes)):
        total[nodes[b]] += values[b]


@njit(cache=True, nogil=True)
def _drop_negligible(
    nodes: NDArray[np.int32],
    values: NDArray[np.float32],
    total: NDArray[np.float64],
    kept: NDArray[np.float64],
    count: NDArray[np.int32],
) -> None:
    """Set negligible values to 0; add the others to kept (n,), and how many they are to count (n,)."""
    for b in range(len(nodes)):
        v = nodes[b]
        if values[b] < NEGLIGIBLE_WEIGHT * total[v]:
            values[b] = 0
        else:
            kept[v] += values[b]
            count[v] += 1


@njit(cache=True, nogil=True)
def _fill(
    nodes: NDArray[np.int32],
    values: NDArray[np.float32],
    i: int,
    kept: NDArray[np.float64],
    indptr: NDArray[np.integer],
    count: NDArray[np.int32],
    indices: NDArray[np.int32],
    data: NDArray[np.float64],
) -> None:
    """Write the weights of frame i, values / kept (n,), behind the count (n,) that each row has already."""
    for b in range(len(nodes)):
        v = nodes[b]
        if values[b] > 0:
            at = indptr[v] + count[v]
            indices[at] = i
            data[at] = values[b] / kept[v]
            count[v] += 1


@njit(cache=True, nogil=True)
def _copy_to_pieces(
    node: NDArray[np.int32], indptr: NDArray[np.integer], indices: NDArray[np.int32], data: NDArray[np.float64]
) -> None:
    """Copy the row of node[v] to v."""
    for v in range(len(node)):
        u = node[v]
        if u != v:
            for k in range(indptr[v + 1] - indptr[v]):
                indices[indptr[v] + k], data[indptr[v] + k] = indices[indptr[u] + k], data[indptr[u] + k]
