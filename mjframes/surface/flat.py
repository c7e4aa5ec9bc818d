"""Which faces of voxels are flat parts of a surface, and not the steps of a slope or of something round.

A face is flat where it belongs to a square of 3 × 3 faces in one plane, most of whose rim is an edge or a wall and
not a step of one voxel, and no such step is near. What is narrower than the square may be a step of a slope that is
sampled twice as finely.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage

STEPS = 0.5  # [-] of a plane's rim: more steps of one voxel, and the plane is a terrace of a slope
CLEAR = 2  # [voxels] from a step: the smoothed surface is the plane again, within 2 % of a voxel


def exposed(inside: np.ndarray, axis: int, side: int) -> np.ndarray:
    """Return which voxels (nx, ny, nz) have a face on the surface, to one side (±1) along an axis."""
    return inside & ~np.roll(inside, -side, axis)


def flat_faces(face: np.ndarray, axis: int, side: int) -> np.ndarray:
    """Return which of the `exposed` faces to that side are flat; around them is a margin of two empty voxels."""
    steps, rim = np.zeros(face.shape, np.int8), np.zeros(face.shape, np.int8)
    for across in {0, 1, 2} - {axis}:
        for way in (-1, 1):
            ends = face & ~np.roll(face, -way, across)
            lower, higher = (np.roll(face, (-way, shift), (across, axis)) for shift in (side, -side))
            rim += ends
            steps += ends & (lower | higher)
    plane = np.zeros((3, 3, 3), bool)
    plane[tuple(1 if a == axis else slice(None) for a in range(3))] = True
    number = np.empty(face.shape, np.int32)
    ndimage.label(face, plane & ndimage.generate_binary_structure(3, 1), output=number)
    of_steps, of_rim = (np.bincount(number.ravel(), weights=some.ravel()) for some in (steps, rim))
    level = np.asarray(of_steps <= STEPS * of_rim)  # and no terrace
    clear = np.logical_not(ndimage.binary_dilation(steps > 0, plane, iterations=CLEAR))
    return ndimage.binary_opening(face & level[number] & clear, plane)
