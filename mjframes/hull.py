"""The convex hull of a set of voxels: flesh around bones that an image shows alone.

With the hull's facets n · p + d ≤ 0, a column (a, b) lies in it for c from max over n_c < 0 to min over n_c > 0 of
−(d + n_a a + n_b b) / n_c, if the facets with n_c = 0 allow it. Convexity does not depend on spacing and axes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

ROUNDING = 1e-6  # [voxels] by which a centre may miss a facet that it spans


def in_convex_hull(inside: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Where a voxel's centre lies in the convex hull of the centres of those `inside`, (nx, ny, nz) both.

    Without a body in three dimensions there is no hull, and the answer is `inside`.
    """
    columns = np.argwhere(inside.any(axis=2))
    rows = inside[tuple(columns.T)]
    first, last = rows.argmax(axis=1), rows.shape[1] - 1 - rows[:, ::-1].argmax(axis=1)
    ends = np.concatenate([np.column_stack([columns, c]) for c in (first, last)])
    try:
        normal, offset = np.split(ConvexHull(ends).equations, [3], axis=1)
    except QhullError:
        return inside.copy()
    offset -= ROUNDING
    up, down = normal[:, 2] > ROUNDING, normal[:, 2] < -ROUNDING
    upright = ~(up | down)
    result = np.zeros_like(inside)
    b, c = np.arange(inside.shape[1])[:, None], np.arange(inside.shape[2])
    for a in range(int(columns[0, 0]), int(columns[-1, 0]) + 1):
        level = offset[:, 0] + normal[:, 0] * a + normal[:, 1] * b  # (b, facets)
        high = (-level[:, up] / normal[up, 2]).min(axis=1)
        low = (-level[:, down] / normal[down, 2]).max(axis=1)
        allowed = (level[:, upright] <= 0).all(axis=1)
        result[a] = allowed[:, None] & (c >= low[:, None]) & (c <= high[:, None])
    return result
