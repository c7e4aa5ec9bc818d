"""Regions: sets of voxels that the same frames influence, split where their weights are least linear (the paper, §5.3).

Weights inside a region are compared with their least-squares fit w_i ≈ a_i + b_i · p; its squared residuals follow from
the moments Σ x xᵀ, Σ x wᵀ, Σ w wᵀ with x = (1, p). The region with the largest sum of them is cut in two through its
centroid, across its longest principal axis, until there are as many regions as samples. Where there are more sets of
frames than samples, the smallest region joins the one that gains the fewest frames by it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from heapq import heapify, heappop, heappush

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import sparse

from mjframes.base.errors import MjframesError
from mjframes.base.numbers import is_whole
from mjframes.base.rows import distinct_rows, members_of
from mjframes.base.threads import in_parallel
from mjframes.volume.grid import Grid
from mjframes.weights.weights import frame_count

LINEAR_FIT = 1e-6  # [-] rms residual of weights that need no further cut: rounding leaves about 1e-8
FLAT = 1e-9  # [-] relative second moment below which a region has no extent in a direction


@dataclass(frozen=True, eq=False)
class Regions:
    """r regions.

    label: (n,) int32, the region of each voxel.
    frames: the frames of each, ascending.
    """

    label: NDArray[np.int32]
    frames: tuple[tuple[int, ...], ...]


@dataclass(frozen=True, eq=False)
class _Part:
    """A region under construction: its voxels, its centroid in the grid's axes [m], and the fit of its weights."""

    voxels: NDArray[np.int32]
    center: NDArray[np.float64]
    residual: float
    axis: NDArray[np.float64]

    @property
    def fit_error(self) -> float:
        return float(np.sqrt(self.residual / len(self.voxels)))


def split_regions(grid: Grid, weights: sparse.csr_array, samples: int) -> Regions:
    """Return at most `samples` regions; fewer if the weights (n, f) are linear in all of them before that.

    Raise MjframesError for samples < 1.
    """
    if not is_whole(samples) or samples < 1:
        raise MjframesError(f"samples is {samples!r}; it must be an integer ≥ 1, the number of regions.")
    label, sets = frame_sets(weights)
    label, sets = _without_films(grid, label, sets)
    if len(sets) > samples:
        label, sets = _merge(grid, label, sets, samples)
    frames = [tuple(np.flatnonzero(row).tolist()) for row in sets]
    parts = list(in_parallel(lambda voxels: _part(grid, weights, voxels), members_of(label, len(sets))))
    worst_first = [(-part.residual, e) for e, part in enumerate(parts) if part.fit_error > LINEAR_FIT]
    heapify(worst_first)
    while len(parts) < samples and worst_first:
        e = heappop(worst_first)[1]
        halves = [_part(grid, weights, voxels) for voxels in _halves(grid, parts[e])]
        parts[e] = halves[0]
        parts.append(halves[1])
        frames.append(frames[e])
        for number, half in zip((e, len(parts) - 1), halves, strict=True):
            if half.fit_error > LINEAR_FIT:
                heappush(worst_first, (-half.residual, number))
    for e, part in enumerate(parts):
        label[part.voxels] = e
    return Regions(label, tuple(frames))


def renumbered(regions: Regions, order: NDArray[np.integer]) -> Regions:
    """Return the same with frame order[i] called i."""
    number = np.argsort(order)
    return replace(regions, frames=tuple(tuple(sorted(int(number[i]) for i in some)) for some in regions.frames))


def frame_sets(weights: sparse.csr_array) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
    """Return the number (n,) of each voxel's set of frames, in order of appearance, and the sets (r, f).

    weights: (n, f).
    """
    label, first = distinct_rows(weights.indptr, weights.indices)
    return label, weights[first].toarray() > 0


def _without_films(
    grid: Grid, label: NDArray[np.int32], sets: NDArray[np.bool_]
) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
    """Without soft voxels of one frame alone that are but one voxel thick along an axis: those join a neighbour's set.

    A frame's seed of one voxel is the top of its hat. As a region of its own it would be as wide as a voxel, and flat.
    """
    frame = np.where(sets.sum(axis=1) == 1, sets.argmax(axis=1), -1).astype(np.int32)
    joined = _join_films(grid.index, grid.padded, grid.piece, label, frame, sets)
    kept, number = np.unique(joined, return_inverse=True)
    return number.astype(np.int32).ravel(), sets[kept]


