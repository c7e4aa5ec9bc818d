"""How wide and how soft the dents are that a contact makes beyond what the frames show (plugin/dents.h).

The flesh below a small pressure gives way as an elastic half-space does, with β² = (1 − ν²) / (πE). What of that is
smooth over the width ℓ the frames show already: so many frames f of a volume V show what is wider than WIDTH (V/f)^⅓.
Where finite elements have been pushed, ℓ is such that the dents of that push, with r the distances of its voxels,

    c = mean over pairs of β_i β_j [G(s) − 2 G(s + ℓ²) + G(s + 2 ℓ²)],   G(q) = erf(r / √(2q)) / r

are what is missing below it, and elsewhere the mean of these, nearer pushes counting more.
Index letters: s place of the surface; p push; v voxel of a push.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist
from scipy.special import erf

from mjframes.volume.grid import Grid

Array = NDArray[np.float64]

WIDTH = 0.29  # [-] of a frame's size: fitted to finite elements, 0.28 to 0.30 from 1 to 20 frames
NARROWEST, WIDEST = 0.5, 2.0  # [-] of that width: beyond, it is not a dent that is missing
SEEN = 0.75  # [-] of ℓ that probes find: voxels' centres are below the surface. Fitted to a block, with 1 to 5 frames
PRESSURE = 0.405  # [-] of a pressure's variance, as in plugin/constants.h
MOST = 400  # voxels of a push that are looked at
HALVINGS = 20


@dataclass(frozen=True, eq=False)
class Dents:
    """Of the flesh below each place of the surface.

    width: (s,) ℓ [m].  softness: (s,) β [1/√Pa].  thickness: (s,) of the body, along the normal [m].
    material: (s,) the place of its material in the grid's table.
    """

    width: Array
    softness: Array
    thickness: Array
    material: NDArray[np.int32]


def dents(
    grid: Grid,
    positions: Array,
    normals: Array,
    frames: int,
    pushed: Sequence[NDArray[np.integer]] = (),
    missing: Array | None = None,
) -> Dents:
    """Return the dents at places (s, 3) of the surface with these outward normals (s, 3).

    frames: how many the body has.  pushed, missing: of the whole body, see `Condensed`; none for the rule alone.
    """
    softness = _softness(grid)
    usual = WIDTH * (grid.cell_volume * len(grid.centers) / frames) ** (1 / 3)
    width = np.full(len(positions), usual)
    if missing is not None:
        fitted = np.array([_fitted(grid, softness, usual, v, some) for v, some in zip(pushed, missing, strict=True)])
        middle = np.array([grid.centers[v].mean(axis=0) for v in pushed])
        near = 1 / (cdist(positions, middle) + grid.spacing.min()) ** 2
        width = near @ fitted / near.sum(axis=1)
    voxel = KDTree(grid.centers).query(positions)[1]
    return Dents(width, softness[voxel], _thickness(grid, positions, normals), grid.material[voxel].astype(np.int32))


def _thickness(grid: Grid, positions: Array, normals: Array) -> Array:
    """(s,) how far it is through the voxels, by steps of half of one; one at least."""
    step, most = grid.spacing.min() / 2, float(np.linalg.norm(grid.spacing * grid.lookup.shape))
    inside, length = np.ones(len(positions), bool), np.zeros(len(positions))
    while inside.any() and length.max() < most:
        length[inside] += step
        place = (positions - length[:, None] * normals - grid.origin) @ grid.axes / grid.spacing
        index = np.floor(place).astype(np.int64)
        near = index.clip(0, np.array(grid.lookup.shape) - 1)
        inside &= (near == index).all(axis=1) & (grid.lookup[tuple(near.T)] >= 0)
    return np.maximum(length, grid.spacing.min())


def _softness(grid: Grid) -> Array:
    """(n,) β of each voxel."""
    poisson = np.array([material.poisson for material in grid.table])[grid.material]
    return np.sqrt((1 - poisson**2) / (np.pi * grid.young))


def _fitted(grid: Grid, softness: Array, usual: float, voxels: NDArray[np.integer], missing: float) -> float:
    """ℓ that answers an even push on these voxels as far."""
    some = voxels[:: -(-len(voxels) // MOST)]
    r, share = pairs(grid, some, softness[some] / len(some))
    own = 2 * PRESSURE * len(voxels) / len(some) * grid.cell_volume ** (2 / 3) / 12
    low, high = SEEN * NARROWEST * usual, SEEN * WIDEST * usual
    deepest = share @ _spread(r, own)
    for _ in range(HALVINGS):
        width = np.sqrt(low * high)
        found = deepest + share @ (_spread(r, own + 2 * width**2) - 2 * _spread(r, own + width**2))
        low, high = (width, high) if found < missing else (low, width)
    return float(np.sqrt(low * high) / SEEN)


def pairs(grid: Grid, voxels: NDArray[np.integer], beta: Array) -> tuple[Array, Array]:
    """Return the distances r between voxels, each of them once, and Σ β_i β_j over the pairs that are so far apart."""
    steps = np.abs(grid.index[voxels, None] - grid.index[voxels])
    steps = np.ravel_multi_index(tuple(np.moveaxis(steps, 2, 0)), grid.lookup.shape)
    share = np.asarray(np.bincount(steps.ravel(), np.outer(beta, beta).ravel()), float)
    used = np.flatnonzero(share)
    apart = np.stack(np.unravel_index(used, grid.lookup.shape), axis=1)
    return np.linalg.norm(apart * grid.spacing, axis=1), share[used]


def _spread(r: Array, q: float) -> Array:
    """G."""
    x = r / np.sqrt(2 * q)
    return np.where(x > 0, erf(x) / np.where(x > 0, r, 1), np.sqrt(2 / (np.pi * q)))
