"""Uniform decimation of a closed triangle surface by edge collapse.

A skin bends with its body, so it needs vertices on its flat parts too: the shortest edges go first, and the quadric
error Q(x) = Σ_f A_f (n_f·x + d_f)² of the triangles around an edge only chooses where its new vertex lies. An edge
collapses if exactly two vertices are adjacent to both its ends (the link condition), no triangle turns over and the
surface stays near: a closed manifold surface remains one.
"""

from __future__ import annotations

from itertools import combinations_with_replacement

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int32]
Point = tuple[float, float, float]

LARGEST_TURN = 0.8  # [-] cosine of the largest turn of a triangle in one collapse: 37 degrees
LARGEST_ERROR = 0.15  # [-] of the final edge length: root mean square distance to the planes of the old triangles
FIRST_LENGTH = 0.3  # [-] of the final edge length: the slivers of marching cubes are shorter than that
LENGTH_GROWTH = 1.12  # [-] between passes: small enough for collapses to come in order of length
PASSES = 20  # the last pass takes edges of 2.6 times the final length, by then nothing is left to collapse


def decimate(vertices: np.ndarray, faces: np.ndarray, target_vertices: int) -> tuple[np.ndarray, np.ndarray]:
    """Collapse short edges of a closed surface until `target_vertices` are left, or more where its shape needs them.

    vertices: (s, 3) [m].  faces: (t, 3) int, counter-clockwise seen from outside.  Return new (vertices, faces).
    """
    if len(vertices) <= target_vertices:
        return vertices, faces
    x = np.array(vertices, dtype=np.float64)
    f = np.array(faces, dtype=np.int32)
    quadric, area = _quadrics(x, f)
    # a closed surface of s vertices has 2 s triangles: equilateral ones of area A / (2 s)
    length = np.sqrt(area / (2 * target_vertices) * 4 / np.sqrt(3))
    alive = _collapse(x, f, quadric, length, target_vertices)
    f = f[alive]
    used, inverse = np.unique(f, return_inverse=True)
    return x[used], inverse.reshape(f.shape).astype(np.int32)


def _quadrics(x: Array, faces: Ints) -> tuple[Array, float]:
    """Q (s, 10) of each vertex, the upper triangle of Σ_f A_f (n, d)(n, d)ᵀ row by row, and Σ_f A_f."""
    a, b, c = x[faces].transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    double = np.sqrt((normal**2).sum(axis=1))
    normal /= np.where(double > 0, double, 1)[:, None]
    plane, area = np.column_stack([normal, -(normal * a).sum(axis=1)]), double / 2
    quadric = [
        np.bincount(faces.ravel(), np.repeat(area * plane[:, k] * plane[:, j], 3), len(x))
        for k, j in combinations_with_replacement(range(4), 2)
    ]
    return np.stack(quadric, axis=1).astype(np.float64), float(np.cumsum(area)[-1])


@njit(cache=True, inline="always")
def _normal(x: Array, a: int, b: int, c0: float, c1: float, c2: float) -> Point:
    """(b − a) × (c − a) of two vertices and a point c."""
    e0, e1, e2 = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
    f0, f1, f2 = c0 - x[a, 0], c1 - x[a, 1], c2 - x[a, 2]
    return e1 * f2 - e2 * f1, e2 * f0 - e0 * f2, e0 * f1 - e1 * f0


@njit(cache=True)
def _collapse(x: Array, faces: Ints, quadric: Array, length: float, target: int) -> NDArray[np.bool_]:
    """Collapse edges in place; return which faces are left."""
    alive = np.ones(len(faces), np.bool_)
    first, last = np.empty((2, len(x)), np.int64)
    following = np.empty(3 * len(faces), np.int64)
    mark = np.zeros(len(x), np.int64)
    stamp = 0
    count = len(x)
    limit = FIRST_LENGTH * length
    joint = np.empty(10)
    for _ in range(PASSES):
        left = np.flatnonzero(alive)
        _list_corners(left, faces, first, last, following)
        for f in left:
            for c in range(3):
                if count <= target:
                    return alive
                if not alive[f]:
                    break
                u, v = faces[f, c], faces[f, (c + 1) % 3]
                if u > v or _square(x, u, v) > limit * limit:
                    continue
                stamp += 2
                if _common_neighbours(u, v, faces, alive, first, following, mark, stamp) != 2:
                    continue
                for k in range(10):
                    joint[k] = quadric[u, k] + quadric[v, k]
                position = _position(x, u, v, joint)
                if _error(position, joint) > (LARGEST_ERROR * length) ** 2 * _area(joint):
                    continue
                if _turns(u, v, position, x, faces, alive, first, following) or _turns(
                    v, u, position, x, faces, alive, first, following
                ):
                    continue
                for k in range(3):
                    x[u, k] = position[k]
                for k in range(10):
                    quadric[u, k] = joint[k]
                corner = first[v]
                while corner >= 0:
                    g = corner // 3
                    if faces[g, 0] == u or faces[g, 1] == u or faces[g, 2] == u:
                        alive[g] = False
                    faces[g, corner % 3] = u
                    corner = following[corner]
                following[last[u]] = first[v]
                last[u] = last[v]
                count -= 1
        limit *= LENGTH_GROWTH
    return alive


