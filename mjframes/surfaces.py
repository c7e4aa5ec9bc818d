"""Surfaces of a volume: what is drawn, one skin a material, and what touches (the paper, §5.4).

`extract_surface`: the isosurface {G ∗ 1_inside = ½} of the Gaussian-smoothed voxels, closed and oriented outwards,
moved along its normals so that it encloses the volume of the voxels; cut where two smoothed material indicators
G ∗ 1_a and G ∗ 1_b are equal, so that every triangle has one material.
`contact_points`: centres of spheres that touch that surface from inside, by farthest-point sampling.
`voxel_shares`: fields of the voxels at any point, trilinear among those with the same frames as the nearest one.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy import ndimage
from scipy.sparse import csr_array
from scipy.spatial import KDTree
from skimage.measure import marching_cubes

from mjframes.decimate import decimate
from mjframes.errors import MjframesError
from mjframes.grid import Grid
from mjframes.smoothing import SMOOTHING, inside_field
from mjframes.volume import Volume
from mjframes.weights import frame_count

OFFSETS = 4  # Newton steps of the enclosed volume: each squares the error, a tenth at the start
SEAM_MARGIN = 0.1  # [-] of an edge: seams keep that distance from vertices, so that no cut triangle is a sliver
REACH = 2  # [voxels] around a point in which its nearest voxel is looked for first
MARGIN = 2  # [voxels] of empty space around the volume, for the surface to close


@dataclass(frozen=True, eq=False)
class Surface:
    """A closed surface of several materials.

    vertices: (s, 3) volume coordinates [m].  faces: (t, 3) int32, counter-clockwise seen from outside.
    label: (t,) material label of each triangle.
    """

    vertices: np.ndarray
    faces: np.ndarray
    label: np.ndarray

    @property
    def normals(self) -> np.ndarray:
        """(s, 3) outward unit normals, weighted by the angles of the triangles."""
        return _vertex_normals(self.vertices, self.faces)

    @property
    def area(self) -> float:
        """[m²]"""
        return float(np.linalg.norm(_area_vectors(self.vertices, self.faces), axis=1).sum())

    @property
    def enclosed(self) -> float:
        """Enclosed volume [m³]."""
        return _enclosed(self.vertices, self.faces)


@dataclass(frozen=True, eq=False)
class ContactPoints:
    """Centres of the contact spheres.

    positions: (s, 3) volume coordinates [m].  radius: [m].  normals: (s, 3) of the surface above each, outward.
    rank: (s,) int, 0 for the most important: for every n the points of rank below n cover the surface evenly.
    """

    positions: np.ndarray
    radius: float
    normals: np.ndarray
    rank: np.ndarray

    def sorted(self, order: np.ndarray) -> ContactPoints:
        """The same in another order (s,)."""
        return ContactPoints(self.positions[order], self.radius, self.normals[order], self.rank[order])


def extract_surface(volume: Volume, target_vertices: int = 5000) -> Surface:
    """The closed surface of all materials together, with about `target_vertices` vertices and smooth seams.

    Raises MjframesError if target_vertices < 100.
    """
    if target_vertices < 100:
        raise MjframesError(f"target_vertices is {target_vertices!r}; a surface needs 100 vertices or more.")
    spacing = np.asarray(volume.spacing, dtype=np.float64)
    box = ndimage.find_objects((volume.labels > 0).astype(np.int8))[0]
    labels = np.pad(volume.labels[box], MARGIN)
    index, faces, *_ = marching_cubes(inside_field(labels > 0), 0.5, allow_degenerate=False)
    vertices, faces = decimate(index * spacing, faces, target_vertices)
    faces = faces[:, ::-1] if _enclosed(vertices, faces) < 0 else faces
    vertices = _conserve_volume(vertices, faces, np.count_nonzero(labels) * float(np.prod(spacing)))
    materials, indicator = _material_indicators(labels, vertices / spacing)
    vertices, faces, label = _cut_seams(vertices, faces, indicator)
    corner = np.array([s.start for s in box]) - MARGIN + 0.5  # index 0 of the padded array is the centre of a voxel
    vertices = volume.origin + (vertices + corner * spacing) @ volume.axes.T
    return Surface(vertices, faces.astype(np.int32), materials[label])


def contact_points(surface: Surface, volume: Volume, radius: float | None = None, count: int = 600) -> ContactPoints:
    """At most `count` spheres that touch the surface from inside: the extreme vertices first, then farthest points.

    radius: [m], half the smallest spacing unless given.
    Raises MjframesError if radius ≤ 0 or count < 1.
    """
    radius = float(np.min(volume.spacing)) / 2 if radius is None else float(radius)
    if not (np.isfinite(radius) and radius > 0):
        raise MjframesError(f"radius is {radius!r}; contact spheres need a positive radius in metres.")
    if count < 1:
        raise MjframesError(f"count is {count!r}; contact needs one point or more.")
    normals = surface.normals
    # Distances see the normals too: the two sides of a thin plate are then far apart, and sharp edges get more points.
    reach = np.sqrt(surface.area / count)
    chosen = _farthest_points(np.hstack([surface.vertices, reach * normals]), _extremes(surface.vertices), count)
    positions = surface.vertices[chosen] - radius * normals[chosen]
    return ContactPoints(positions, radius, normals[chosen], np.arange(len(chosen)))


def surface_weights(grid: Grid, weights: csr_array, points: np.ndarray) -> csr_array:
    """Return the frame weights (s, f) at points (s, 3), from those at the voxels (n, f): see `voxel_shares`."""
    return csr_array(voxel_shares(grid, weights, points) @ weights)


def voxel_shares(grid: Grid, weights: csr_array, points: np.ndarray, nearest: np.ndarray | None = None) -> csr_array:
    """Return c_v (s, n) with which fields at the voxels make up their values at points; rows sum to 1.

    Trilinear over the voxels with the nearest voxel's frames; that voxel alone where it is rigid.
    weights: (n, f) at the voxels.  points: (s, 3) volume coordinates [m], within a voxel or so of the inside.
    nearest: their `closest_voxels`, where they are known.
    """
    points = np.asarray(points, dtype=np.float64)
    nearest = closest_voxels(grid, points) if nearest is None else nearest
    pattern = _patterns(weights)
    cell = (points - grid.origin) @ grid.axes / grid.spacing - 0.5  # the centres of voxels are at integers
    base = np.floor(cell).astype(np.int64)
    fraction = cell - base
    voxel = np.empty((len(points), 8), np.int64)
    coefficient = np.empty((len(points), 8))
    for k, offset in enumerate(itertools.product((0, 1), repeat=3)):
        index = base + offset
        valid = np.all((index >= 0) & (index < grid.lookup.shape), axis=1)
        v = np.where(valid, grid.lookup[tuple(np.where(valid[:, None], index, 0).T)], -1)
        same = (v >= 0) & (pattern[v] == pattern[nearest])
        voxel[:, k] = np.where(same, v, nearest)
        coefficient[:, k] = same * np.where(offset, fraction, 1 - fraction).prod(axis=1)
    total = coefficient.sum(axis=1)
    alone = (total < 1e-6) | (grid.piece[nearest] >= 0)
    coefficient[alone], coefficient[alone, 0], voxel[alone, 0], total[alone] = 0.0, 1.0, nearest[alone], 1.0
    rows = np.repeat(np.arange(len(points)), 8)
    used = coefficient.ravel() > 0
    entries = ((coefficient / total[:, None]).ravel()[used], (rows[used], voxel.ravel()[used]))
    return csr_array(entries, shape=(len(points), len(grid.index)))


def closest_voxels(grid: Grid, points: np.ndarray) -> np.ndarray:
    """(s,) the voxel whose centre is closest to each point (s, 3), in volume coordinates [m]."""
    at = (points - grid.origin) @ grid.axes / grid.spacing - 0.5
    nearest = _search(at, grid.lookup, grid.spacing)
    if (far := nearest < 0).any():
        # so far from all voxels around it, a point is outside
        nearest[far] = grid.outermost[KDTree(grid.points(grid.outermost)).query(points[far])[1]]
    return nearest


@njit(cache=True)
def _search(at, lookup, spacing):
    """The nearest voxel (s,) to places in index coordinates (s, 3), −1 if it is not among the 5³ cells around."""
    nearest = np.full(len(at), -1, np.int64)
    for s in range(len(at)):
        base = (round(at[s, 0]), round(at[s, 1]), round(at[s, 2]))
        best = (REACH + 0.5) * spacing.min()  # what is farther may be nearer than the cells looked at
        best *= best
        for a in range(max(0, base[0] - REACH), min(lookup.shape[0], base[0] + REACH + 1)):
            for b in range(max(0, base[1] - REACH), min(lookup.shape[1], base[1] + REACH + 1)):
                for c in range(max(0, base[2] - REACH), min(lookup.shape[2], base[2] + REACH + 1)):
                    if lookup[a, b, c] < 0:
                        continue
                    x, y, z = (a - at[s, 0]) * spacing[0], (b - at[s, 1]) * spacing[1], (c - at[s, 2]) * spacing[2]
                    square = x * x + y * y + z * z
                    if square < best:
                        best, nearest[s] = square, lookup[a, b, c]
    return nearest


def _conserve_volume(vertices: np.ndarray, faces: np.ndarray, target: float) -> np.ndarray:
    """Move the surface along its normals until it encloses `target` [m³]: smoothing and decimation cut corners."""
    for _ in range(OFFSETS):
        area = np.linalg.norm(_area_vectors(vertices, faces), axis=1).sum()
        vertices = vertices + (target - _enclosed(vertices, faces)) / area * _vertex_normals(vertices, faces)
    return vertices


def _material_indicators(labels: np.ndarray, index: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(materials (m,), G ∗ 1_material at the points (s, m)), from the 5 × 5 × 5 voxels around each point."""
    materials = np.unique(labels[labels > 0])
    base = np.rint(index).astype(np.int64)
    indicator = np.zeros((len(index), len(materials)))
    rows = np.arange(len(index))
    for offset in itertools.product(range(-2, 3), repeat=3):
        at = np.clip(base + offset, 0, np.array(labels.shape) - 1)
        label = labels[tuple(at.T)]
        gauss = np.exp(-(((base + offset - index) / SMOOTHING) ** 2).sum(axis=1) / 2)
        indicator[rows, np.searchsorted(materials, label) % len(materials)] += gauss * (label > 0)
    return materials, indicator


