"""Points that cover a surface, by farthest-point sampling: what touches (the paper, §5.4).

They are vertices of the surface. One at an edge or a corner of flat sides is a point of each side, a little beside the
edge: it has that side's normal, and what lies on one side does not touch with the points of the next.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from mjframes.base.sampling import farthest_points
from mjframes.surface.isosurface import Surface

BESIDE = 0.1  # [voxels] from an edge to the points of its sides: what lies edge on edge stays clear of both
FLAT = 0.999  # [-] cosine of a triangle's normal to an axis: flat sides have it to rounding


@dataclass(frozen=True, eq=False)
class ContactPoints:
    """Points of the surface, the most important first: for every n the first n cover the surface evenly.

    positions: (s, 3) volume coordinates [m].
    normals: (s, 3) of the surface at each, outward.
    """

    positions: np.ndarray
    normals: np.ndarray

    def sorted(self, order: np.ndarray) -> ContactPoints:
        """Return the same in another order (s,)."""
        return ContactPoints(self.positions[order], self.normals[order])


def contact_points(surface: Surface, spacing: float, axes: np.ndarray, count: int = 600) -> ContactPoints:
    """Return points at `count` vertices of the surface at most: extreme ones first, then farthest points.

    spacing: of the voxels, the smallest [m].  axes: (3, 3) of the volume, along which its flat sides are.
    """
    mesh = surface.mesh
    normals = surface.vertex_normals
    # Distances see the normals too: the two sides of a thin plate are then far apart, and sharp edges get more points.
    reach = np.sqrt(mesh.area / count)
    chosen = farthest_points(np.hstack([surface.vertices, reach * normals]), _extremes(surface.vertices), count)
    toward, meets = _sides(surface, axes)
    positions, facing = [], []
    for vertex in chosen:
        sides = np.flatnonzero(meets[vertex])
        if len(sides) < 2:
            positions.append(surface.vertices[vertex])
            facing.append(normals[vertex])
        for side in sides if len(sides) > 1 else ():
            others = np.unique(sides[sides % 3 != side % 3] % 3)
            away = np.sign(toward[vertex, side] @ axes)[others]
            positions.append(surface.vertices[vertex] + BESIDE * spacing * axes[:, others] @ away)
            facing.append((1 if side < 3 else -1) * axes[:, side % 3])
    return ContactPoints(np.array(positions), np.array(facing))


def _sides(surface: Surface, axes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of each vertex and each way that flat sides face, three axes and back: (s, 6, 3) where triangles that face it are
    from there [m], and (s, 6) whether there are any.
    """
    mesh = surface.mesh
    ways = np.hstack([axes, -axes])
    faces = mesh.face_normals @ ways > FLAT
    toward, meets = np.zeros((len(surface.vertices), 6, 3)), np.zeros((len(surface.vertices), 6), bool)
    for way in range(6):
        some = np.flatnonzero(faces[:, way])
        vertex = surface.faces[some].ravel()
        middle = np.repeat(mesh.triangles_center[some], 3, axis=0)
        np.add.at(toward[:, way], vertex, middle - surface.vertices[vertex])
        meets[vertex, way] = True
    return toward, meets


def _extremes(x: np.ndarray) -> np.ndarray:
    """Vertices farthest along the 26 axes and diagonals, farthest from the middle first: corners and tips."""
    directions = np.array([d for d in itertools.product((-1, 0, 1), repeat=3) if any(d)], dtype=np.float64)
    size = np.ptp(x, axis=0)
    unit = (x - x.mean(axis=0)) / np.where(size > 0, size, 1)
    found = np.unique((unit @ directions.T).argmax(axis=0))
    return found[np.argsort(-np.linalg.norm(x[found] - x.mean(axis=0), axis=1), kind="stable")]
