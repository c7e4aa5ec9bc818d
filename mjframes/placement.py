"""Where the frames are: farthest-point sampling, then Lloyd relaxation, in compliance distance (the paper, §4.4).

Rigid pieces come first: one frame in each, with the whole piece as its seed, so that nothing blends inside it. Each
further frame starts at the voxel farthest from all others. Then every frame on a single voxel moves to the centre of
its Voronoi cell, weighted by compliance (c dV measures what the metric measures), while Σ_v c_v d_v² decreases.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjframes.distance import Reached, VoxelGraph, compliance_distance, voxel_graph
from mjframes.errors import MjframesError
from mjframes.grid import Grid

LLOYD_ITERATIONS = 20  # it mostly stops by itself after 3 to 8
SNAP_VOXELS = 2  # [voxels] a position on the surface may fall just outside; farther off is a mistake

Seeds = list[NDArray[np.int64]]


@dataclass(frozen=True, eq=False)
class Placement:
    """f frames. seeds: the voxels of each frame's core, where its weight is 1.  centers: (f, 3) their centroids [m]."""

    centers: NDArray[np.float64]
    seeds: tuple[NDArray[np.int64], ...]


def place_frames(grid: Grid, frames: int | None = None, at: ArrayLike | None = None, seed: int = 0) -> Placement:
    """Distribute `frames` frames, or take the voxels nearest to the positions `at`.

    grid: of a connected volume.  at: (f, 3) volume coordinates [m]; these frames stay where they are.
    seed: of the voxel from which the first frame is the farthest, where no rigid piece takes it.
    Raises MjframesError if the volume has no room for them, or if a position is off the volume or taken.
    """
    if at is not None:
        seeds = _seeds_at(grid, at)
        if frames not in (None, len(seeds)):
            raise MjframesError(f"frames is {frames}, but at has {len(seeds)} positions; leave frames out.")
    else:
        seeds = _distribute(grid, frames, seed)
    return Placement(np.array([grid.centers[s].mean(axis=0) for s in seeds]), tuple(seeds))


def _distribute(grid: Grid, frames: int | None, seed: int) -> Seeds:
    sizes = np.bincount(grid.piece[grid.piece >= 0])
    room = len(sizes) + int(np.count_nonzero(grid.piece < 0))
    if not isinstance(frames, (int, np.integer)) or not 1 <= frames <= room:
        raise MjframesError(
            f"frames is {frames!r}; it must be an integer from 1 to {room}, one a soft voxel or rigid piece."
        )
    largest_first = np.argsort(-sizes, kind="stable")[:frames]
    seeds = [np.flatnonzero(grid.piece == piece) for piece in largest_first]
    graph = voxel_graph(grid)
    if seeds:
        nearest = _voronoi(graph, seeds)
    else:
        arbitrary = np.random.default_rng(seed).integers(len(grid.index))
        seeds = [np.array([np.argmax(compliance_distance(graph, arbitrary).distance)])]
        nearest = _voronoi(graph, seeds)
    fixed = len(largest_first)
    while len(seeds) < frames:
        farthest = np.argmax(nearest.distance)
        nearest = compliance_distance(graph, farthest, label=len(seeds), start=nearest)
        seeds.append(np.array([farthest]))
    return _lloyd(grid, graph, seeds, fixed, nearest)


def _lloyd(grid: Grid, graph: VoxelGraph, seeds: Seeds, fixed: int, nearest: Reached) -> Seeds:
    """Move the seeds after the first `fixed` to their cells' centres while that brings the voxels nearer to them."""
    spread = _spread(grid, nearest)
    for _ in range(LLOYD_ITERATIONS if fixed < len(seeds) else 0):
        moved = seeds[:fixed] + [_center(grid, nearest.label == i) for i in range(fixed, len(seeds))]
        nearest = _voronoi(graph, moved)
        if (now := _spread(grid, nearest)) >= spread:  # also when nothing moved
            break
        seeds, spread = moved, now
    return seeds


def _center(grid: Grid, in_cell: NDArray[np.bool_]) -> NDArray[np.int64]:
    """The soft voxel of a cell that is nearest to the cell's centroid under the measure c dV."""
    cell = np.flatnonzero(in_cell & (grid.piece < 0))
    points, compliance = grid.centers[cell], grid.compliance[cell]
    offset = points - compliance @ points / compliance.sum()
    return cell[[np.argmin(np.einsum("va,va->v", offset, offset))]]


def _spread(grid: Grid, nearest: Reached) -> float:
    return float(grid.compliance @ nearest.distance**2)


def _voronoi(graph: VoxelGraph, seeds: Seeds) -> Reached:
    label = np.repeat(np.arange(len(seeds)), [len(s) for s in seeds])
    return compliance_distance(graph, np.concatenate(seeds), label=label)


def _seeds_at(grid: Grid, at: ArrayLike) -> Seeds:
    try:
        positions = np.asarray(at, np.float64)
    except (TypeError, ValueError):
        positions = np.empty(0)
    if positions.ndim != 2 or positions.shape[-1] != 3 or not len(positions) or not np.isfinite(positions).all():
        raise MjframesError("at must be an (n, 3) array of positions in volume coordinates in metres, n ≥ 1.")
    seeds: Seeds = []
    taken: dict[tuple[str, int], int] = {}
    for i, position in enumerate(positions):
        offset = (grid.centers - position) @ grid.axes / grid.spacing
        square = np.einsum("va,va->v", offset, offset)
        v = int(np.argmin(square))
        if square[v] > SNAP_VOXELS**2:
            raise MjframesError(
                f"at[{i}] = {position.tolist()} is {np.sqrt(square[v]):.1f} voxels away from the volume; "
                f"it must be at most {SNAP_VOXELS}, in volume coordinates in metres."
            )
        piece = int(grid.piece[v])
        place = ("rigid piece", piece) if piece >= 0 else ("voxel", v)
        if (other := taken.setdefault(place, i)) != i:
            raise MjframesError(f"at[{other}] and at[{i}] fall into the same {place[0]}; move or drop one of them.")
        seeds.append(np.flatnonzero(grid.piece == piece) if piece >= 0 else np.array([v]))
    return seeds
