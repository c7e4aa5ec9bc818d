"""Voxels' fields at any point: trilinear among those with the same frames as the nearest one (the paper, §4.3)."""

from __future__ import annotations

import itertools

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import KDTree

from mjframes.base.rows import distinct_rows
from mjframes.volume.grid import Grid, nearest_voxels

REACH = 2.5  # [smallest edges of a voxel] around a point in which its nearest voxel is looked for first


def voxel_shares(grid: Grid, weights: csr_array, points: np.ndarray, nearest: np.ndarray | None = None) -> csr_array:
    """Return c_v (s, n) with which fields at the voxels make up their values at points; rows sum to 1.

    Trilinear over the voxels with the nearest voxel's frames; that voxel alone where it is rigid.
    weights: (n, f) at the voxels.  points: (s, 3) volume coordinates [m], within a voxel or so of the inside.
    nearest: their `closest_voxels`, where they are known.
    """
    points = np.asarray(points, dtype=np.float64)
    nearest = closest_voxels(grid, points) if nearest is None else nearest
    pattern = _frame_sets(weights)
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
    nearest = nearest_voxels(grid, points, REACH * grid.spacing.min(), grid.spacing)
    if (far := nearest < 0).any():
        # so far from all voxels around it, a point is outside
        nearest[far] = grid.outermost[KDTree(grid.points(grid.outermost)).query(points[far])[1]]
    return nearest


def _frame_sets(weights: csr_array) -> np.ndarray:
    """(n,) one number per set of frames whose weight is not 0."""
    if not weights.data.all():
        weights = weights.copy()
        weights.eliminate_zeros()
    return distinct_rows(weights.indptr, weights.indices)[0]
