"""What draws a surface net to the outline that its voxels were sampled from (`volume.outline`).

Each vertex moves towards the least of Σ_t (N_t · (x − P_t))² over the triangles t around it, P_t the place of the
outline that is nearest to their middle and N_t its normal there, and then to the place of the outline nearest to x.
Where the N_t are alike that is along them; at an edge or a corner it is in the planes of all sides. After T. Ju et al.,
Dual contouring of Hermite data, SIGGRAPH 2002.

What is behind one sheet of an outline is no surface, even if it is on another: what is in any of them is inside. What
is thinner than a voxel becomes as thick as one. A vertex stays where no sheet is near, as where a hole of a mesh was
closed, or where voxels were changed since.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from mjframes.surface.closest import closest_weights, rows_of_samples
from mjframes.volume.outline import Outline

Array = NDArray[np.float64]
Faces = NDArray[np.integer]

REACH = 0.8  # [voxels] along each axis that a vertex moves at most: the net's own may be 0.75 from a smooth surface
LEAST = 0.5  # [-] of the net that has an outline near, or it is not the outline of these voxels
MOST_SAMPLES = 200  # [-] of an outline's larger triangles, to a net's vertices: five are usual
FACING = 0.25  # [-] cosine between the net's normal and the outline's: the other side of something thin is opposite
FARTHER = 1.5  # [-] than the nearest place of all: what is beyond that belongs to another body, or another side
PARALLEL = 0.7  # [-] cosine of two sides between which something is thin; those of a wedge are not
BEHIND = 1e-3  # [voxels] below another sheet …
INWARD = 0.5  # … [-] cosine of the way there to its normal: beside an edge one triangle does not tell
FIRM, STEPS = 0.1, 4  # [-] of the trace of Σ N Nᵀ, added to it, and steps with that: what sides decide is within 1 %
SIDEWAYS = (
    0.1  # [voxels] across its normal that a vertex moves at most, or as far as along it: beside a hole it would slide
)
NEAREST = 8  # samples of the outline whose triangles are tried
TURNED = -0.1  # [-] cosine between a triangle's normals before and after: at an edge it may turn by a right angle
FOLDED = -0.9  # [-] cosine of a triangle's normal to its neighbour's
SLIVER = 1e-4  # [voxels²] area of a triangle that has none
RETURNS = 6  # times that vertices of such triangles go back by half of their way; the last time they go all of it


@dataclass(frozen=True, eq=False)
class _Sheet:
    """A part of an outline: triangles (m, 3, 3) [m], normals (m, 3), samples half a voxel apart and whose they are."""

    corners: Array
    normals: Array
    owner: NDArray[np.int64]
    tree: KDTree

    def near(self, points: Array, reach: float) -> NDArray[np.int64]:
        """Which points (n, 3) are no farther than `reach` from its box."""
        low, high = self.corners.min(axis=(0, 1)) - reach, self.corners.max(axis=(0, 1)) + reach
        return np.flatnonzero(((points >= low) & (points <= high)).all(axis=1))

    def nearest(self, points: Array, outward: Array, reach: float) -> tuple[Array, Array, Array, Array]:
        """Its places nearest to points (n, 3) that face outward, their normals (n, 3), how far away (n,) they are, and
        how far (n,) the nearest of all is.
        """
        distance, sample = self.tree.query(points, k=NEAREST, distance_upper_bound=reach)
        place, normal = points.copy(), np.zeros_like(points)
        best, least = np.full((2, len(points)), np.inf)
        for hit, some in zip(np.isfinite(distance).T, sample.T, strict=True):
            rows = np.flatnonzero(hit)
            triangle = self.owner[some[rows]]
            at = self._place(points[rows], triangle)
            away = np.linalg.norm(at - points[rows], axis=1)
            least[rows] = np.minimum(least[rows], away)
            facing = np.einsum("nc,nc->n", self.normals[triangle], outward[rows]) > FACING
            nearer = facing & (away < best[rows])
            rows = rows[nearer]
            place[rows], normal[rows], best[rows] = at[nearer], self.normals[triangle[nearer]], away[nearer]
        return place, normal, best, least

    def hides(self, points: Array, reach: float, least: float) -> NDArray[np.bool_]:
        """Whether points (n, 3) are behind it by more than `least` [m]."""
        hidden = np.zeros(len(points), bool)
        rows = self.near(points, reach)
        distance, sample = self.tree.query(points[rows], distance_upper_bound=reach)
        rows, triangle = rows[np.isfinite(distance)], self.owner[sample[np.isfinite(distance)]]
        way = points[rows] - self._place(points[rows], triangle)
        height = np.einsum("nc,nc->n", way, self.normals[triangle])
        hidden[rows] = (height < -least) & (height < -INWARD * np.linalg.norm(way, axis=1))
        return hidden

    def _place(self, points: Array, triangle: NDArray[np.int64]) -> Array:
        corners = self.corners[triangle]
        weights = closest_weights(points, corners[:, 0], corners[:, 1], corners[:, 2])
        return np.einsum("nc,nci->ni", weights, corners)


@dataclass(frozen=True, eq=False)
class Guide:
    """The sheets of an outline, in coordinates along the index axes [m], and the spacing (3,) of the voxels there."""

    sheets: tuple[_Sheet, ...]
    spacing: Array

    def nearest(self, points: Array, outward: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Return the places of the outline (n, 3) near points (n, 3), its normals there, and where (n,) there are any.

        outward: (n, 3) unit normals of the surface at the points.
        """
        reach, voxel = float(np.linalg.norm(REACH * self.spacing)), float(self.spacing.min())
        place, normal = points.copy(), np.zeros_like(points)
        best, least = np.full((2, len(points)), np.inf)
        for sheet in self.sheets:
            rows = sheet.near(points, reach)
            at, facing, away, nearest = sheet.nearest(points[rows], outward[rows], reach)
            least[rows] = np.minimum(least[rows], nearest)
            found = away < best[rows]
            for other in self.sheets:
                if other is not sheet and found.any():
                    found[found] = ~other.hides(at[found], reach, BEHIND * voxel)
            rows = rows[found]
            place[rows], normal[rows], best[rows] = at[found], facing[found], away[found]
        return place, normal, np.isfinite(best) & (best <= FARTHER * least + SIDEWAYS * voxel)

    def net(self, vertices: Array, faces: Faces) -> Array | None:
        """Return the vertices (s, 3) of a net [m] drawn to the outline, or None where that is elsewhere."""
        place, normal, found = self.nearest(vertices[faces].mean(axis=1), face_normals(vertices, faces))
        if found.mean() < LEAST:
            return None
        step = _least(vertices, faces[found], place[found], normal[found])
        return self.vertices(self._near(vertices, vertices + step), faces, vertices)

    def vertices(self, x: Array, faces: Faces, start: Array | None = None) -> Array:
        """Return vertices x (s, 3) [m] at the nearest places of the outline.  start: (s, 3) where they were before."""
        start = x if start is None else start
        place, normal, found = self.nearest(x, outward := vertex_normals(x, faces))
        way = place - x
        along = np.einsum("nc,nc->n", way, outward)
        across = np.linalg.norm(way - along[:, None] * outward, axis=1)
        found &= across <= np.maximum(np.abs(along), SIDEWAYS * float(self.spacing.min()))
        place += 0.5 * self._missing(place, normal)[:, None] * normal
        x = self._near(start, np.where(found[:, None], place, x))
        return self._unfolded(x, start, faces, normal)

    def _missing(self, place: Array, normal: Array) -> Array:
        """How much less than a voxel (n,) the outline is thick below its places [m]: contacts need as much.

        The other side is looked for from a voxel below, where no sample of this side is nearer.
        """
        voxel = float(self.spacing.min())
        opposite, facing, found = self.nearest(place - voxel * normal, -normal)
        found &= np.einsum("nc,nc->n", facing, normal) < -PARALLEL
        thick = np.einsum("nc,nc->n", place - opposite, normal)
        return np.where(found & (thick >= 0), np.maximum(voxel - thick, 0), 0)

    def _unfolded(self, x: Array, start: Array, faces: Faces, normal: Array) -> Array:
        """Without triangles that turned over or lost their area.  normal: (s, 3) of the outline at the vertices."""
        right = face_normals(start, faces), _unit(normal[faces].sum(axis=1))
        beside = _neighbours(faces)
        least = 2 * SLIVER * float(self.spacing.min()) ** 2
        for share in [0.5] * (RETURNS - 1) + [1.0]:
            cross = _crosses(x[faces])
            now = _unit(cross)
            bad = np.all([np.einsum("tc,tc->t", now, some) < TURNED for some in right], axis=0)
            bad |= np.linalg.norm(cross, axis=1) < least
            folded = np.einsum("ec,ec->e", now[beside[:, 0]], now[beside[:, 1]]) < FOLDED
            bad[beside[folded]] = True
            if not bad.any():
                break
            back = np.unique(faces[bad])
            x[back] += share * (start[back] - x[back])
        return x

    def _near(self, start: Array, x: Array) -> Array:
        return np.clip(x, start - REACH * self.spacing, start + REACH * self.spacing)


