"""Hats along an axis: w_i falls linearly from 1 at frame i to 0 at its neighbours (the paper's beams, §6.1).

With s the coordinate along an index axis and [a_i, b_i] the extent of frame i's seed in it, w_i is 1 on [a_i, b_i],
linear down to 0 at b_(i−1) and a_(i+1), and beyond the first and the last frame it stays 1.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mjframes.base.errors import MjframesError
from mjframes.frames.placement import Placement
from mjframes.volume.grid import Grid


def linear_weights(grid: Grid, placement: Placement, axis: int | None = None) -> sparse.csr_array:
    """Return the frames' weights at the voxel centres, (n, f) with sorted indices.

    axis: index axis 0, 1 or 2; that of the largest extent of the frames' centres unless given.
    A rigid piece has the weights of its centroid.
    Raise MjframesError if two frames share a place along the axis.
    """
    if axis is None:
        axis = int(np.argmax(np.ptp(placement.centers @ grid.axes, axis=0)))
    if axis not in (0, 1, 2):
        raise MjframesError(f"axis is {axis!r}; it must be 0, 1 or 2, an index axis of the volume.")
    along = grid.index[:, axis].astype(np.float64)
    extent = np.array([[along[s].min(), along[s].max()] for s in placement.seeds])
    order = np.lexsort((extent[:, 1], extent[:, 0]))
    ends = extent[order]
    for i in np.flatnonzero(ends[1:, 0] <= ends[:-1, 1]):
        first, second = sorted((int(order[i]), int(order[i + 1])))
        raise MjframesError(
            f"frames {first} and {second} share a place along axis {axis}; "
            "linear weights need frames one after the other: place them with at, or choose other weights."
        )
    rigid = np.flatnonzero(grid.piece >= 0)
    piece = grid.piece[rigid]
    sums, sizes = np.bincount(piece, along[rigid]), np.bincount(piece)
    along[rigid] = (sums / np.maximum(sizes, 1))[piece]
    return _hats(along, ends, order)


def _hats(along: NDArray[np.float64], ends: NDArray[np.float64], order: NDArray[np.int64]) -> sparse.csr_array:
    """Weights (n, f) at the places `along` (n,), from the intervals `ends` (f, 2), ascending, of frames `order`."""
    after = np.searchsorted(ends[:, 0], along, side="right")  # the first frame that begins beyond
    left, right = np.maximum(after - 1, 0), np.minimum(after, len(ends) - 1)
    gap = ends[right, 0] - ends[left, 1]
    share = np.where(left == right, 0.0, np.clip((along - ends[left, 1]) / np.where(gap > 0, gap, 1.0), 0.0, 1.0))
    n = len(along)
    values, columns = (
        np.stack([1 - share, share], axis=1).ravel(),
        np.stack([order[left], order[right]], axis=1).ravel(),
    )
    weights = sparse.csr_array((values, columns, np.arange(0, 2 * n + 1, 2)), shape=(n, len(ends)))
    weights.sum_duplicates()
    weights.eliminate_zeros()
    return weights
