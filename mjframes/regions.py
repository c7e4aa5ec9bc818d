"""Regions: sets of voxels that the same frames influence, split where their weights are least linear (the paper, §5.3).

Weights inside a region are compared with their least-squares fit w_i ≈ a_i + b_i · p; its squared residuals follow from
the moments Σ x xᵀ, Σ x wᵀ, Σ w wᵀ with x = (1, p). The region with the largest sum of them is cut in two through its
centroid, across its longest principal axis, until there are as many regions as samples. Where there are more sets of
frames than samples, the smallest region joins the one that gains the fewest frames by it.
"""

from __future__ import annotations

from dataclasses import dataclass
from heapq import heapify, heappop, heappush

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mjframes.errors import MjframesError
from mjframes.grid import Grid
from mjframes.weights import frame_count, weights_at

LINEAR_FIT = 1e-6  # [-] rms residual of weights that need no further cut: rounding leaves about 1e-8
FLAT = 1e-9  # [-] relative second moment below which a region has no extent in a direction


@dataclass(frozen=True, eq=False)
class Regions:
    """r regions. label: (n,) int32, the region of each voxel.  frames: the frames of each, ascending.
    fit_error: (r,) rms over its voxels of the norm of the weights' residuals from their linear fit.
    """

    label: NDArray[np.int32]
    frames: tuple[tuple[int, ...], ...]
    fit_error: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class _Part:
    """A region under construction: its voxels, their centres relative to the mean [m], weights, and the fit."""

    voxels: NDArray[np.int64]
    offset: NDArray[np.float64]
    weights: NDArray[np.float64]
    residual: float
    axis: NDArray[np.float64]

    @property
    def fit_error(self) -> float:
        return float(np.sqrt(self.residual / len(self.voxels)))


def split_regions(grid: Grid, weights: sparse.csr_array, samples: int) -> Regions:
    """At most `samples` regions; fewer if the weights (n, f) are linear in all of them before that number is reached.

    Raises MjframesError for samples < 1.
    """
    if not isinstance(samples, (int, np.integer)) or samples < 1:
        raise MjframesError(f"samples is {samples!r}; it must be an integer ≥ 1, the number of regions.")
    label, sets = _same_frames(weights)
    if len(sets) > samples:
        label, sets = _merge(grid, label, sets, samples)
    frames = [tuple(np.flatnonzero(row).tolist()) for row in sets]
    order = np.argsort(label, kind="stable")
    voxels = np.split(order, np.searchsorted(label[order], np.arange(1, len(sets))))
    parts = [_part(grid.centers[v], v, weights_at(weights, v, f)) for v, f in zip(voxels, frames, strict=True)]
    worst_first = [(-part.residual, e) for e, part in enumerate(parts) if part.fit_error > LINEAR_FIT]
    heapify(worst_first)
    while len(parts) < samples and worst_first:
        e = heappop(worst_first)[1]
        part, far = parts[e], parts[e].offset @ parts[e].axis > 0
        halves = [_part(grid.centers[part.voxels[s]], part.voxels[s], part.weights[s]) for s in (~far, far)]
        parts[e] = halves[0]
        parts.append(halves[1])
        frames.append(frames[e])
        for number, half in zip((e, len(parts) - 1), halves, strict=True):
            if half.fit_error > LINEAR_FIT:
                heappush(worst_first, (-half.residual, number))
    label = np.empty(len(grid.index), np.int32)
    for e, part in enumerate(parts):
        label[part.voxels] = e
    return Regions(label, tuple(frames), np.array([p.fit_error for p in parts]))


def _same_frames(weights: sparse.csr_array) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
    """The number (n,) of each voxel's set of frames, in order of appearance, and the sets (r, f)."""
    number = np.zeros(len(weights.indptr) - 1, np.int64)
    for start in range(0, frame_count(weights), 64):  # exact for any number of frames: 64 of them a word
        bit = weights.indices - start
        word = np.where((bit >= 0) & (bit < 64), np.uint64(1) << (bit.astype(np.uint64) & np.uint64(63)), np.uint64(0))
        _, value = np.unique(np.bitwise_or.reduceat(word, weights.indptr[:-1]), return_inverse=True)
        _, number = np.unique(number * (value.max() + 1) + value, return_inverse=True)
    first = np.unique(number, return_index=True)[1]
    rank = np.empty(len(first), np.int32)
    rank[np.argsort(first)] = np.arange(len(first))
    return rank[number], weights[np.sort(first)].toarray() > 0


def _merge(
    grid: Grid, label: NDArray[np.int32], sets: NDArray[np.bool_], samples: int
) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
    """Fewer sets: the smallest joins the one that gains the fewest frames, of those the nearest."""
    sets = sets.copy()
    size = np.bincount(label).astype(float)
    center = np.stack([np.bincount(label, weights=grid.centers[:, a]) for a in range(3)], axis=1) / size[:, None]
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


def _part(centers: NDArray[np.float64], voxels: NDArray[np.int64], weights: NDArray[np.float64]) -> _Part:
    """The linear fit of weights (v, i) at centers (v, 3), and the longest principal axis."""
    offset = centers - centers.mean(axis=0)
    spread = weights - weights.mean(axis=0)
    extent, axes = np.linalg.eigh(offset.T @ offset)
    across = extent > FLAT * extent[-1]
    slope = axes[:, across].T @ (offset.T @ spread) / np.sqrt(extent[across])[:, None]
    residual = float(max(0.0, np.sum(spread**2) - np.sum(slope**2)))
    longest = axes[:, -1] * np.sign(axes[np.argmax(np.abs(axes[:, -1])), -1])
    return _Part(voxels, offset, weights, residual, longest)