def _cut_seams(
    vertices: np.ndarray, faces: np.ndarray, indicator: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cut the triangles whose corners have different materials; both sides of an edge cut it at one shared vertex."""
    material = indicator.argmax(axis=1)
    corner = material[faces]
    whole = (corner == corner[:, :1]).all(axis=1)
    mixed = faces[~whole]
    if len(mixed) == 0:
        return vertices, faces, corner[:, 0]
    edges = np.sort(np.stack([mixed, np.roll(mixed, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    edges, inverse = np.unique(edges, axis=0, return_inverse=True)
    cut = np.where(material[edges[:, 0]] != material[edges[:, 1]])[0]
    a, b = edges[cut].T
    lead_a = indicator[a, material[a]] - indicator[a, material[b]]
    lead_b = indicator[b, material[b]] - indicator[b, material[a]]
    t = np.clip(lead_a / np.maximum(lead_a + lead_b, 1e-12), SEAM_MARGIN, 1 - SEAM_MARGIN)[:, None]
    number = np.full(len(edges), -1)
    number[cut] = len(vertices) + np.arange(len(cut))
    vertices = np.vstack([vertices, (1 - t) * vertices[a] + t * vertices[b]])
    middle = number[inverse].reshape(-1, 3)  # vertex on the edge from corner c to corner c + 1, or -1

    # two materials: turn the triangle so that corner 0 is the one on its own
    alone = np.argmax(middle < 0, axis=1)
    turn = (alone[:, None] + 2 + np.arange(3)) % 3
    three = (middle >= 0).all(axis=1)
    turn[three] = np.arange(3)
    p, q, r = np.take_along_axis(mixed, turn, axis=1).T
    pq, qr, rp = np.take_along_axis(middle, turn, axis=1).T
    two = ~three
    centre = np.full(len(mixed), -1)
    centre[three] = len(vertices) + np.arange(three.sum())
    vertices = np.vstack([vertices, vertices[mixed[three]].mean(axis=1)])
    pieces = [
        np.stack(triangle, axis=1)[of]
        for of, triangle in (
            (two, (p, pq, rp)),
            (two, (q, r, pq)),
            (two, (r, rp, pq)),
            (three, (p, pq, centre)),
            (three, (p, centre, rp)),
            (three, (q, qr, centre)),
            (three, (q, centre, pq)),
            (three, (r, rp, centre)),
            (three, (r, centre, qr)),
        )
    ]
    faces = np.vstack([faces[whole], *pieces])
    label = np.concatenate([corner[whole, 0], *(material[piece[:, 0]] for piece in pieces)])
    return vertices, faces, label


def _extremes(x: np.ndarray) -> np.ndarray:
    """Vertices farthest along the 26 axes and diagonals, farthest from the middle first: corners and tips."""
    directions = np.array([d for d in itertools.product((-1, 0, 1), repeat=3) if any(d)], dtype=np.float64)
    size = np.ptp(x, axis=0)
    unit = (x - x.mean(axis=0)) / np.where(size > 0, size, 1)
    found = np.unique((unit @ directions.T).argmax(axis=0))
    return found[np.argsort(-np.linalg.norm(x[found] - x.mean(axis=0), axis=1), kind="stable")]


def _farthest_points(x: np.ndarray, first: np.ndarray, count: int) -> np.ndarray:
    """Indices of `count` points: `first`, then always the one farthest from those before it; (s, d) metric."""
    count = min(count, len(x))
    chosen = list(first[:count])
    distance = np.full(len(x), np.inf)
    for k in range(count):
        if k >= len(chosen):
            chosen.append(int(distance.argmax()))
        step = x - x[chosen[k]]
        np.minimum(distance, np.einsum("sd,sd->s", step, step), out=distance)
    return np.array(chosen)


def _patterns(weights: csr_array) -> np.ndarray:
    """(n,) one number per set of frames: a sum of 64-bit random keys, of which two sets practically never agree."""
    keys = np.random.default_rng(0).integers(1, 2**63, frame_count(weights), dtype=np.uint64)
    return _sum_keys(weights.indptr, weights.indices, weights.data, keys)


@njit(cache=True)
def _sum_keys(indptr, indices, data, keys):
    pattern = np.zeros(len(indptr) - 1, np.uint64)
    for v in range(len(pattern)):
        for k in range(indptr[v], indptr[v + 1]):
            if data[k] != 0:
                pattern[v] += keys[indices[k]]
    return pattern


def _area_vectors(x: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(t, 3) normals of length area."""
    return np.cross(x[faces[:, 1]] - x[faces[:, 0]], x[faces[:, 2]] - x[faces[:, 0]]) / 2


def _enclosed(x: np.ndarray, faces: np.ndarray) -> float:
    """Volume inside a closed surface: ⅓ ∫ x·n dA."""
    return float(np.einsum("tc,tc->", x[faces].mean(axis=1), _area_vectors(x, faces)) / 3)


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-300)


def _vertex_normals(x: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(s, 3) unit normals; triangles count by their angle, so that the triangulation of a flat side does not matter."""
    normals = np.zeros_like(x)
    face_normals = _unit(_area_vectors(x, faces))
    for c in range(3):
        here = x[faces[:, c]]
        forward, back = _unit(x[faces[:, (c + 1) % 3]] - here), _unit(x[faces[:, (c + 2) % 3]] - here)
        angle = np.arccos(np.clip(np.einsum("tc,tc->t", forward, back), -1, 1))
        np.add.at(normals, faces[:, c], angle[:, None] * face_normals)
    return _unit(normals)
