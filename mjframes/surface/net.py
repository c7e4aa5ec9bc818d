"""The surface net of a volume: the faces of its voxels, whose corners are moved onto the surface.

A corner of a flat face (`flat.py`) stays in the face's plane, so that flat sides are flat and their edges sharp. All
others move to {G ∗ 1_inside = ½}, the isosurface of the Gaussian-smoothed voxels; on the rim of a flat side, to the
same line of its own layer of voxels. After S. Gibson, Constrained elastic surface nets, MICCAI 1998.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import ndimage, sparse
from scipy.sparse.csgraph import connected_components

from mjframes.surface.flat import exposed, flat_faces
from mjframes.surface.smoothing import SMOOTHING, inside_field

REACH = 0.75  # [voxels] along each axis that a corner moves at most: any smooth surface is that near
PROJECTIONS = 4  # Newton steps onto the isosurface
RELAXATIONS = 3  # of corners along it: those of one step of a slope come to lie on each other otherwise
NARROW = 0.05  # [voxels] a face whose edges are shorter has collapsed, as those of a single voxel do
LEVEL = 0.5  # [-] of the smoothed voxels on the surface


@dataclass(frozen=True, eq=False)
class Net:
    """A closed manifold surface.

    vertices: (s, 3) in voxels, a voxel's centre at its index.
    faces: (t, 3) int32, counter-clockwise seen from outside.
    fixed: (s, 3) bool, the axes along which a vertex stays in the plane of a flat side.
    """

    vertices: np.ndarray
    faces: np.ndarray
    fixed: np.ndarray


def surface_net(inside: np.ndarray) -> Net:
    """Return the net of the inside (nx, ny, nz), which has a margin of two empty voxels."""
    inside = _without_crossings(inside)
    corner, facing, plane = _quads(inside)
    vertex, count = _fans(inside.shape, corner)
    at = np.empty((count, 3))
    at[vertex] = corner - 0.5
    fixed, side = np.zeros((count, 3), bool), np.zeros((count, 3), np.int8)
    axis, outward = np.repeat(facing, 4, axis=0).T
    flat = np.repeat(plane, 4)
    fixed[vertex[flat], axis[flat]] = True
    side[vertex[flat], axis[flat]] = outward[flat]
    quad = vertex.reshape(-1, 4)
    meets = np.zeros((count, 3), bool)
    meets[vertex, axis] = True
    ends = np.asarray((meets & ~fixed).any(axis=1))
    moved = _placed(inside, at, quad, fixed, np.where(ends[:, None], side, 0))
    return Net(moved, _triangles(moved, quad), fixed)


def _quads(inside: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The lattice corners (4 q, 3) of all faces, counter-clockwise from outside; the axis and the side, ±1, that each
    faces (q, 2); and which are flat (q,).
    """
    corners, facing, flat = [], [], []
    for axis in range(3):
        along, across = np.eye(3, dtype=np.int64)[[(axis + 1) % 3, (axis + 2) % 3]]
        for side in (-1, 1):
            where = exposed(inside, axis, side)
            base = np.argwhere(where) + (side > 0) * np.eye(3, dtype=np.int64)[axis]
            ring = np.array([0 * along, along, along + across, across])[::side]
            corners.append(base[:, None] + ring)
            facing.append(np.full((len(base), 2), (axis, side)))
            flat.append(flat_faces(where, axis, side)[where])
    return np.concatenate(corners).reshape(-1, 3), np.concatenate(facing), np.concatenate(flat)


def _without_crossings(inside: np.ndarray) -> np.ndarray:
    """The inside, and one of the two empty voxels wherever two others touch along an edge only, as four faces meet."""
    inside = inside.copy()
    smooth = ndimage.gaussian_filter(inside.astype(np.float32), SMOOTHING, truncate=3.0, mode="constant")
    while True:
        filled = np.zeros_like(inside)
        for one, other in ((0, 1), (1, 2), (2, 0)):
            for way in (-1, 1):
                across = np.roll(inside, (-1, -way), (one, other))
                beside, below = (np.roll(inside, shift, axis) for shift, axis in ((-1, one), (-way, other)))
                crossing = inside & across & ~beside & ~below
                fuller = np.roll(smooth, -1, one) >= np.roll(smooth, -way, other)
                filled |= np.roll(crossing & fuller, 1, one) | np.roll(crossing & ~fuller, way, other)
        if not filled.any():
            return inside
        inside |= filled


