"""The convex hull of a set of voxels: flesh around bones that an image shows alone.

With the hull's facets n · p + d ≤ 0, a column (a, b) lies in it for c from max over n_c < 0 to min over n_c > 0 of
−(d + n_a a + n_b b) / n_c, unless it is beside a facet with n_c = 0. Convexity does not depend on spacing and axes.
scikit-image's convex_hull_image compares all voxels with all facets.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

ROUNDING = 1e-6  # [voxels] by which a centre may miss a facet that it spans
UPRIGHT = 1e-9  # [-] n_c of a facet along the columns, but for rounding


def in_convex_hull(inside: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return where a voxel's centre lies in the convex hull of the centres of those `inside`, (nx, ny, nz) both.

    Without a body in three dimensions there is no hull, and the answer is `inside`.
    """
    columns = np.argwhere(inside.any(axis=2))
    rows = inside[tuple(columns.T)]
    first, last = rows.argmax(axis=1), rows.shape[1] - 1 - rows[:, ::-1].argmax(axis=1)
    ends = np.concatenate([np.column_stack([columns, c]) for c in (first, last)])
    try:
        hull = ConvexHull(ends)
    except QhullError:
        return inside.copy()
    high, low = np.full(inside.shape[:2], np.inf), np.full(inside.shape[:2], -np.inf)
    a, b = np.ogrid[: inside.shape[0], : inside.shape[1]]
    for n_a, n_b, n_c, d in hull.equations:
        rest = d - ROUNDING + n_a * a + n_b * b
        if abs(n_c) < UPRIGHT:
            low[rest > 0] = np.inf
        elif n_c > 0:
            high = np.minimum(high, -rest / n_c)
        else:
            low = np.maximum(low, -rest / n_c)
    c = np.arange(inside.shape[2])
    return (c >= low[:, :, None]) & (c <= high[:, :, None])
