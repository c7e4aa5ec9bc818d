"""The frames of a body: their places, their weights, their order in the tree, their control points (the paper, §4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjframes.base.errors import MjframesError
from mjframes.body.options import Paper
from mjframes.elasticity.regions import Regions, frame_sets, renumbered, split_regions
from mjframes.frames.placement import place_frames
from mjframes.kinematics.control import control_points, frame_types
from mjframes.kinematics.shape_functions import ShapeFunctions
from mjframes.kinematics.tree import Tree, depth_first, frame_tree
from mjframes.volume.grid import Grid
from mjframes.weights.weights import Weights, frame_weights


@dataclass(frozen=True, eq=False)
class Frames:
    """f frames, numbered depth first in the tree; those of held pieces come first.

    types: (f,).
    seeds: the voxels of each frame's core.
    tree: of elimination.
    shapes: their weights, not corrected.
    regions: the paper's integration samples, None where the whole body is condensed.
    """

    types: tuple[str, ...]
    seeds: tuple[NDArray[np.integer], ...]
    tree: Tree
    shapes: ShapeFunctions
    regions: Regions | None


def place(
    grid: Grid,
    metric: Grid,
    cores: Sequence[NDArray[np.integer]],
    frames: int | None,
    at: ArrayLike | None,
    seed: int,
    frame_type: str | Sequence[str],
    weights: Weights,
    paper: Paper | None,
) -> Frames:
    """Return the frames on a grid, placed and weighted as if its materials were those of `metric`.

    cores: voxels of the pieces that are held.  paper: its regions are made too, None for none.  The others are
    arguments of `build`.
    """
    placement = place_frames(metric, frames, at, seed, cores)
    types = ("affine",) * len(cores) + frame_types(frame_type, len(placement.seeds) - len(cores))
    if len(types) == 1 and types[0] in ("point", "rigid"):
        raise MjframesError(f"one {types[0]!r} frame cannot be deformed; ask for more, or for another frame_type.")
    shares = frame_weights(metric, placement, weights)
    regions = split_regions(grid, shares, paper.samples) if paper else None
    sets = regions.frames if regions else [np.flatnonzero(row).tolist() for row in frame_sets(shares)[1]]
    tree = frame_tree(sets, len(types), len(cores))
    types = tuple(types[i] for i in tree.order)
    seeds = tuple(placement.seeds[i] for i in tree.order)
    regions = renumbered(regions, tree.order) if regions else None
    shares, tree = depth_first(shares, tree)
    return Frames(types, seeds, tree, ShapeFunctions(shares, control_points(grid, shares, types)), regions)
