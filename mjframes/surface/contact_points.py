"""Centres of spheres that touch a surface from inside, by farthest-point sampling: what touches (the paper, §5.4)."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from mjframes.base.errors import MjframesError
from mjframes.base.sampling import farthest_points
from mjframes.surface.isosurface import Surface
from mjframes.volume.volume import Volume


@dataclass(frozen=True, eq=False)
class ContactPoints:
    """Centres of the contact spheres.

    positions: (s, 3) volume coordinates [m].
    radius: [m].
    normals: (s, 3) of the surface above each, outward.
    rank: (s,) int, 0 for the most important: for every n the points of rank below n cover the surface evenly.
    """

    positions: np.ndarray
    radius: float
    normals: np.ndarray
    rank: np.ndarray

    def sorted(self, order: np.ndarray) -> ContactPoints:
        """Return the same in another order (s,)."""
        return ContactPoints(self.positions[order], self.radius, self.normals[order], self.rank[order])


def contact_points(surface: Surface, volume: Volume, radius: float | None = None, count: int = 600) -> ContactPoints:
    """Return at most `count` spheres that touch the surface from inside: extreme vertices first, then farthest points.

    radius: [m], half the smallest spacing unless given.
    Raise MjframesError if radius ≤ 0 or count < 1.
    """
    radius = float(np.min(volume.spacing)) / 2 if radius is None else float(radius)
    if not (np.isfinite(radius) and radius > 0):
        raise MjframesError(f"radius is {radius!r}; contact spheres need a positive radius in metres.")
    if count < 1:
        raise MjframesError(f"count is {count!r}; contact needs one point or more.")
    mesh = surface.mesh
    normals = mesh.vertex_normals
    # Distances see the normals too: the two sides of a thin plate are then far apart, and sharp edges get more points.
    reach = np.sqrt(mesh.area / count)
    chosen = farthest_points(np.hstack([surface.vertices, reach * normals]), _extremes(surface.vertices), count)
    positions = surface.vertices[chosen] - radius * normals[chosen]
    return ContactPoints(positions, radius, normals[chosen], np.arange(len(chosen)))


def _extremes(x: np.ndarray) -> np.ndarray:
    """Vertices farthest along the 26 axes and diagonals, farthest from the middle first: corners and tips."""
    directions = np.array([d for d in itertools.product((-1, 0, 1), repeat=3) if any(d)], dtype=np.float64)
    size = np.ptp(x, axis=0)
    unit = (x - x.mean(axis=0)) / np.where(size > 0, size, 1)
    found = np.unique((unit @ directions.T).argmax(axis=0))
    return found[np.argsort(-np.linalg.norm(x[found] - x.mean(axis=0), axis=1), kind="stable")]
