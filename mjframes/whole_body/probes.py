"""How much farther the flesh gives way below pushes than the frames say: what its dents have to make up for.

With u = A⁻¹ f what the finite elements do and û = Wᵀ-coordinates of the frames under the same push f of 1 N,

    c = f · (u − û − r),   r the rigid motion that u − û has from FAR to RING radii away

An error that is there, too, is none of the dent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mjframes.base.rigid import motion_basis
from mjframes.volume.grid import Grid
from mjframes.whole_body.pushes import FAR, FreeSurface, Pushed, balanced, pushes

# how many cover which share of the surface [-], as fingertips and palms do; in all as many as the solver takes at once
PROBES = ((10, 0.015), (6, 0.08))
RING = 2.5  # [-] radii of a push, from its middle


@dataclass(frozen=True, eq=False)
class Probes:
    """Pushes of 1 N.

    force: (n, 3, p) float32 on the voxels, in volume coordinates; balanced where nothing is held.
    pushed: of each, the voxels that it is spread over.
    around: of each, the voxels of the ring around it.
    moved: of each, (q, 3) how far finite elements move the pushed voxels, and then those around [m].
    """

    force: NDArray[np.float32]
    pushed: Pushed
    around: Pushed
    moved: Sequence[NDArray[np.float32]]


@dataclass(frozen=True, eq=False)
class Answers:
    """How finite elements answer the probes, and frames.

    pushed: the voxels of each probe.
    whole: (p,) how far finite elements give way where it pushes, f · u [m/N].
    missing: (p,) how much farther that is than what the frames do [m/N].
    """

    pushed: Pushed
    whole: NDArray[np.float64]
    missing: NDArray[np.float64]


def probes(
    grid: Grid, cores: Sequence[NDArray[np.integer]], surface: FreeSurface
) -> tuple[NDArray[np.float32], Pushed]:
    """Return pushes on small and on wide places, as forces (n, 3, p) [N] and the voxels of each.  cores: held ones."""
    forces, pushed = zip(*(pushes(grid, surface, share, count) for count, share in PROBES), strict=True)
    force = np.concatenate(forces, axis=2)
    return force if cores else balanced(grid, force), sum(pushed, ())


def probed(grid: Grid, force: NDArray[np.float32], pushed: Pushed, moved: NDArray[np.floating]) -> Probes:
    """Return the probes that move the voxels so (n, 3, p)."""
    around = []
    for voxels in pushed:
        away = np.linalg.norm(grid.centers - grid.centers[voxels].mean(axis=0), axis=1)
        radius = away[voxels].max() + grid.spacing.min() / 2
        around.append(np.flatnonzero((away > FAR * radius) & (away < RING * radius)))
    near = [np.concatenate(some) for some in zip(pushed, around, strict=True)]
    return Probes(force, pushed, tuple(around), [moved[some, :, p] for p, some in enumerate(near)])


def answers(grid: Grid, probes: Probes, functions: sparse.csr_array, covariance: NDArray[np.float64]) -> Answers:
    """Return those of frames that move the voxels by `functions` (n, k), with the compliance K⁺ (3k, 3k)."""
    n, _, count = probes.force.shape
    x = covariance @ (functions.T @ probes.force.reshape(n, -1)).reshape(-1, count)
    x = x.reshape(-1, 3 * count)
    whole, missing = np.zeros(count), np.zeros(count)
    for p, (pushed, around) in enumerate(zip(probes.pushed, probes.around, strict=True)):
        near = np.concatenate([pushed, around])
        difference = probes.moved[p] - (functions[near] @ x).reshape(len(near), 3, count)[:, :, p]
        motion = motion_basis(grid.centers[near] - grid.centers[pushed].mean(axis=0)).reshape(len(near), 3, -1)
        there = slice(len(pushed), None)
        rigid = np.linalg.lstsq(motion[there].reshape(-1, motion.shape[2]), difference[there].ravel(), rcond=1e-6)[0]
        force = probes.force[pushed, :, p].astype(np.float64)
        whole[p] = np.sum(force * probes.moved[p][: len(pushed)])
        missing[p] = np.sum(force * (difference - motion @ rigid)[: len(pushed)])
    return Answers(probes.pushed, whole, missing)
