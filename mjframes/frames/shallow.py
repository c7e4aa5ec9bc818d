"""Frames of a shallow body: one whose held piece is nearer to most of it than its frames are to each other.

In the paper (§4.4) a held piece counts as a frame among others. Of a wide pad that is glued at its base all of the top
is equally far from that piece, so farthest points crowd in a corner, and a frame's weight reaches no farther sideways
than down to the base. The frames of a shallow body are placed as if its held piece were not there (weights/shallow.py
has their weights). With d the distance to the held piece and r that to the nearest frame, a body is shallow where

    Σ_v c_v d_v² < DEPTH² Σ_v c_v r_v²
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjframes.frames.distance import compliance_distance, voxel_graph
from mjframes.frames.placement import Placement, place_frames
from mjframes.volume.grid import Grid, without

DEPTH = 1.75  # [-] of the frames' reach, about half of the way to the next; at twice, faces of cubes get too soft


def shallow_frames(
    grid: Grid, frames: int | None, at: ArrayLike | None, seed: int, core: NDArray[np.integer]
) -> Placement | None:
    """Return the frames of a shallow body, with the held piece first, or None for a body that is not shallow.

    frames, at, seed: as for `place_frames`.  core: the voxels of the held piece.
    """
    rest, number = without(grid, core)
    if not len(number) or not (rest.piece < 0).any() or (frames is not None and frames < 1):
        return None
    placed = place_frames(rest, frames, at, seed)
    owner = np.repeat(np.arange(len(placed.seeds)), [len(s) for s in placed.seeds])
    reach = compliance_distance(voxel_graph(rest), np.concatenate(placed.seeds), owner).distance
    depth = compliance_distance(voxel_graph(grid), core, np.zeros(len(core), np.int64)).distance[number]
    reached, measure = reach < np.inf, rest.compliance
    if measure @ depth**2 >= DEPTH**2 * (measure[reached] @ reach[reached] ** 2):
        return None
    seeds = (core.astype(np.int64), *(number[s].astype(np.int64) for s in placed.seeds))
    return Placement(np.array([grid.points(s).mean(axis=0) for s in seeds]), seeds)