@njit(cache=True)
def _list_corners(
    left: NDArray[np.integer],
    faces: Ints,
    first: NDArray[np.int64],
    last: NDArray[np.int64],
    following: NDArray[np.int64],
) -> None:
    """List the corners 3 f + c around each vertex, linked, of the faces left; joining vertices joins their lists."""
    first[:] = -1
    for f in left:
        for c in range(3):
            corner, v = 3 * f + c, faces[f, c]
            if first[v] < 0:
                first[v] = corner
            else:
                following[last[v]] = corner
            following[corner] = -1
            last[v] = corner


@njit(cache=True)
def _common_neighbours(
    u: int,
    v: int,
    faces: Ints,
    alive: NDArray[np.bool_],
    first: NDArray[np.int64],
    following: NDArray[np.int64],
    mark: NDArray[np.int64],
    stamp: int,
) -> int:
    """Return how many vertices are adjacent to both u and v."""
    corner = first[u]
    while corner >= 0:
        f = corner // 3
        if alive[f]:
            for c in range(3):
                mark[faces[f, c]] = stamp
        corner = following[corner]
    common = 0
    corner = first[v]
    while corner >= 0:
        f = corner // 3
        if alive[f]:
            for c in range(3):
                w = faces[f, c]
                if w != u and w != v and mark[w] == stamp:
                    mark[w] = stamp + 1
                    common += 1
        corner = following[corner]
    return common


@njit(cache=True)
def _square(x: Array, u: int, v: int) -> float:
    """Squared length of an edge."""
    e0, e1, e2 = x[v, 0] - x[u, 0], x[v, 1] - x[u, 1], x[v, 2] - x[u, 2]
    return e0 * e0 + e1 * e1 + e2 * e2


@njit(cache=True)
def _position(x: Array, u: int, v: int, quadric: Array) -> Point:
    """Return the end or the middle of the edge, whichever has the least quadric error; the middle on flat ground."""
    slack = 1e-3 * _area(quadric) * _square(x, u, v)
    best = ((x[u, 0] + x[v, 0]) / 2, (x[u, 1] + x[v, 1]) / 2, (x[u, 2] + x[v, 2]) / 2)
    least = _error(best, quadric)
    for w in (u, v):
        end = (x[w, 0], x[w, 1], x[w, 2])
        error = _error(end, quadric) + slack
        if error < least:
            best, least = end, error
    return best


@njit(cache=True)
def _error(p: Point, q: Array) -> float:
    """(p, 1)ᵀ Q (p, 1)."""
    return (
        p[0] * (q[0] * p[0] + 2 * (q[1] * p[1] + q[2] * p[2] + q[3]))
        + p[1] * (q[4] * p[1] + 2 * (q[5] * p[2] + q[6]))
        + p[2] * (q[7] * p[2] + 2 * q[8])
        + q[9]
    )


@njit(cache=True)
def _area(quadric: Array) -> float:
    """Of the triangles in a quadric: Σ_f A_f |n_f|²."""
    return quadric[0] + quadric[4] + quadric[7]


@njit(cache=True)
def _turns(
    u: int,
    v: int,
    position: Point,
    x: Array,
    faces: Ints,
    alive: NDArray[np.bool_],
    first: NDArray[np.int64],
    following: NDArray[np.int64],
) -> bool:
    """Return whether moving u to `position` turns or flattens a triangle of u that does not vanish with edge u v."""
    corner: int = first[u]
    while corner >= 0:
        f = corner // 3
        p, q = faces[f, (corner + 1) % 3], faces[f, (corner + 2) % 3]
        if alive[f] and p != v and q != v:
            a0, a1, a2 = _normal(x, p, q, x[u, 0], x[u, 1], x[u, 2])
            b0, b1, b2 = _normal(x, p, q, position[0], position[1], position[2])
            after = b0 * b0 + b1 * b1 + b2 * b2
            before = a0 * a0 + a1 * a1 + a2 * a2
            if after == 0 or a0 * b0 + a1 * b1 + a2 * b2 < LARGEST_TURN * np.sqrt(before * after):
                return True
        corner = following[corner]
    return False