def guide_to(outline: Outline, corner: Array, spacing: Array, vertices: Array) -> Guide | None:
    """Return what draws a net with these vertices (s, 3) [m] to an outline, None where that is much larger, or flat.

    corner: (3,) [voxels] where the net's coordinates begin, which are along the index axes.  spacing: (3,) [m].
    """
    x = (outline.vertices.astype(np.float64) - corner) * spacing
    low, high = vertices.min(axis=0) - spacing, vertices.max(axis=0) + spacing
    sheets, step, count = [], float(spacing.min()) / 2, 0
    for part in np.unique(outline.part):
        corners = x[outline.faces[outline.part == part]]
        corners = corners[((corners.max(axis=1) >= low) & (corners.min(axis=1) <= high)).all(axis=1)]
        cross = _crosses(corners)
        has_area = np.linalg.norm(cross, axis=1) > 0
        corners, normals = corners[has_area], _unit(cross[has_area])
        if not len(corners):
            continue
        rows = rows_of_samples(corners, step)
        count += rows.larger
        if count > MOST_SAMPLES * len(vertices):
            return None
        points, owner = rows.samples()
        sheets.append(_Sheet(corners, normals, owner, KDTree(points, balanced_tree=False)))
    return Guide(tuple(sheets), spacing) if sheets else None