def _fans(shape: tuple[int, ...], corner: np.ndarray) -> tuple[np.ndarray, int]:
    """The vertex (4 q,) of each corner of each face, and how many there are.

    Two faces meet at each lattice edge and go on into each other; pieces of surface that meet in a point do not.
    """
    lattice = np.ravel_multi_index(tuple(corner.T), tuple(np.add(shape, 1))).reshape(-1, 4)
    start, end = lattice.ravel(), np.roll(lattice, -1, axis=1).ravel()
    order = np.lexsort((np.maximum(start, end), np.minimum(start, end)))
    one, other = order[::2], order[1::2]
    after = np.arange(len(start)).reshape(-1, 4)
    after = np.roll(after, -1, axis=1).ravel()
    rows, columns = np.concatenate([one, after[one]]), np.concatenate([after[other], other])
    links = sparse.coo_array((np.ones(len(rows), bool), (rows, columns)), shape=(len(start), len(start)))
    count, vertex = connected_components(links, directed=False)
    return vertex, count


def _placed(inside: np.ndarray, at: np.ndarray, quad: np.ndarray, fixed: np.ndarray, rim: np.ndarray) -> np.ndarray:
    """The vertices (s, 3) on the surface; at: corners of voxels, rim: (s, 3) ±1 where they end a flat side, which way
    that faces.
    """
    start, at = at, at.copy()
    free = ~fixed.any(axis=1)
    whole = _sampler(inside_field(inside))
    at[free] = _projected(whole, at[free], start[free])
    pairs = quad.ravel(), np.roll(quad, -1, axis=1).ravel()
    ring = sparse.csr_array(sparse.coo_array((np.ones(quad.size), pairs), shape=(len(at), len(at))))
    ring = sparse.diags_array(1 / ring.sum(axis=1)) @ ring
    for _ in range(RELAXATIONS):
        at[free] = _projected(whole, 0.5 * (at + ring @ at)[free], start[free])
    narrow = quad[np.linalg.norm(at[quad] - at[np.roll(quad, 1, axis=1)], axis=2).max(axis=1) < NARROW].ravel()
    at[narrow] = start[narrow]
    for axis in range(3):
        ends = np.flatnonzero((rim[:, axis] != 0) & (fixed.sum(axis=1) == 1))
        sigma = np.where(np.arange(3) == axis, 0, SMOOTHING)
        smooth = ndimage.gaussian_filter(inside.astype(np.float32), sigma, truncate=3.0, mode="constant")
        layer = _sampler(smooth, np.arange(3) != axis)
        # it ends at an edge, whose line is in the layer of voxels below, or at the foot of what stands on it
        step = 0.5 * rim[ends, axis, None] * np.eye(3)[axis]
        below, above = (np.abs(layer(start[ends] + way * step)[0] - LEVEL) for way in (-1, 1))
        step[below <= above] *= -1
        at[ends] = _projected(layer, start[ends] + step, start[ends] + step) - step
    return at


Sampler = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


def _sampler(field: np.ndarray, along: np.ndarray | None = None) -> Sampler:
    """A function of points (n, 3) in voxels: the trilinear field there (n,) and its gradient (n, 3) along axes (3,)."""
    along = np.ones(3, bool) if along is None else along

    def sample(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        base = np.clip(np.floor(points).astype(np.int64), 0, np.array(field.shape) - 2)
        f = points - base
        value, slope = np.zeros(len(points)), np.zeros((len(points), 3))
        for corner in np.ndindex(2, 2, 2):
            share = np.where(corner, f, 1 - f)
            at = field[tuple((base + corner).T)].astype(np.float64)
            value += at * share.prod(axis=1)
            for axis in np.flatnonzero(along):
                others = share[:, [a for a in range(3) if a != axis]].prod(axis=1)
                slope[:, axis] += at * others * (2 * corner[axis] - 1)
        return value, slope

    return sample


def _projected(sample: Sampler, points: np.ndarray, start: np.ndarray) -> np.ndarray:
    """The points (n, 3) moved to the level, no farther from where they started than they may."""
    for _ in range(PROJECTIONS):
        value, slope = sample(points)
        square = np.maximum((slope**2).sum(axis=1), 1e-12)
        step = ((LEVEL - value) / square)[:, None] * slope
        points = np.clip(points + np.clip(step, -REACH, REACH), start - REACH, start + REACH)
    return points


def _triangles(at: np.ndarray, quad: np.ndarray) -> np.ndarray:
    """(t, 3) two a face, along its shorter diagonal."""
    a, b, c, d = quad.T
    short = np.linalg.norm(at[a] - at[c], axis=1) <= np.linalg.norm(at[b] - at[d], axis=1)
    one = np.where(short[:, None], np.stack([a, b, c], 1), np.stack([a, b, d], 1))
    two = np.where(short[:, None], np.stack([a, c, d], 1), np.stack([b, c, d], 1))
    return np.concatenate([one, two]).astype(np.int32)
