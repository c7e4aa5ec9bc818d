"""Weights of the frames at the voxels, their values and gradients (the paper, §3 and §4).

Weights (n voxels, f frames) are sparse, from 0 to 1, their rows sum to 1; 1 at the frame's own seed, constant in each
rigid piece. They come from Voronoi kernels (the paper's), from a potential, or from hats along an axis.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from mjframes.volume.grid import Grid


def frame_count(weights: sparse.csr_array) -> int:
    """Return f of weights (n, f)."""
    return int(weights.shape[1])  # pyright: ignore[reportOptionalSubscript]  SciPy's own annotation allows None


def weights_at(weights: sparse.csr_array, voxels: ArrayLike, frames: ArrayLike) -> NDArray[np.float64]:
    """Return the weights (v, i) of some frames at some voxels, dense."""
    return _gather(weights.indptr, weights.indices, weights.data, np.asarray(voxels), column_of(weights, frames))


def weight_gradients(
    grid: Grid,
    weights: sparse.csr_array,
    voxels: ArrayLike,
    frames: ArrayLike,
    within: NDArray[np.int32] | None = None,
) -> NDArray[np.float64]:
    """Return gradients (v, i, 3) [1/m] of some frames' weights at some voxel centres, in volume coordinates.

    Along an index axis with step h the slope towards a face neighbour n of u is ± (w_n − w_u)/h · 2 c_u/(c_u + c_n):
    the share of the step that falls to u's compliance c_u, exact for weights linear in compliance distance, 0 in rigid
    voxels. The derivative is the mean over the neighbours inside the volume, 0 without any.
    within: (n,) labels; neighbours of another label than u's then count only where u has no other along that axis.
    Weights have their kinks between the regions, so it gives the slope inside, not the mean of both sides.
    `frames` must hold all frames with weight at these voxels. A frame left out may still have weight at a neighbour;
    its slope is shared out by weight, so that Σ_i ∇w_i = 0 over `frames` (the gradient of w_i / Σ w).
    """
    ids, column = np.asarray(voxels), column_of(weights, frames)
    own = _gather(weights.indptr, weights.indices, weights.data, ids, column)
    along = _slopes(
        weights.indptr, weights.indices, weights.data, ids, column, own,
        grid.index, grid.padded, grid.per_material("compliance"), grid.material, grid.spacing,
        np.zeros(0, np.int32) if within is None else within,
    )  # fmt: skip
    return (along.reshape(-1, 3) @ grid.axes.T).reshape(along.shape)


def column_of(weights: sparse.csr_array, frames: ArrayLike) -> NDArray[np.int64]:
    """Return the place (f,) of each frame in `frames`, −1 if it is not there."""
    chosen = np.asarray(frames)
    column = np.full(frame_count(weights), -1, np.int64)
    column[chosen] = np.arange(len(chosen))
    return column


@njit(cache=True, nogil=True)
def _gather(
    indptr: NDArray[np.integer],
    indices: NDArray[np.integer],
    data: NDArray,
    voxels: NDArray[np.integer],
    column: NDArray[np.int64],
) -> NDArray[np.float64]:
    """Return (v, i) the weights at the voxels, of the frames with a column ≥ 0."""
    count = 0
    for i in column:
        count = max(count, i + 1)
    dense = np.zeros((len(voxels), count))
    for a in range(len(voxels)):
        for k in range(indptr[voxels[a]], indptr[voxels[a] + 1]):
            i = column[indices[k]]
            if i >= 0:
                dense[a, i] = data[k]
    return dense


@njit(cache=True, nogil=True)
def _slopes(
    indptr: NDArray[np.integer],
    indices: NDArray[np.integer],
    data: NDArray,
    voxels: NDArray[np.integer],
    column: NDArray[np.int64],
    own: NDArray[np.float64],
    index: NDArray[np.int32],
    padded: NDArray[np.int32],
    compliance: NDArray[np.float64],
    material: NDArray[np.unsignedinteger],
    spacing: NDArray[np.float64],
    within: NDArray[np.int32],
) -> NDArray[np.float64]:
    """Return (v, i, 3) slopes along the index axes [1/m]. own: (v, i) weights.  within: (n,), empty for no labels."""
    frames = own.shape[1]
    slope = np.zeros((len(voxels), frames, 3))
    along = np.empty(frames)
    for a in range(len(voxels)):
        u = voxels[a]
        c = compliance[material[u]]
        if c == 0.0:
            continue
        x, y, z = index[u, 0] + 1, index[u, 1] + 1, index[u, 2] + 1
        for axis in range(3):
            along[:] = 0.0
            alike = False  # whether u has a neighbour of its own label on this axis
            if len(within):
                for side in (-1, 1):
                    n = padded[x + side * (axis == 0), y + side * (axis == 1), z + side * (axis == 2)]
                    alike |= n >= 0 and within[n] == within[u]
            found = 0
            for side in (-1, 1):
                n = padded[x + side * (axis == 0), y + side * (axis == 1), z + side * (axis == 2)]
                if n < 0 or (alike and within[n] != within[u]):
                    continue
                found += 1
                factor = side / spacing[axis] * 2 * c / (c + compliance[material[n]])
                for k in range(indptr[n], indptr[n + 1]):
                    i = column[indices[k]]
                    if i >= 0:
                        along[i] += factor * data[k]
            total = 0.0
            for i in range(frames):
                total += along[i]
            for i in range(frames):  # total: what all own weights together take off, and the frames left out put in
                slope[a, i, axis] = (along[i] - own[a, i] * total) / max(found, 1)
    return slope