def face_normals(x: Array, faces: Faces) -> Array:
    """Return unit normals (t, 3), 0 for triangles without area."""
    return _unit(_crosses(x[faces]))


def vertex_normals(x: Array, faces: Faces) -> Array:
    """Return unit normals (s, 3), means of the triangles' by their areas."""
    cross = _crosses(x[faces])
    total = [np.bincount(faces.ravel(), np.repeat(cross[:, i], 3), len(x)) for i in range(3)]
    return _unit(np.stack(total, axis=1).astype(np.float64))


def _crosses(corners: Array) -> Array:
    """Normals (t, 3) of triangles (t, 3, 3), as long as twice their areas."""
    a, b, c = corners.transpose(1, 0, 2)
    return np.cross(b - a, c - a)


def _unit(vectors: Array) -> Array:
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors / np.where(length > 0, length, 1)


def _neighbours(faces: Faces) -> NDArray[np.int64]:
    """The two triangles (e, 2) at each edge of a closed surface."""
    tail, head = faces.ravel().astype(np.int64), np.roll(faces, -1, axis=1).ravel().astype(np.int64)
    order = np.lexsort((np.maximum(tail, head), np.minimum(tail, head)))
    return order.reshape(-1, 2) // 3


def _least(x: Array, faces: Faces, place: Array, normal: Array) -> Array:
    """The steps (s, 3) from x towards what is nearest to the planes of the triangles around each vertex."""
    vertex, row = faces.ravel(), np.repeat(np.arange(len(faces)), 3)
    n = normal[row]
    height = np.einsum("nc,nc->n", n, place[row] - x[vertex])
    upper = [np.bincount(vertex, n[:, i] * n[:, j], len(x)).astype(np.float64) for i, j in _UPPER]
    a, b, c, d, e, f = upper
    right = np.stack([np.bincount(vertex, height * n[:, i], len(x)) for i in range(3)], axis=1).astype(np.float64)
    firm = FIRM * (a + d + f) + 1e-300
    inverse = _inverse(a + firm, b, c, d + firm, e, f + firm)
    step = np.zeros_like(x)
    for _ in range(STEPS):
        left = right - _times(upper, step)
        step = step + _times(inverse, left)
    return step


_UPPER = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


def _inverse(a: Array, b: Array, c: Array, d: Array, e: Array, f: Array) -> tuple[Array, ...]:
    """The upper triangle of the inverse of symmetric matrices, from their own: the same on every processor."""
    A, B, C = d * f - e * e, c * e - b * f, b * e - c * d
    determinant = a * A + b * B + c * C
    determinant = np.where(determinant > 0, determinant, np.inf)
    return tuple(some / determinant for some in (A, B, C, a * f - c * c, b * c - a * e, a * d - b * b))


def _times(upper: Sequence[Array], v: Array) -> Array:
    a, b, c, d, e, f = upper
    x, y, z = v.T
    return np.stack([a * x + b * y + c * z, b * x + d * y + e * z, c * x + e * y + f * z], axis=1)
