"""A surface net drawn to the outline that its voxels were sampled from (`volume.outline`).

Each vertex moves to the least of Σ_t (N_t · (x − P_t))² over the triangles t around it, P_t the place of the outline
that is nearest to their middle and N_t its normal there, and then to the place of the outline nearest to x. Where the
N_t are alike that is along them; at an edge or a corner it is in the planes of all sides. After T. Ju et al., Dual
contouring of Hermite data, SIGGRAPH 2002.

Of several sheets of the outline that are near, the outermost counts, as what is in any of them is inside. What is
thinner than a voxel becomes as thick as one. A vertex stays where no sheet is near, as where a hole of a mesh was
closed, or where voxels were changed since.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from mjframes.surface.closest import closest_weights, samples
from mjframes.volume.outline import Outline

Array = NDArray[np.float64]

REACH = 0.8  # [voxels] along each axis that a vertex moves at most, as in `net.py` and a little of what that missed
FACING = 0.25  # [-] cosine between the net's normal and the outline's: the other side of something thin is opposite
PARALLEL = 0.7  # [-] cosine of two sides between which something is thin; those of a wedge are not
ALIKE = 0.1  # [-] eigenvalue of Σ N Nᵀ, to the largest, below which sides count as one: they differ by 35 degrees
SIDEWAYS = 0.1  # [voxels] that a vertex moves across its normal at most, and as far as along it: it is at a hole else
NEAREST = 8  # samples of the outline whose triangles are tried
TURNED = -0.1  # [-] cosine of a triangle's turn beyond which it goes back: at an edge one turns by a right angle
RETURNS = 5  # rounds of these: a vertex that went back may turn others


@dataclass(frozen=True, eq=False)
class _Sheet:
    """A closed part of an outline, with samples half a voxel apart."""

    corners: Array  # (m, 3, 3) [m]
    normals: Array  # (m, 3)
    owner: NDArray[np.int64]
    tree: KDTree

    def nearest(self, points: Array, outward: Array, reach: float) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Its places nearest to points (n, 3), their normals (n, 3), and where (n,) there is one that faces outward."""
        distance, near = self.tree.query(points, k=NEAREST, distance_upper_bound=reach)
        place, normal, best = points.copy(), np.zeros_like(points), np.full(len(points), np.inf)
        for hit, sample in zip(np.isfinite(distance).T, near.T, strict=True):
            rows = np.flatnonzero(hit)
            triangle = self.owner[sample[rows]]
            facing = np.einsum("nc,nc->n", self.normals[triangle], outward[rows]) > FACING
            rows, triangle = rows[facing], triangle[facing]
            a, b, c = self.corners[triangle].transpose(1, 0, 2)
            at = np.einsum("nc,nci->ni", closest_weights(points[rows], a, b, c), self.corners[triangle])
            away = np.linalg.norm(at - points[rows], axis=1)
            nearer = away < best[rows]
            rows = rows[nearer]
            place[rows], normal[rows], best[rows] = at[nearer], self.normals[triangle[nearer]], away[nearer]
        return place, normal, np.isfinite(best)


