"""Frames of a shallow body: one whose held piece is nearer to most of it than its frames are to each other.

In the paper (§4.4) a held piece counts as a frame among others. Of a wide pad that is glued at its base all of the top
is equally far from that piece, so farthest points crowd in a corner, and a frame's weight reaches no farther sideways
than down to the base. The frames of a shallow body are placed as if its held piece were not there (weights/shallow.py
has their weights). With d the distance to the held piece and r that to the nearest frame, a body is shallow where

    Σ_v c_v d_v² < DEPTH² Σ_v c_v r_v²
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjframes.frames.distance import compliance_distance, sources_of, voxel_graph
from mjframes.frames.placement import Placement, place_frames, placement_of
from mjframes.volume.grid import Grid, without

DEPTH = 1.75  # [-] of the frames' reach, about half of the way to the next; at twice, faces of cubes get too soft


@dataclass(frozen=True, eq=False)
class Shallow:
    """The frames of a shallow body of n voxels.

    placement: of all, with the held piece first.
    rest: the body of r voxels without the held piece.
    number: (r,) of its voxels in the whole body.
    free: the free frames, in the rest.
    deep: the voxels of the whole body that are as deep as the seed of their Voronoi cell in the rest.
    """

    placement: Placement
    rest: Grid
    number: NDArray[np.int32]
    free: Placement
    deep: NDArray[np.int32]


def shallow_frames(
    grid: Grid, frames: int | None, at: ArrayLike | None, seed: int, core: NDArray[np.integer]
) -> Shallow | None:
    """Return the frames of a shallow body, or None for a body that is not shallow.

    frames, at, seed: as for `place_frames`.  core: the voxels of the held piece.
    """
    rest, number = without(grid, core)
    if not len(number) or not (rest.piece < 0).any() or (frames is not None and frames < 1):
        return None
    free = place_frames(rest, frames, at, seed)
    cell = compliance_distance(voxel_graph(rest), *sources_of(free.seeds))
    depth = compliance_distance(voxel_graph(grid), core).distance[number]
    reached, measure = cell.label >= 0, rest.compliance
    if measure @ depth**2 >= DEPTH**2 * (measure[reached] @ cell.distance[reached] ** 2):
        return None
    placement = placement_of(grid, [core, *(number[seed] for seed in free.seeds)])
    enough = np.array([depth[seed].min() for seed in free.seeds])
    return Shallow(placement, rest, number, free, number[reached & (depth >= enough[cell.label])])
