"""Vertices that cover a surface, by farthest-point sampling: what touches (the paper, §5.4)."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from mjframes.base.errors import MjframesError
from mjframes.base.sampling import farthest_points
from mjframes.base.trimeshes import trimesh
from mjframes.surface.isosurface import Surface


@dataclass(frozen=True, eq=False)
class ContactPoints:
    """Vertices of the surface.

    positions: (s, 3) volume coordinates [m].
    normals: (s, 3) mean of those of the triangles around each, by area, outward: shorter than 1 at edges and tips.
    rank: (s,) int, 0 for the most important: for every n the points of rank below n cover the surface evenly.
    """

    positions: np.ndarray
    normals: np.ndarray
    rank: np.ndarray

    def sorted(self, order: np.ndarray) -> ContactPoints:
        """Return the same in another order (s,)."""
        return ContactPoints(self.positions[order], self.normals[order], self.rank[order])


def contact_points(surface: Surface, count: int = 600) -> ContactPoints:
    """Return at most `count` vertices of the surface: extreme ones first, then farthest points.

    Raise MjframesError if count < 1.
    """
    if count < 1:
        raise MjframesError(f"count is {count!r}; contact needs one point or more.")
    mesh = surface.mesh
    normals = _mean_normals(mesh)
    # Distances see the normals too: the two sides of a thin plate are then far apart, and sharp edges get more points.
    reach = np.sqrt(mesh.area / count)
    unit = mesh.vertex_normals
    chosen = farthest_points(np.hstack([surface.vertices, reach * unit]), _extremes(surface.vertices), count)
    return ContactPoints(surface.vertices[chosen], normals[chosen], np.arange(len(chosen)))


def _mean_normals(mesh: trimesh.Trimesh) -> np.ndarray:
    """(s, 3) of the triangles around each vertex, by area."""
    area = np.repeat(mesh.area_faces, 3)
    sums = np.zeros((len(mesh.vertices), 4))
    values = np.column_stack([np.repeat(mesh.face_normals, 3, axis=0), np.ones(len(area))])
    np.add.at(sums, mesh.faces.ravel(), area[:, None] * values)
    return sums[:, :3] / np.maximum(sums[:, 3:], np.finfo(float).tiny)


def _extremes(x: np.ndarray) -> np.ndarray:
    """Vertices farthest along the 26 axes and diagonals, farthest from the middle first: corners and tips."""
    directions = np.array([d for d in itertools.product((-1, 0, 1), repeat=3) if any(d)], dtype=np.float64)
    size = np.ptp(x, axis=0)
    unit = (x - x.mean(axis=0)) / np.where(size > 0, size, 1)
    found = np.unique((unit @ directions.T).argmax(axis=0))
    return found[np.argsort(-np.linalg.norm(x[found] - x.mean(axis=0), axis=1), kind="stable")]