def _part(grid: Grid, weights: sparse.csr_array, voxels: NDArray[np.int32]) -> _Part:
    """The linear fit of the weights of some voxels, and their longest principal axis."""
    mean = grid.index[voxels].mean(axis=0)
    column = np.full(frame_count(weights), -1, np.int64)
    square, product, spread = _moments(grid.index, voxels, mean, weights.indptr, weights.indices, weights.data, column)
    extent, axes = np.linalg.eigh(square * np.outer(grid.spacing, grid.spacing))
    across = extent > FLAT * extent[-1]
    slope = axes[:, across].T @ (product * grid.spacing[:, None]) / np.sqrt(extent[across])[:, None]
    residual = float(max(0.0, spread - np.sum(slope**2)))
    longest = axes[:, -1] * np.sign(axes[np.argmax(np.abs(axes[:, -1])), -1])
    return _Part(voxels, mean, residual, longest)


def _halves(grid: Grid, part: _Part) -> list[NDArray[np.int32]]:
    far = (grid.index[part.voxels] - part.center) @ (grid.spacing * part.axis) > 0
    return [part.voxels[~far], part.voxels[far]]


def _merge(
    grid: Grid, label: NDArray[np.int32], sets: NDArray[np.bool_], samples: int
) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
    """Fewer sets: the smallest joins the one that gains the fewest frames, of those the nearest."""
    sets = sets.copy()
    size = np.bincount(label).astype(float)
    center = np.stack([np.bincount(label, weights=grid.index[:, a]) for a in range(3)], axis=1) / size[:, None]
    center *= grid.spacing
    into = np.arange(len(size))
    for _ in range(len(size) - samples):
        small = int(np.argmin(size))
        gained = (sets[small] & ~sets).sum(axis=1).astype(float)
        gained[~np.isfinite(size)] = np.inf
        gained[small] = np.inf
        near = np.flatnonzero(gained == gained.min())
        target = near[np.argmin(np.sum((center[near] - center[small]) ** 2, axis=1))]
        total = size[target] + size[small]
        center[target] += (center[small] - center[target]) * (size[small] / total)
        size[target], size[small] = total, np.inf  # inf: gone
        sets[target] |= sets[small]
        into[into == small] = target
    kept, number = np.unique(into, return_inverse=True)
    return number.astype(np.int32)[label], sets[kept]


@njit(cache=True, nogil=True)
def _join_films(
    index: NDArray[np.int32],
    padded: NDArray[np.int32],
    piece: NDArray[np.int32],
    label: NDArray[np.int32],
    frame: NDArray[np.int32],
    sets: NDArray[np.bool_],
) -> NDArray[np.int32]:
    """Return labels (n,), films with that of a neighbour; frame: (r,) of sets of one frame alone, −1 for others."""
    joined = label.copy()
    for v in range(len(label)):
        i = frame[label[v]]
        if i < 0 or piece[v] >= 0:
            continue
        x, y, z = index[v, 0] + 1, index[v, 1] + 1, index[v, 2] + 1
        for axis in range(3):
            target, thin = np.int32(-1), True
            for side in (-1, 1):
                n = padded[x + side * (axis == 0), y + side * (axis == 1), z + side * (axis == 2)]
                if n >= 0:
                    thin &= label[n] != label[v]
                    if target < 0 and sets[label[n], i]:
                        target = label[n]
            if thin and target >= 0:
                joined[v] = target
                break
    return joined


@njit(cache=True, nogil=True)
def _moments(
    index: NDArray[np.int32],
    voxels: NDArray[np.int32],
    mean: NDArray[np.float64],
    indptr: NDArray[np.integer],
    indices: NDArray[np.integer],
    data: NDArray,
    column: NDArray[np.int64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Σ x xᵀ, Σ x w_iᵀ and Σ_i Σ (w_i − its mean)², x the voxels' indices relative to their mean.

    column: (f,) all −1; frames get one in the order in which they occur.
    """
    frames = 0
    total, count = np.zeros(len(column)), np.zeros(len(column))
    for v in voxels:
        for e in range(indptr[v], indptr[v + 1]):
            i = column[indices[e]]
            if i < 0:
                i = column[indices[e]] = frames
                frames += 1
            total[i] += data[e]
            count[i] += 1
    total /= len(voxels)
    square, product, spread = np.zeros((3, 3)), np.zeros((3, frames)), 0.0
    for v in voxels:
        x, y, z = index[v, 0] - mean[0], index[v, 1] - mean[1], index[v, 2] - mean[2]
        square[0, 0] += x * x
        square[1, 0] += y * x
        square[1, 1] += y * y
        square[2, 0] += z * x
        square[2, 1] += z * y
        square[2, 2] += z * z
        for e in range(indptr[v], indptr[v + 1]):
            i, w = column[indices[e]], data[e]
            product[0, i] += x * w
            product[1, i] += y * w
            product[2, i] += z * w
            spread += (w - total[i]) ** 2
    for i in range(frames):
        spread += (len(voxels) - count[i]) * total[i] ** 2
    square[0, 1], square[0, 2], square[1, 2] = square[1, 0], square[2, 0], square[2, 1]
    return square, product, spread
