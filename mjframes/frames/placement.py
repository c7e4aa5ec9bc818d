"""Where the frames are: farthest-point sampling, then Lloyd relaxation, in compliance distance (the paper, §4.4).

Pieces that are given (fixed or attached ones) and rigid pieces come first: one frame in each, with the whole piece as
its seed, so that nothing blends inside it. Each further frame starts where the compliance distance to all others is
largest. Then every frame on a single voxel moves to the centre of its Voronoi cell, weighted by compliance (c dV
measures what the metric measures), while Σ_v c_v d_v² decreases: first on clusters of voxels, then on voxels.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from mjframes.base.errors import MjframesError
from mjframes.base.numbers import is_whole
from mjframes.base.rows import members_of
from mjframes.frames.clusters import ClusterGraph, cluster_graph, improve
from mjframes.frames.distance import nearest_sources, voxel_graph
from mjframes.volume.grid import Grid, nearest_voxels

LLOYD_ITERATIONS = 20  # on clusters; it mostly stops by itself after 3 to 8
FINE_ITERATIONS = 1  # on voxels: what a cluster's size left undone
CLUSTERS = 3000  # at most about that many, and at least …
CLUSTERS_A_FRAME = 100  # … that many for each frame
SNAP_VOXELS = 2  # [voxels] a position on the surface may fall just outside; farther off is a mistake

Seeds = list[NDArray[np.integer]]
Nearest = tuple[NDArray[np.float64], NDArray[np.int32]]  # distance to the nearest seed, and its label


@dataclass(frozen=True, eq=False)
class Placement:
    """f frames.

    seeds: the voxels of each frame's core, where its weight is 1.
    centers: (f, 3) their centroids [m].
    """

    centers: NDArray[np.float64]
    seeds: tuple[NDArray[np.integer], ...]


def place_frames(
    grid: Grid,
    frames: int | None = None,
    at: ArrayLike | None = None,
    seed: int = 0,
    cores: Sequence[ArrayLike] = (),
) -> Placement:
    """Distribute `frames` frames, or take the voxels nearest to the positions `at`, besides one for each of `cores`.

    grid: of a connected volume.  at: (f, 3) volume coordinates [m]; these frames stay where they are.
    seed: of the voxel from which the first frame is the farthest, where neither a core nor a rigid piece takes it.
    cores: voxel numbers of pieces that have a frame each; these come first, in this order. A core that touches a rigid
    piece takes all of it.
    Raise MjframesError if the volume has no room for them, if a position is off the volume or taken, or if cores are
    empty or overlap.
    """
    seeds = _given_cores(grid, cores)
    if at is not None:
        positions = _positions(at)
        if frames not in (None, len(positions)):
            raise MjframesError(f"frames is {frames}, but at has {len(positions)} positions; leave frames out.")
        seeds += _seeds_at(grid, positions, seeds)
    else:
        seeds = _distribute(grid, frames, seed, seeds)
    return placement_of(grid, seeds)


def placement_of(grid: Grid, seeds: Sequence[NDArray[np.integer]]) -> Placement:
    """Return the frames with these seeds."""
    return Placement(np.array([grid.points(s).mean(axis=0) for s in seeds]), tuple(seeds))


def _given_cores(grid: Grid, cores: Sequence[ArrayLike]) -> Seeds:
    seeds: Seeds = []
    owner = np.full(len(grid.index) if len(cores) else 0, -1, np.int32)
    for i, core in enumerate(cores):
        voxels = np.unique(np.asarray(core))
        if not len(voxels) or voxels.dtype.kind not in "iu" or voxels[0] < 0 or voxels[-1] >= len(grid.index):
            raise MjframesError(f"cores[{i}] must be numbers of voxels from 0 to {len(grid.index) - 1}, at least one.")
        pieces = np.unique(grid.piece[voxels])
        if pieces[-1] >= 0:
            voxels = np.union1d(voxels, np.flatnonzero(np.isin(grid.piece, pieces[pieces >= 0])))
        if (taken := owner[voxels].max()) >= 0:
            raise MjframesError(f"cores[{taken}] and cores[{i}] overlap or share a rigid piece; join them or move one.")
        owner[voxels] = i
        seeds.append(voxels.astype(np.int64))
    return seeds


def _distribute(grid: Grid, frames: int | None, seed: int, seeds: Seeds) -> Seeds:
    rigid = np.flatnonzero(grid.piece >= 0)
    taken = np.concatenate([*seeds, np.empty(0, np.int64)])
    pieces = np.setdiff1d(grid.piece[rigid], grid.piece[taken])
    sizes = np.bincount(grid.piece[rigid])[pieces] if len(pieces) else pieces
    room = len(pieces) + int(np.count_nonzero(grid.piece < 0) - np.count_nonzero(grid.piece[taken] < 0))
    fewest = 0 if seeds else 1
    if frames is None or not is_whole(frames) or not fewest <= frames <= room:
        raise MjframesError(
            f"frames is {frames!r}; it must be an integer from {fewest} to {room}, one a soft voxel or rigid piece."
        )
    by_piece = members_of(grid.piece, int(grid.piece.max()) + 1)
    for p in pieces[np.argsort(-sizes, kind="stable")[:frames]]:
        seeds = [*seeds, by_piece[p].astype(np.int64)]
    free = frames - min(frames, len(pieces))
    return seeds + _spread_out(grid, free, seed, seeds) if free else seeds


def _spread_out(grid: Grid, free: int, seed: int, fixed: Seeds) -> Seeds:
    """`free` single voxels, as far from each other and from `fixed` as they come."""
    graph, held, block = _clusters(grid, free, fixed)
    chosen = _farthest_points(
        graph, free, int(graph.cluster[np.random.default_rng(seed).integers(len(grid.index))]), held
    )

    def nearest_of_clusters(free_seeds: NDArray[np.int64]) -> Nearest:
        return _nearest_clusters(graph, [*held, *free_seeds[:, None]])

    measure = graph.size * graph.compliance
    chosen = _lloyd(nearest_of_clusters, graph.middle, grid.spacing, measure, chosen, len(fixed), LLOYD_ITERATIONS)
    if block == 1:
        return list(chosen[:, None])

    fine, held_voxels = voxel_graph(grid), np.concatenate([*fixed, np.empty(0, np.int64)])
    owner = np.concatenate([np.repeat(np.arange(len(fixed)), [len(s) for s in fixed]), len(fixed) + np.arange(free)])

    def nearest_of_voxels(free_seeds: NDArray[np.int64]) -> Nearest:
        found = nearest_sources(fine, np.concatenate([held_voxels, free_seeds]), owner)
        return found.distance, found.label

    measure = grid.per_material("compliance")[grid.material]
    label = nearest_of_clusters(chosen)[1][graph.cluster]
    index = grid.index.astype(np.float64)
    chosen = _centers(index, grid.spacing, measure, label, len(fixed), free)
    chosen = _lloyd(nearest_of_voxels, index, grid.spacing, measure, chosen, len(fixed), FINE_ITERATIONS)
    return list(chosen[:, None])


def _clusters(grid: Grid, free: int, fixed: Seeds) -> tuple[ClusterGraph, Seeds, int]:
    """Clusters for that many more frames, those that `fixed` hold, and the size of their blocks."""
    wanted = max(CLUSTERS, CLUSTERS_A_FRAME * (free + len(fixed)))
    block = max(1, round((len(grid.index) / wanted) ** (1 / 3)))
    while _occupied(grid.index, grid.lookup.shape, block) > 1.5 * wanted:  # flat and thread-like volumes
        block += 1 + block // 2
    while True:
        graph = cluster_graph(grid, block)
        held: Seeds = [np.unique(graph.cluster[s]) for s in fixed]
        is_free = graph.compliance > 0
        is_free[np.concatenate([*held, np.empty(0, np.int32)])] = False
        if block == 1 or np.count_nonzero(is_free) >= CLUSTERS_A_FRAME * free:
            return graph, held, block
        block //= 2


def _farthest_points(graph: ClusterGraph, free: int, arbitrary: int, held: Seeds) -> NDArray[np.int64]:
    chosen: list[int] = []
    if not held:
        chosen.append(int(np.argmax(_nearest_clusters(graph, [np.array([arbitrary])])[0])))
    distance, label = _nearest_clusters(graph, held or [np.array(chosen)])
    while len(chosen) < free:
        farthest = int(np.argmax(distance))
        distance[farthest], label[farthest] = 0.0, len(held) + len(chosen)
        improve(graph, np.array([farthest], np.int32), distance, label)
        chosen.append(farthest)
    return np.array(chosen)


def _nearest_clusters(graph: ClusterGraph, seeds: Seeds) -> Nearest:
    distance, label = np.full(len(graph.size), np.inf), np.full(len(graph.size), -1, np.int32)
    for i in reversed(range(len(seeds))):  # a cluster that holds seeds of several frames goes to the first of them
        distance[seeds[i]], label[seeds[i]] = 0.0, i
    improve(graph, np.unique(np.concatenate(seeds)).astype(np.int32), distance, label)
    return distance, label


def _lloyd(
    nearest_of: Callable[[NDArray[np.int64]], Nearest],
    index: NDArray[np.float64],
    spacing: NDArray[np.float64],
    measure: NDArray[np.float64],
    seeds: NDArray[np.int64],
    fixed: int,
    iterations: int,
) -> NDArray[np.int64]:
    """Move the seeds (free,) to their cells' centres while that brings everything nearer to them.

    index: (n, 3) and measure: (n,) c dV of the voxels or clusters.  The seeds' labels come after `fixed` others.
    """
    distance, label = nearest_of(seeds)
    spread = _spread(measure, distance)
    for _ in range(iterations):
        moved = _centers(index, spacing, measure, label, fixed, len(seeds))
        distance, label = nearest_of(moved)
        if (now := _spread(measure, distance)) >= spread:  # also when nothing moved
            break
        seeds, spread = moved, now
    return seeds


@njit(cache=True, nogil=True)
def _centers(
    index: NDArray[np.float64],
    spacing: NDArray[np.float64],
    measure: NDArray[np.float64],
    label: NDArray[np.int32],
    fixed: int,
    free: int,
) -> NDArray[np.int64]:
    """(free,) of each cell whose label is `fixed` or more: what is nearest to its centroid under the measure."""
    mean, total = np.zeros((free, 3)), np.zeros(free)
    for v in range(len(measure)):
        i = label[v] - fixed
        if i >= 0 and measure[v] > 0:
            total[i] += measure[v]
            for axis in range(3):
                mean[i, axis] += measure[v] * index[v, axis]
    for i in range(free):
        for axis in range(3):
            mean[i, axis] /= total[i]
    nearest, square = np.full(free, -1, np.int64), np.full(free, np.inf)
    for v in range(len(measure)):
        i = label[v] - fixed
        if i >= 0 and measure[v] > 0:
            distance = 0.0
            for axis in range(3):
                distance += ((index[v, axis] - mean[i, axis]) * spacing[axis]) ** 2
            if distance < square[i]:
                nearest[i], square[i] = v, distance
    return nearest


@njit(cache=True, nogil=True)
def _spread(measure: NDArray[np.float64], distance: NDArray[np.float64]) -> float:
    """Return Σ_v c_v d_v² over what is not rigid, and what a seed reaches."""
    total = 0.0
    for v in range(len(measure)):
        if measure[v] > 0 and distance[v] < np.inf:
            total += measure[v] * distance[v] ** 2
    return total


def _occupied(index: NDArray[np.int32], shape: tuple[int, ...], block: int) -> int:
    """Return how many blocks have a voxel."""
    seen = np.zeros([-(-cells // block) for cells in shape], np.bool_)
    seen[tuple((index // block).T)] = True
    return int(np.count_nonzero(seen))


def _positions(at: ArrayLike) -> NDArray[np.float64]:
    try:
        positions = np.asarray(at, np.float64)
    except (TypeError, ValueError):
        positions = np.empty(0)
    if positions.ndim != 2 or positions.shape[-1] != 3 or not len(positions) or not np.isfinite(positions).all():
        raise MjframesError("at must be an (n, 3) array of positions in volume coordinates in metres, n ≥ 1.")
    return positions


def _seeds_at(grid: Grid, positions: NDArray[np.float64], cores: Seeds) -> Seeds:
    seeds: Seeds = []
    taken: dict[tuple[str, int], int] = {}
    nearest = nearest_voxels(grid, positions, SNAP_VOXELS)
    for i, v in enumerate(nearest.tolist()):
        if v < 0:
            offset = (positions[i] - grid.origin) @ grid.axes / grid.spacing - 0.5 - grid.index
            away = np.sqrt(np.einsum("va,va->v", offset, offset).min())
            raise MjframesError(
                f"at[{i}] = {positions[i].tolist()} is {away:.1f} voxels away from the volume; "
                f"it must be at most {SNAP_VOXELS}, in volume coordinates in metres."
            )
        for core, voxels in enumerate(cores):
            if voxels[min(np.searchsorted(voxels, v), len(voxels) - 1)] == v:
                raise MjframesError(f"at[{i}] falls into cores[{core}], which has a frame already; move or drop it.")
        piece = int(grid.piece[v])
        place = ("rigid piece", piece) if piece >= 0 else ("voxel", v)
        if (other := taken.setdefault(place, i)) != i:
            raise MjframesError(f"at[{other}] and at[{i}] fall into the same {place[0]}; move or drop one of them.")
        seeds.append(np.flatnonzero(grid.piece == piece) if piece >= 0 else np.array([v]))
    return seeds