@dataclass(frozen=True, eq=False)
class DrawnTo:
    """What draws surfaces to an outline.

    sheets: of the outline.
    spacing: (3,) of the voxels, along the index axes [m].
    """

    sheets: tuple[_Sheet, ...]
    spacing: Array

    def nearest(self, points: Array, outward: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Return the places of the outline (n, 3) near points (n, 3), its normals there, and where (n,) there are any.

        outward: (n, 3) unit normals of the surface at the points.
        """
        reach = float(np.linalg.norm(REACH * self.spacing))
        place, normal, height = points.copy(), np.zeros_like(points), np.full(len(points), -np.inf)
        for sheet in self.sheets:
            low, high = sheet.corners.min(axis=(0, 1)) - reach, sheet.corners.max(axis=(0, 1)) + reach
            rows = np.flatnonzero(((points >= low) & (points <= high)).all(axis=1))
            at, facing, found = sheet.nearest(points[rows], outward[rows], reach)
            above = np.einsum("nc,nc->n", at - points[rows], outward[rows])
            outer = found & (above > height[rows])
            rows = rows[outer]
            place[rows], normal[rows], height[rows] = at[outer], facing[outer], above[outer]
        return place, normal, np.isfinite(height)

    def net(self, vertices: Array, faces: NDArray[np.integer]) -> Array:
        """Return the vertices (s, 3) of a net [m] drawn to the outline, along the index axes."""
        place, normal, found = self.nearest(vertices[faces].mean(axis=1), face_normals(vertices, faces))
        step = _least(vertices, faces[found], place[found], normal[found])
        return self.vertices(self._near(vertices, vertices + step), faces, vertices)

    def vertices(self, x: Array, faces: NDArray[np.integer], start: Array | None = None) -> Array:
        """Return vertices x (s, 3) [m] at the nearest places of the outline.  start: (s, 3) where to go back to."""
        start = x if start is None else start
        place, normal, found = self.nearest(x, outward := vertex_normals(x, faces))
        way = place - x
        along = np.einsum("nc,nc->n", way, outward)
        across = np.linalg.norm(way - along[:, None] * outward, axis=1)
        found &= across <= np.maximum(np.abs(along), SIDEWAYS * float(self.spacing.min()))
        place += 0.5 * self._missing(place, normal)[:, None] * normal
        x = self._near(start, np.where(found[:, None], place, x))
        right = face_normals(start, faces), _unit(normal[faces].sum(axis=1))
        for _ in range(RETURNS):
            now = face_normals(x, faces)
            turned = np.all([np.einsum("tc,tc->t", now, some) < TURNED for some in right], axis=0)
            if not turned.any():
                break
            x[faces[turned].ravel()] = start[faces[turned].ravel()]
        return x

    def _missing(self, place: Array, normal: Array) -> Array:
        """How much less than a voxel (n,) the outline is thick below its places [m]: contacts need as much."""
        voxel = float(self.spacing.min())
        opposite, facing, found = self.nearest(place - voxel * normal, -normal)  # from beyond it: no sample is nearer
        found &= np.einsum("nc,nc->n", facing, normal) < -PARALLEL
        thick = np.einsum("nc,nc->n", place - opposite, normal)
        return np.where(found & (thick >= 0), np.maximum(voxel - thick, 0), 0)

    def _near(self, start: Array, x: Array) -> Array:
        return np.clip(x, start - REACH * self.spacing, start + REACH * self.spacing)


def drawn_to(outline: Outline, origin: Array, axes: Array, spacing: Array) -> DrawnTo:
    """Return what draws surfaces to an outline, with coordinates along index axes (3, 3) from `origin` (3,) [m] on."""
    x = (outline.vertices.astype(np.float64) - origin) @ axes
    step = float(spacing.min()) / 2
    sheets = []
    for part in np.unique(outline.part):
        corners = x[outline.faces[outline.part == part]]
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        size = np.linalg.norm(cross, axis=1)
        corners, normals = corners[size > 0], cross[size > 0] / size[size > 0, None]
        points, owner = samples(corners[:, 0], corners[:, 1], corners[:, 2], step)
        sheets.append(_Sheet(corners, normals, owner, KDTree(points, balanced_tree=False)))
    return DrawnTo(tuple(sheets), spacing)


def face_normals(x: Array, faces: NDArray[np.integer]) -> Array:
    """Return unit normals (t, 3), 0 for triangles without area."""
    a, b, c = x[faces].transpose(1, 0, 2)
    return _unit(np.cross(b - a, c - a))


def vertex_normals(x: Array, faces: NDArray[np.integer]) -> Array:
    """Return unit normals (s, 3), means of the triangles' by their areas."""
    a, b, c = x[faces].transpose(1, 0, 2)
    cross = np.cross(b - a, c - a)
    total = [np.bincount(faces.ravel(), np.repeat(cross[:, i], 3), len(x)) for i in range(3)]
    return _unit(np.stack(total, axis=1).astype(np.float64))


def _unit(vectors: Array) -> Array:
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors / np.where(length > 0, length, 1)


def _least(x: Array, faces: NDArray[np.integer], place: Array, normal: Array) -> Array:
    """The steps (s, 3) to the planes of the triangles around each vertex, the shortest that comes nearest to them."""
    vertex, row = faces.ravel(), np.repeat(np.arange(len(faces)), 3)
    n = normal[row]
    height = np.einsum("nc,nc->n", n, place[row] - x[vertex])
    outer = np.einsum("na,nb->nab", n, n).reshape(-1, 9)
    A = np.stack([np.bincount(vertex, outer[:, i], len(x)) for i in range(9)], axis=1).reshape(-1, 3, 3)
    b = np.stack([np.bincount(vertex, height * n[:, i], len(x)) for i in range(3)], axis=1)
    value, basis = np.linalg.eigh(A)
    kept = value > ALIKE * np.maximum(value[:, 2:], 1e-300)
    along = np.einsum("sab,sa->sb", basis, b) * np.where(kept, 1 / np.where(kept, value, 1), 0)
    return np.einsum("sab,sb->sa", basis, along)
