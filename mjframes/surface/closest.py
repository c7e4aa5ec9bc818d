"""Places of triangles nearest to points: exact where the nearest triangle holds a sample near the point."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def samples(a: Array, b: Array, c: Array, spacing: float) -> tuple[Array, NDArray[np.int64]]:
    """Return points (n, 3) of triangles a, b, c (m, 3), `spacing` [m] apart or less, and the triangle (n,) of each."""
    longest = np.linalg.norm([b - a, c - b, a - c], axis=2).max(axis=0)
    pieces = np.maximum(1, np.ceil(longest / spacing).astype(int))
    found, owner = [], []
    for count in np.unique(pieces):
        some = np.flatnonzero(pieces == count)
        u, v = np.array([(i, j) for i in range(count + 1) for j in range(count + 1 - i)]).T / count
        found.append(
            (a[some, None] + u[:, None] * (b - a)[some, None] + v[:, None] * (c - a)[some, None]).reshape(-1, 3)
        )
        owner.append(np.repeat(some, len(u)))
    return np.concatenate(found), np.concatenate(owner)


def closest_weights(p: Array, a: Array, b: Array, c: Array) -> Array:
    """Return barycentric coordinates (n, 3) of the points of triangles a, b, c (n, 3) that are nearest to p (n, 3)."""
    normal = np.cross(b - a, c - a)
    area = (normal**2).sum(axis=1)
    is_line, area = area == 0, np.maximum(area, 1e-300)
    inside = np.stack([(np.cross(y - x, p - x) * normal).sum(axis=1) / area for x, y in ((b, c), (c, a), (a, b))], 1)
    weights, best = inside, np.where((inside >= 0).all(axis=1) & ~is_line, 0.0, np.inf)
    for i, (x, y) in enumerate(((a, b), (b, c), (c, a))):
        edge = y - x
        t = np.clip(((p - x) * edge).sum(axis=1) / np.maximum((edge**2).sum(axis=1), 1e-300), 0, 1)
        distance = np.linalg.norm(p - x - t[:, None] * edge, axis=1)
        better = distance < best
        best = np.where(better, distance, best)
        on_edge = np.zeros((len(p), 3))
        on_edge[:, i], on_edge[:, (i + 1) % 3] = 1 - t, t
        weights = np.where(better[:, None], on_edge, weights)
    return weights
