"""The convex hull of a set of voxels: flesh around bones that an image shows alone.

With the hull's facets n · p + d ≤ 0, a column (a, b) lies in it for c from max over n_c < 0 to min over n_c > 0 of
−(d + n_a a + n_b b) / n_c, each attained by the facets in whose shadow along c the column is; columns in no shadow lie
beside the hull. Convexity does not depend on spacing and axes. scikit-image's convex_hull_image compares all voxels
with all facets: 50 times as long for 40³ voxels, and more beyond.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

ROUNDING = 1e-6  # [voxels] by which a centre may miss a facet that it spans


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
    _cap(ends[hull.simplices], hull.equations, high, low)
    low[np.isinf(high)] = np.inf  # columns beside the hull
    result = np.zeros_like(inside)
    c = np.arange(inside.shape[2])
    for a in range(int(columns[0, 0]), int(columns[-1, 0]) + 1):
        result[a] = (c >= low[a, :, None]) & (c <= high[a, :, None])
    return result


@njit(cache=True)
def _cap(
    corners: NDArray[np.integer], planes: NDArray[np.float64], high: NDArray[np.float64], low: NDArray[np.float64]
) -> None:
    """Let each triangle (3, 3) of the hull end the columns in its shadow, edges included: whole numbers, so exactly.

    high, low: (nx, ny) the hull's ends along z.  planes: (t, 4) normal and offset.
    """
    for t in range(len(corners)):
        (ax, ay, _), (bx, by, _), (cx, cy, _) = corners[t]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area == 0:
            continue
        sign = 1 if area > 0 else -1
        n = planes[t]
        for x in range(min(ax, bx, cx), max(ax, bx, cx) + 1):
            for y in range(min(ay, by, cy), max(ay, by, cy) + 1):
                if (
                    sign * ((bx - ax) * (y - ay) - (by - ay) * (x - ax)) < 0
                    or sign * ((cx - bx) * (y - by) - (cy - by) * (x - bx)) < 0
                    or sign * ((ax - cx) * (y - cy) - (ay - cy) * (x - cx)) < 0
                ):
                    continue
                z = -(n[3] - ROUNDING + n[0] * x + n[1] * y) / n[2]
                if n[2] > 0:
                    high[x, y] = min(high[x, y], z)
                else:
                    low[x, y] = max(low[x, y], z)
