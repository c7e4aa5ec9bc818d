"""Solids bounded by triangles, for scenes: their MJCF and, by brute force, their signed distance."""

from __future__ import annotations

import numpy as np
from scipy.spatial import ConvexHull

POLYHEDRON = np.array(  # [m] no two of its faces are parallel
    [
        [0.07, 0.01, -0.03],
        [-0.06, 0.03, -0.035],
        [0.01, -0.07, -0.03],
        [0.02, 0.06, -0.02],
        [0.03, 0.02, 0.05],
        [-0.03, -0.01, 0.04],
        [0.0, 0.0, 0.01],
        [-0.02, -0.05, 0.02],
    ]
)
TERRAIN = (0.24, 0.2, 0.06, 0.05)  # half sizes, height and depth of the base [m]
ELEVATION = np.random.default_rng(3).permutation(48).reshape(6, 8) / 64  # exact in single precision
ELEVATION.flat[0] = 1


def numbers(values: np.ndarray) -> str:
    return " ".join(map(repr, np.ravel(values).tolist()))


MESH = f'<asset><mesh name="stone" vertex="{numbers(POLYHEDRON)}" inertia="convex"/></asset>'
HEIGHT_FIELD = (
    f'<asset><hfield name="hills" nrow="6" ncol="8" size="{numbers(np.array(TERRAIN))}" '
    f'elevation="{numbers(ELEVATION[::-1])}"/></asset>'  # MJCF lists the rows from the back
)


def triangle_distance(p: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Distance of each of p (n, 3) to the nearest of triangles (t, 3, 3)."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    normal = np.cross(b - a, c - a)
    best = np.full(len(p), np.inf)
    inside = np.ones((len(p), len(a)), bool)
    for start, end in ((a, b), (b, c), (c, a)):
        edge, offset = end - start, p[:, None] - start
        inside &= np.einsum("ntc,tc->nt", offset, np.cross(normal, edge)) >= 0
        t = np.clip(np.einsum("ntc,tc->nt", offset, edge) / (edge**2).sum(axis=1), 0, 1)
        best = np.minimum(best, np.linalg.norm(offset - t[..., None] * edge, axis=2).min(axis=1))
    height = np.abs(np.einsum("ntc,tc->nt", p[:, None] - a, normal)) / np.linalg.norm(normal, axis=1)
    return np.minimum(best, np.where(inside, height, np.inf).min(axis=1))


def polyhedron_distance(p: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    """Signed distance of p (…, 3) to the convex hull of vertices (v, 3)."""
    hull = ConvexHull(vertices)
    flat = p.reshape(-1, 3)
    above = (flat @ hull.equations[:, :3].T + hull.equations[:, 3]).max(axis=1)
    distance = triangle_distance(flat, vertices[hull.simplices])
    return np.where(above > 0, distance, above).reshape(p.shape[:-1])


def terrain_triangles() -> np.ndarray:
    """(t, 3, 3) the surface of the height field."""
    x, y = np.linspace(-TERRAIN[0], TERRAIN[0], 8), np.linspace(-TERRAIN[1], TERRAIN[1], 6)
    corner = np.stack([*np.meshgrid(x, y), TERRAIN[2] * ELEVATION], axis=-1)
    near, right, back, far = corner[:-1, :-1], corner[:-1, 1:], corner[1:, :-1], corner[1:, 1:]
    return np.concatenate(
        [np.stack(corners, axis=2).reshape(-1, 3, 3) for corners in ((near, right, far), (near, far, back))]
    )


def terrain_distance(p: np.ndarray) -> np.ndarray:
    """Signed distance of p (…, 3) to the height field, walls and base included."""
    flat, triangles = p.reshape(-1, 3), terrain_triangles()
    sx, sy, _, base = TERRAIN
    surface = triangle_distance(flat, triangles)
    level = np.array([terrain_height(x, y) for x, y in np.clip(flat[:, :2], [-sx, -sy], [sx, sy])])
    nearest = np.stack(
        [np.clip(flat[:, 0], -sx, sx), np.clip(flat[:, 1], -sy, sy), np.clip(flat[:, 2], -base, level)], axis=1
    )
    outside = np.linalg.norm(flat - nearest, axis=1)
    walls = np.minimum.reduce([sx - np.abs(flat[:, 0]), sy - np.abs(flat[:, 1]), flat[:, 2] + base, surface])
    return np.where(outside > 0, np.minimum(outside, surface), -walls).reshape(p.shape[:-1])


def terrain_height(x: float, y: float) -> float:
    """z of the triangle above or below a point."""
    for a, b, c in terrain_triangles():
        weights = np.linalg.solve(np.array([[*a[:2], 1], [*b[:2], 1], [*c[:2], 1]]).T, [x, y, 1])
        if (weights >= -1e-12).all():
            return float(weights @ [a[2], b[2], c[2]])
    raise AssertionError("outside the height field")
