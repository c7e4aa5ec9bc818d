"""Places of triangles: nearest to points, and samples of them, among which the nearest triangle is looked for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SampleRows:
    """Rows of samples along the longest edges of triangles.

    corners: (m, 3, 3) [m], of which the first two are the ends of the longest edge.
    along, across: (m,) how many steps there are along that edge, and to the third corner.
    """

    corners: Array
    along: NDArray[np.int64]
    across: NDArray[np.int64]

    @property
    def larger(self) -> int:
        """Return how many samples triangles have that are larger than a step."""
        some = self.along > 1
        return int(np.sum((self.along[some] + 1.0) * (self.across[some] + 1.0)))

    def samples(self) -> tuple[Array, NDArray[np.int64]]:
        """Return the samples (n, 3) and the triangle (n,) of each: the middle of one that is smaller than a step."""
        small = np.flatnonzero(self.along <= 1)
        found, owner = [self.corners[small].mean(axis=1)], [small]
        larger = np.flatnonzero(self.along > 1)
        steps = np.stack([self.along[larger], self.across[larger]], axis=1)
        kinds, kind = np.unique(steps, axis=0, return_inverse=True)
        for number, (n, m) in enumerate(kinds.tolist()):
            some = larger[kind.ravel() == number]
            a, b, c = self.corners[some].transpose(1, 0, 2)[:, :, None]
            v = np.repeat(np.arange(m + 1) / m, [-(-n * (m - k) // m) + 1 for k in range(m + 1)])[:, None]
            first = np.concatenate([np.linspace(0, 1, -(-n * (m - k) // m) + 1) for k in range(m + 1)])[:, None]
            found.append(((1 - v) * ((1 - first) * a + first * b) + v * c).reshape(-1, 3))
            owner.append(np.repeat(some, len(v)))
        return np.concatenate(found), np.concatenate(owner)


def rows_of_samples(corners: Array, spacing: float) -> SampleRows:
    """Return rows of samples of triangles (m, 3, 3), `spacing` [m] apart or less."""
    edges = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
    first = np.argmax(edges, axis=1)
    turned = np.take_along_axis(corners, ((first[:, None] + np.arange(3)) % 3)[:, :, None], axis=1)
    longest = edges[np.arange(len(edges)), first]
    a, b, c = turned.transpose(1, 0, 2)
    height = np.linalg.norm(np.cross(b - a, c - a), axis=1) / longest
    along, across = (np.ceil(np.clip(some / spacing, 1, 1e9)).astype(np.int64) for some in (longest, height))
    return SampleRows(turned, along, across)


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
