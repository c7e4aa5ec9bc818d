"""Voxels' fields at any point: trilinear among those with the same frames as the nearest one (the paper, §4.3)."""

from __future__ import annotations

import itertools

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial import KDTree

from mjframes.volume.grid import Grid
from mjframes.weights.weights import frame_count

REACH = 2  # [voxels] around a point in which its nearest voxel is looked for first


def voxel_shares(grid: Grid, weights: csr_array, points: np.ndarray, nearest: np.ndarray | None = None) -> csr_array:
    """Return c_v (s, n) with which fields at the voxels make up their values at points; rows sum to 1.

    Trilinear over the voxels with the nearest voxel's frames; that voxel alone where it is rigid.
    weights: (n, f) at the voxels.  points: (s, 3) volume coordinates [m], within a voxel or so of the inside.
    nearest: their `closest_voxels`, where they are known.
    """
    points = np.asarray(points, dtype=np.float64)
    nearest = closest_voxels(grid, points) if nearest is None else nearest
    pattern = _patterns(weights)
    cell = (points - grid.origin) @ grid.axes / grid.spacing - 0.5  # the centres of voxels are at integers
    base = np.floor(cell).astype(np.int64)
    fraction = cell - base
    voxel = np.empty((len(points), 8), np.int64)
    coefficient = np.empty((len(points), 8))
    for k, offset in enumerate(itertools.product((0, 1), repeat=3)):
        index = base + offset
        valid = np.all((index >= 0) & (index < grid.lookup.shape), axis=1)
        v = np.where(valid, grid.lookup[tuple(np.where(valid[:, None], index, 0).T)], -1)
        same = (v >= 0) & (pattern[v] == pattern[nearest])
        voxel[:, k] = np.where(same, v, nearest)
        coefficient[:, k] = same * np.where(offset, fraction, 1 - fraction).prod(axis=1)
    total = coefficient.sum(axis=1)
    alone = (total < 1e-6) | (grid.piece[nearest] >= 0)
    coefficient[alone], coefficient[alone, 0], voxel[alone, 0], total[alone] = 0.0, 1.0, nearest[alone], 1.0
    rows = np.repeat(np.arange(len(points)), 8)
    used = coefficient.ravel() > 0
    entries = ((coefficient / total[:, None]).ravel()[used], (rows[used], voxel.ravel()[used]))
    return csr_array(entries, shape=(len(points), len(grid.index)))


def closest_voxels(grid: Grid, points: np.ndarray) -> np.ndarray:
    """Return the voxel (s,) whose centre is closest to each point (s, 3), in volume coordinates [m]."""
    at = (points - grid.origin) @ grid.axes / grid.spacing - 0.5
    nearest = _search(at, grid.lookup, grid.spacing)
    if (far := nearest < 0).any():
        # so far from all voxels around it, a point is outside
        nearest[far] = grid.outermost[KDTree(grid.points(grid.outermost)).query(points[far])[1]]
    return nearest


@njit(cache=True)
def _search(at: NDArray[np.float64], lookup: NDArray[np.int32], spacing: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the nearest voxel (s,) to places in index coordinates (s, 3), −1 if it is not in the 5³ cells around."""
    nearest = np.full(len(at), -1, np.int64)
    for s in range(len(at)):
        base = (round(at[s, 0]), round(at[s, 1]), round(at[s, 2]))
        best = (REACH + 0.5) * spacing.min()  # what is farther may be nearer than the cells looked at
        best *= best
        for a in range(max(0, base[0] - REACH), min(lookup.shape[0], base[0] + REACH + 1)):
            for b in range(max(0, base[1] - REACH), min(lookup.shape[1], base[1] + REACH + 1)):
                for c in range(max(0, base[2] - REACH), min(lookup.shape[2], base[2] + REACH + 1)):
                    if lookup[a, b, c] < 0:
                        continue
                    x, y, z = (a - at[s, 0]) * spacing[0], (b - at[s, 1]) * spacing[1], (c - at[s, 2]) * spacing[2]
                    square = x * x + y * y + z * z
                    if square < best:
                        best, nearest[s] = square, lookup[a, b, c]
    return nearest


def _patterns(weights: csr_array) -> np.ndarray:
    """(n,) one number per set of frames: a sum of 64-bit random keys, of which two sets practically never agree."""
    keys = np.random.default_rng(0).integers(1, 2**63, frame_count(weights), dtype=np.uint64)
    return _sum_keys(weights.indptr, weights.indices, weights.data, keys)


@njit(cache=True)
def _sum_keys(
    indptr: NDArray[np.integer], indices: NDArray[np.integer], data: NDArray, keys: NDArray[np.uint64]
) -> NDArray[np.uint64]:
    pattern = np.zeros(len(indptr) - 1, np.uint64)
    for v in range(len(pattern)):
        for k in range(indptr[v], indptr[v + 1]):
            if data[k] != 0:
                pattern[v] += keys[indices[k]]
    return pattern
