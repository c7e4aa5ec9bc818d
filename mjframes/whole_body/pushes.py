"""Pushes of 1 N on a body, each spread evenly over a part of its surface: each where it is farthest from those before.

Index letters: n voxels; s of them on the surface; c push.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from mjframes.base.rigid import motion_basis
from mjframes.volume.grid import Grid

Array = NDArray[np.float64]
Pushed = tuple[NDArray[np.int64], ...]  # voxels of each push

FACING = 0.3  # [-] least cosine between the normals where it pushes: not on both sides of a plate
FAR = 1.5  # [-] radii of a push, from its middle, within which its dent is
SMOOTH = 1.5  # [voxels] over which normals are taken


@dataclass(frozen=True, eq=False)
class FreeSurface:
    """The voxels on the surface that are not held.

    voxels: (s,).  place: (s, 3) volume coordinates [m].  normals: (s, 3), outward.
    """

    voxels: NDArray[np.integer]
    place: Array
    normals: Array


def free_surface(grid: Grid, cores: Sequence[NDArray[np.integer]]) -> FreeSurface:
    """Return the surface of a body of which the voxels `cores` are held."""
    held = np.zeros(len(grid.index), bool)
    held[np.concatenate([*cores, np.empty(0, np.int64)])] = True
    voxels = grid.outermost[~held[grid.outermost]]
    return FreeSurface(voxels, grid.points(voxels), _normals(grid, voxels))


def pushes(grid: Grid, surface: FreeSurface, share: float, count: int) -> tuple[NDArray[np.float32], Pushed]:
    """Return forces (n, 3, count) [N] on the voxels, and the voxels of each push.

    share: of the surface that each covers [-].
    """
    force, chosen = np.zeros((len(grid.index), 3, count), np.float32), []
    place, normals = surface.place, surface.normals
    voxels = max(1, round(share * len(place)))
    center, distance = int(np.argmax(np.linalg.norm(place - place.mean(axis=0), axis=1))), np.full(len(place), np.inf)
    for c in range(count):
        away = np.linalg.norm(place - place[center], axis=1)
        order = np.argsort(np.where(normals @ normals[center] > FACING, away, np.inf), kind="stable")[:voxels]
        pushed = order[normals[order] @ normals[center] > FACING]
        direction = normals[pushed].mean(axis=0)
        force[surface.voxels[pushed], :, c] = -direction / np.linalg.norm(direction) / len(pushed)
        chosen.append(surface.voxels[pushed])
        distance = np.minimum(distance, away)
        center = int(np.argmax(distance))
    return force, tuple(chosen)


def balanced(grid: Grid, force: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the forces (n, 3, c) with those of the inertia of a body that nothing holds."""
    motion = motion_basis(grid.centers)
    inertia = np.repeat(grid.density * grid.cell_volume, 3)[:, None] * motion
    flat = force.reshape(len(inertia), -1)
    carried = np.linalg.lstsq(motion.T @ inertia, motion.T @ flat, rcond=None)[0]
    return (flat - inertia @ carried).reshape(force.shape).astype(np.float32)


def _normals(grid: Grid, voxels: NDArray[np.integer]) -> Array:
    """(s, 3) outward, where the inside thins out; in volume coordinates."""
    inside = np.pad((grid.lookup >= 0).astype(np.float32), 1)
    smooth = np.asarray(ndimage.gaussian_filter(inside, SMOOTH, mode="constant"))
    at = grid.index[voxels] + 1
    sides = [(smooth[tuple((at + step).T)], smooth[tuple((at - step).T)]) for step in np.eye(3, dtype=int)]
    slope = np.stack([beyond - before for beyond, before in sides], axis=1) / grid.spacing
    thin = np.linalg.norm(slope * grid.spacing, axis=1) < 1e-3
    slope[thin] = -np.eye(3)[np.argmin(grid.lookup.shape)]  # a sheet of one voxel: push on its face
    return -(slope / np.linalg.norm(slope, axis=1, keepdims=True)) @ grid.axes.T
