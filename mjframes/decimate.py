"""Uniform decimation of a closed triangle surface by edge collapse.

A skin bends with its body, so it needs vertices on its flat parts too: the shortest edges go first, and the quadric
error Q(x) = Σ_f A_f (n_f·x + d_f)² of the triangles around an edge only chooses where its new vertex lies. An edge
collapses if exactly two vertices are adjacent to both its ends (the link condition), no triangle turns over and the
surface stays near: a closed manifold surface remains one.
"""

from __future__ import annotations

import numpy as np
from numba import njit

LARGEST_TURN = 0.8  # [-] cosine of the largest turn of a triangle in one collapse: 37 degrees
LARGEST_ERROR = 0.15  # [-] of the final edge length: root mean square distance to the planes of the old triangles
FIRST_LENGTH = 0.3  # [-] of the final edge length: the slivers of marching cubes are shorter than that
LENGTH_GROWTH = 1.12  # [-] between passes: small enough for collapses to come in order of length
PASSES = 20  # the last pass takes edges of 2.6 times the final length, by then nothing is left to collapse


def decimate(vertices: np.ndarray, faces: np.ndarray, target_vertices: int) -> tuple[np.ndarray, np.ndarray]:
    """Collapse short edges of a closed surface until `target_vertices` are left, or more where its shape needs them.

    vertices: (s, 3) [m].  faces: (t, 3) int, counter-clockwise seen from outside.  Returns new (vertices, faces).
    """
    if len(vertices) <= target_vertices:
        return vertices, faces
    x = np.array(vertices, dtype=np.float64)
    f = np.array(faces, dtype=np.int64)
    normal = np.cross(x[f[:, 1]] - x[f[:, 0]], x[f[:, 2]] - x[f[:, 0]])
    area = np.linalg.norm(normal, axis=1) / 2
    # a closed surface of s vertices has 2 s triangles: equilateral ones of area A / (2 s)
    length = np.sqrt(area.sum() / (2 * target_vertices) * 4 / np.sqrt(3))
    with np.errstate(invalid="ignore", divide="ignore"):
        unit = np.nan_to_num(normal / (2 * area[:, None]))
    plane = np.column_stack([unit, -np.einsum("fc,fc->f", unit, x[f[:, 0]])])
    quadric = np.zeros((len(x), 4, 4))
    for corner in range(3):
        np.add.at(quadric, f[:, corner], area[:, None, None] * plane[:, :, None] * plane[:, None, :])
    alive = _collapse(x, f, quadric, length, target_vertices)
    f = f[alive]
    used, inverse = np.unique(f, return_inverse=True)
    return x[used], inverse.reshape(f.shape).astype(np.int32)


@njit(cache=True)
def _collapse(x, faces, quadric, length, target):
    """Collapse edges in place; returns which faces are left."""
    alive = np.ones(len(faces), np.bool_)
    first, last = np.empty((2, len(x)), np.int64)
    following = np.empty(3 * len(faces), np.int64)
    mark = np.zeros(len(x), np.int64)
    stamp = 0
    count = len(x)
    limit = FIRST_LENGTH * length
    for _ in range(PASSES):
        left = np.flatnonzero(alive)
        _list_corners(left, faces, first, last, following)
        for f in left:
            for c in range(3):
                if count <= target:
                    return alive
                u, v = faces[f, c], faces[f, (c + 1) % 3]
                if not alive[f] or u > v:
                    continue
                edge = x[v] - x[u]
                if edge @ edge > limit * limit:
                    continue
                stamp += 2
                if _common_neighbours(u, v, faces, alive, first, following, mark, stamp) != 2:
                    continue
                joint = quadric[u] + quadric[v]
                position = _position(x[u], x[v], joint)
                if _error(position, joint) > (LARGEST_ERROR * length) ** 2 * _area(joint):
                    continue
                if _turns(u, v, position, x, faces, alive, first, following) or _turns(
                    v, u, position, x, faces, alive, first, following
                ):
                    continue
                x[u] = position
                quadric[u] = joint
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
def _list_corners(left, faces, first, last, following):
    """The corners 3 f + c around each vertex as linked lists, of the faces left; joining vertices joins their lists."""
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
def _common_neighbours(u, v, faces, alive, first, following, mark, stamp):
    """How many vertices are adjacent to both u and v."""
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
def _position(a, b, quadric):
    """The end or the middle of the edge, whichever has the least quadric error; the middle on flat ground."""
    edge = b - a
    slack = 1e-3 * _area(quadric) * (edge @ edge)
    best = (a + b) / 2
    least = _error(best, quadric)
    for end in (a, b):
        error = _error(end, quadric) + slack
        if error < least:
            best, least = end.copy(), error
    return best


@njit(cache=True)
def _error(p, quadric):
    h = np.array([p[0], p[1], p[2], 1.0])
    return h @ (quadric @ h)


@njit(cache=True)
def _area(quadric):
    """Of the triangles in a quadric: Σ_f A_f |n_f|²."""
    return quadric[0, 0] + quadric[1, 1] + quadric[2, 2]


@njit(cache=True)
def _turns(u, v, position, x, faces, alive, first, following):
    """Whether moving u to `position` turns or flattens a triangle of u that does not vanish with the edge u v."""
    corner = first[u]
    while corner >= 0:
        f = corner // 3
        p, q = faces[f, (corner + 1) % 3], faces[f, (corner + 2) % 3]
        if alive[f] and p != v and q != v:
            before = np.cross(x[p] - x[u], x[q] - x[u])
            after = np.cross(x[p] - position, x[q] - position)
            turned = before @ after < LARGEST_TURN * np.sqrt((before @ before) * (after @ after))
            if turned or after @ after == 0:
                return True
        corner = following[corner]
    return False
