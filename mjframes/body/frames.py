"""The frames of a body: their places, their weights, their order in the tree, their control points (the paper, §4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mjframes.base.choices import FRAME_TYPES
from mjframes.base.errors import MjframesError
from mjframes.body.options import BuildOptions
from mjframes.elasticity.regions import Regions, frame_sets, renumbered, split_regions
from mjframes.frames.placement import Placement, place_frames
from mjframes.frames.shallow import shallow_frames
from mjframes.kinematics.control import control_points, frame_types
from mjframes.kinematics.shape_functions import ShapeFunctions
from mjframes.kinematics.tree import Tree, depth_first, frame_tree
from mjframes.volume.grid import Grid
from mjframes.weights.kernels import Linear, weights_of
from mjframes.weights.shallow import shallow_weights
from mjframes.whole_body.families import families, renamed


@dataclass(frozen=True, eq=False)
class Frames:
    """f frames, numbered depth first in the tree; those of held pieces come first.

    types: (f,).
    seeds: the voxels of each frame's core.
    tree: the kinematic one.
    shapes: their weights, not corrected.
    regions: the paper's integration samples, None where the whole body is condensed.
    parents: of each frame in its region of the whole body, None for the paper's method.
    """

    types: tuple[str, ...]
    seeds: tuple[NDArray[np.integer], ...]
    tree: Tree
    shapes: ShapeFunctions
    regions: Regions | None
    parents: dict[int, tuple[int, ...]] | None


def place(
    grid: Grid,
    metric: Grid,
    cores: Sequence[NDArray[np.integer]],
    options: BuildOptions,
    frames: int | None,
) -> Frames:
    """Return the frames on a grid, placed and weighted as if its materials were those of `metric`.

    cores: voxels of the pieces that are held.  frames: how many besides those, None for those `at` places.
    """
    placement, shares = _placed(metric, cores, options, frames)
    types = ("affine",) * len(cores) + frame_types(options.frame_type, len(placement.seeds) - len(cores))
    if len(types) == 1 and types[0] in ("point", "rigid"):
        raise MjframesError(f"one {types[0]!r} frame cannot be deformed; ask for more, or for another frame_type.")
    _require_voxels(types, len(grid.index))
    regions, parents = None, None
    if options.paper:
        regions = split_regions(grid, shares, options.paper.samples)
        sets = regions.frames
    else:
        parents = _parents(metric, shares, len(cores))
        sets = [(i, *others) for i, others in parents.items()]
    tree = frame_tree(sets, len(types), len(cores))
    types = tuple(types[i] for i in tree.order)
    seeds = tuple(placement.seeds[i] for i in tree.order)
    regions = renumbered(regions, tree.order) if regions else None
    parents = renamed(parents, tree.order) if parents else None
    shares, tree = depth_first(shares, tree)
    return Frames(types, seeds, tree, ShapeFunctions(shares, control_points(grid, shares, types)), regions, parents)


def _placed(
    metric: Grid, cores: Sequence[NDArray[np.integer]], options: BuildOptions, frames: int | None
) -> tuple[Placement, sparse.csr_array]:
    """The frames' places, those of held pieces first, and their weights (n, f)."""
    placement, kind = place_frames(metric, frames, options.at, options.seed, cores), weights_of(options.weights)
    if len(cores) == 1 and options.paper is None and not isinstance(kind, Linear):
        shallow = shallow_frames(metric, frames, options.at, options.seed, placement.seeds[0])
        if shallow is not None:
            return shallow.placement, shallow_weights(kind, metric, shallow)
    return placement, kind.at_voxels(metric, placement)


def _parents(grid: Grid, shares: sparse.csr_array, held: int) -> dict[int, tuple[int, ...]]:
    """The families of frames with weights (n, f), the first of which are held."""
    coupled = [np.flatnonzero(row).tolist() for row in _sets(grid, shares)]
    middle = (shares.T @ grid.centers) / np.asarray(shares.sum(axis=0))[:, None]
    return families(coupled, middle, held)


def _sets(grid: Grid, shares: sparse.csr_array) -> NDArray[np.bool_]:
    """The sets (r, f) of frames that have a voxel in common, or meet at a face between voxels without a common one."""
    label, sets = frame_sets(shares)
    meeting = []
    for step in np.eye(3, dtype=np.int32):
        ahead = grid.beside(step)
        here = np.flatnonzero(ahead >= 0)
        meeting.append(np.stack([label[here], label[ahead[here]]], axis=1))
    pairs = np.unique(np.concatenate(meeting), axis=0)
    apart = pairs[~(sets[pairs[:, 0]] & sets[pairs[:, 1]]).any(axis=1)]
    return np.concatenate([sets, sets[apart[:, 0]] | sets[apart[:, 1]]])


def most_frames(frame_type: str | Sequence[str], voxels: int) -> int:
    """Return as many as so many voxels tell apart, if all are of the type that needs most."""
    kinds = [frame_type] if isinstance(frame_type, str) else frame_type
    return voxels // max((FRAME_TYPES[kind].voxels for kind in kinds if kind in FRAME_TYPES), default=1)


def _require_voxels(types: Sequence[str], voxels: int) -> None:
    needed = sum(FRAME_TYPES[name].voxels for name in types)
    if len(types) > 1 and needed > voxels:
        raise MjframesError(
            f"frames is {len(types)}, held ones included, but the volume has {voxels} voxels: too few to tell them "
            f"apart; use at most {max(1, voxels * len(types) // needed)}, or smaller voxels."
        )
