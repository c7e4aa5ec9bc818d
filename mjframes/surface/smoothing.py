"""The smoothed indicator of a volume's inside, G ∗ 1_inside, sharp where smoothing would lose voxels (§5.4's mesh).

The surface {field = ½} of it is smooth where the volume is a few voxels thick, and keeps plates, threads and gaps of
one voxel. Input: inside (nx, ny, nz) with a margin of two empty cells. Output: float32 of the same shape.
"""

from __future__ import annotations

import numpy as np
from numba import njit
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


@njit(cache=True)
def _alone(inside: NDArray[np.bool_], lost: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which lost cells have no neighbour of their kind that is not lost."""
    alone = np.zeros(inside.shape, np.bool_)
    for a in range(1, inside.shape[0] - 1):
        for b in range(1, inside.shape[1] - 1):
            for c in range(1, inside.shape[2] - 1):
                if not lost[a, b, c]:
                    continue
                alone[a, b, c] = True
                for k in range(27):
                    x, y, z = a + k // 9 - 1, b + k // 3 % 3 - 1, c + k % 3 - 1
                    if inside[x, y, z] == inside[a, b, c] and not lost[x, y, z]:
                        alone[a, b, c] = False
    return alone


@njit(cache=True)
def _unsmooth(field: np.ndarray, inside: NDArray[np.bool_], where: NDArray[np.bool_]) -> None:
    """Make the smoothed field the sharp one around `where`, with a transition of one voxel."""
    sharp = np.zeros(field.shape, np.uint8)  # 28 where sharp; else how many of the 27 cells around are
    for step in range(2):
        for a in range(1, field.shape[0] - 1):
            for b in range(1, field.shape[1] - 1):
                for c in range(1, field.shape[2] - 1):
                    if (step == 0 and not where[a, b, c]) or (step == 1 and sharp[a, b, c] < 28):
                        continue
                    for k in range(27):
                        x, y, z = a + k // 9 - 1, b + k // 3 % 3 - 1, c + k % 3 - 1
                        if step == 0:
                            sharp[x, y, z] = 28
                        elif sharp[x, y, z] < 28:
                            sharp[x, y, z] += 1
    for a in range(field.shape[0]):
        for b in range(field.shape[1]):
            for c in range(field.shape[2]):
                if sharp[a, b, c] > 0:
                    share = min(np.float32(1.0), sharp[a, b, c] / np.float32(27.0))
                    field[a, b, c] = (1 - share) * field[a, b, c] + share * inside[a, b, c]


def _pieces(part: np.ndarray) -> int:
    pieces = np.empty(part.shape, np.int32)
    return int(ndimage.label(part, NEIGHBOURS, output=pieces))  # pyright: ignore[reportArgumentType]
