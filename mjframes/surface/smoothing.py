"""The smoothed indicator of a volume's inside, G ∗ 1_inside, sharp where smoothing would lose voxels (§5.4's mesh).

The surface {field = ½} of it is smooth where the volume is a few voxels thick, and keeps plates, threads and gaps of
one voxel. Input: inside (nx, ny, nz) with a margin of two empty cells. Output: float32 of the same shape.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

NEIGHBOURS = np.ones((3, 3, 3), bool)
SMOOTHING = 1.0  # [voxels] Gaussian of surface and seams: takes the steps off slopes, keeps what is two voxels thick


def inside_field(inside: np.ndarray) -> np.ndarray:
    """Return the smoothed indicator of the inside, above ½ inside; unsmoothed around what smoothing would lose."""
    smooth = ndimage.gaussian_filter(inside.astype(np.float32), SMOOTHING, truncate=3.0, mode="constant")
    lost = (smooth > 0.5) != inside
    # Voxels are thin, not only the corner of something or a step of its side, where no neighbour is left of their kind.
    field = smooth.copy()
    _unsmooth(field, inside, lost & _alone(inside, lost))
    if _pieces(field > 0.5) != _pieces(inside):  # a short neck was cut
        field = smooth
        _unsmooth(field, inside, lost)
    return field


def _alone(inside: NDArray[np.bool_], lost: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which cells have no neighbour of their kind that is not lost."""
    outside, within = (ndimage.binary_dilation(kind & ~lost, NEIGHBOURS) for kind in (~inside, inside))
    return np.where(inside, np.logical_not(within), np.logical_not(outside))


def _unsmooth(field: np.ndarray, inside: NDArray[np.bool_], where: NDArray[np.bool_]) -> None:
    """Make the smoothed field the sharp one around `where`, with a transition of one voxel."""
    sharp = ndimage.binary_dilation(where, NEIGHBOURS)
    share = np.maximum(sharp, ndimage.uniform_filter(sharp.astype(np.float32), 3, mode="constant"))
    field += share * (inside - field)


def _pieces(part: np.ndarray) -> int:
    pieces = np.empty(part.shape, np.int32)
    return int(ndimage.label(part, NEIGHBOURS, output=pieces))  # pyright: ignore[reportArgumentType]
