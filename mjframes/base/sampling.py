"""Farthest-point sampling: each point is the one farthest from all that are chosen before it (Gonzalez, 1985)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray


def farthest_points(
    points: NDArray[np.floating], first: Sequence[int] | NDArray[np.integer], count: int
) -> NDArray[np.int64]:
    """Return the places of at most `count` different points of (s, d): `first`, then always the farthest from those."""
    chosen = [int(place) for place in first[:count]]
    square = np.full(len(points), np.inf)
    for k in range(min(count, len(points))):
        if k == len(chosen):
            farthest = int(square.argmax())
            if square[farthest] == 0:
                break
            chosen.append(farthest)
        offset = points - points[chosen[k]]
        np.minimum(square, np.einsum("sd,sd->s", offset, offset), out=square)
    return np.array(chosen, np.int64)
