"""How wide and how soft the dents are that a contact makes beyond what the frames show (plugin/dents.h).

The flesh below a small pressure gives way as an elastic half-space does, with β² = (1 − ν²) / (πE). What of that is
smooth over the width ℓ the frames show already: so many frames f of a volume V show what is wider than WIDTH (V/f)^⅓.
Where finite elements have been pushed, the dents of a push, with r the distances of its voxels,

    c(ℓ) = mean over pairs of β_i β_j [G(s) − 2 G(s + ℓ²) + G(s + 2 ℓ²)],   G(q) = erf(r / √(2q)) / r

are to be what is missing below it, c_p. Of all c_p, of small pushes and wide ones, one ℓ a place does best:

    minimize Σ_p ((c(ℓ) − c_p) / c_whole)² / d²

c_whole being how far finite elements give way there, d how far the push is from the place.
Index letters: s place of the surface; p push; v voxel of a push; g one of some ℓ.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist
from scipy.special import erf

from mjframes.volume.grid import Grid
from mjframes.whole_body.probes import Answers

Array = NDArray[np.float64]

WIDTH = 0.29  # [-] of a frame's size: fitted to finite elements, 0.28 to 0.30 from 1 to 20 frames
NARROWEST, WIDEST = 0.25, 2.0  # [-] of that width: beyond, it is not a dent that is missing
SEEN = 0.82  # [-] of ℓ that probes find, whose voxels are below the surface: fitted to a ball and a pad, 1 to 20 frames
BONE = 30.0  # [-] times as stiff as the surface: what is below does not give way beside it
ABOVE = 1.5  # [voxels] along the normal that a place of the surface is above the first voxel at most
PRESSURE = 0.405  # [-] of a pressure's variance, as in plugin/constants.h
MOST = 400  # voxels of a push that are looked at
STEPS = 49  # ℓ that are tried: 4 % apart


@dataclass(frozen=True, eq=False)
class Dents:
    """Of the flesh below each place of the surface.

    width: (s,) ℓ [m].  softness: (s,) β [1/√Pa].
    thickness: (s,) of the flesh along the normal, to the other side or to bone [m].
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
    answers: Answers | None = None,
) -> Dents:
    """Return the dents at places (s, 3) of the surface with these outward normals (s, 3).

    frames: how many the body has.  answers: to pushes, None for the rule alone.
    """
    softness = _softness(grid)
    usual = WIDTH * (grid.cell_volume * len(grid.centers) / frames) ** (1 / 3)
    width = np.full(len(positions), usual)
    if answers is not None:
        tried = usual * np.geomspace(NARROWEST, WIDEST, STEPS)
        found = np.array([_given(grid, softness, tried, voxels) for voxels in answers.pushed])
        whole = np.where(answers.whole > 0, answers.whole, np.inf)  # a single voxel does not give way
        wrong = ((found - answers.missing[:, None]) / whole[:, None]) ** 2
        middle = np.array([grid.centers[v].mean(axis=0) for v in answers.pushed])
        near = 1 / (cdist(positions, middle) + grid.spacing.min()) ** 2
        width = tried[np.argmin(near @ wrong, axis=1)]
    voxel = np.asarray(KDTree(grid.centers).query(positions)[1])
    thickness = _thickness(grid, positions, normals, voxel)
    return Dents(width, softness[voxel], thickness, grid.material[voxel].astype(np.int32))


def _thickness(grid: Grid, positions: Array, normals: Array, surface: NDArray[np.integer]) -> Array:
    """(s,) how far it is through the voxels to the other side or to bone, by steps of half of one; one at least.

    surface: (s,) the voxel at each place. The place may be above all voxels, as a smooth surface is.
    """
    voxel = float(grid.spacing.min())
    step, most = voxel / 2, float(np.linalg.norm(grid.spacing * grid.lookup.shape))
    goes_on, entered = np.ones(len(positions), bool), np.zeros(len(positions), bool)
    length = np.zeros(len(positions))
    while goes_on.any() and length.max() < most:
        length[goes_on] += step
        place = (positions - length[:, None] * normals - grid.origin) @ grid.axes / grid.spacing
        index = np.floor(place).astype(np.int64)
        near = index.clip(0, np.array(grid.lookup.shape) - 1)
        found = grid.lookup[tuple(near.T)]
        is_flesh = (near == index).all(axis=1) & (found >= 0) & (grid.young[found] < BONE * grid.young[surface])
        entered |= is_flesh
        goes_on &= is_flesh | (~entered & (length < ABOVE * voxel))
    return np.where(entered, np.maximum(length, voxel), voxel)


def _softness(grid: Grid) -> Array:
    """(n,) β of each voxel."""
    poisson = np.array([material.poisson for material in grid.table])[grid.material]
    return np.sqrt((1 - poisson**2) / (np.pi * grid.young))


def _given(grid: Grid, softness: Array, widths: Array, voxels: NDArray[np.integer]) -> Array:
    """(g,) how far dents of these widths give way to an even push of 1 N on these voxels [m/N]."""
    some = voxels[:: -(-len(voxels) // MOST)]
    r, share = pairs(grid, some, softness[some] / len(some))
    own = 2 * PRESSURE * len(voxels) / len(some) * grid.cell_volume ** (2 / 3) / 12
    squares = (SEEN * widths) ** 2
    smooth = [share @ (_spread(r, own + 2 * square) - 2 * _spread(r, own + square)) for square in squares]
    return share @ _spread(r, own) + np.array(smooth)


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
