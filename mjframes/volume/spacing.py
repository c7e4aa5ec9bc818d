"""The edges of the voxels: what may be given for them, and how many cells a grid around a body then has."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjframes.base.constants import MOST_CELLS
from mjframes.base.errors import MjframesError
from mjframes.base.memory import available_memory
from mjframes.base.numbers import is_whole

VOXELS = 20_000  # inside, unless given: built in seconds, and with some across every limb
CELL = 8  # [bytes] of a cell while it is found inside or outside


def three_lengths(name: str, value: ArrayLike) -> NDArray[np.float64]:
    """Return lengths (3,) [m] of one number or three. name: what an error starts with.

    Raise MjframesError for other values.
    """
    try:
        lengths = np.array(np.broadcast_to(np.asarray(value, np.float64), 3))
    except (TypeError, ValueError):
        lengths = np.full(3, np.nan)
    if not (np.isfinite(lengths).all() and (lengths > 0).all()):
        raise MjframesError(f"{name} is {value!r}; it must be one or three positive lengths in metres.")
    return lengths


def spacing_or_voxels(spacing: ArrayLike | None, voxels: int | None) -> tuple[NDArray[np.float64] | None, int]:
    """Return spacing (3,) [m] or None, and how many voxels are wanted inside in that case, VOXELS unless given.

    Raise MjframesError where both are given, and for values that cannot be.
    """
    if spacing is not None and voxels is not None:
        raise MjframesError(f"spacing is {spacing!r} and voxels is {voxels!r}; give exactly one of them.")
    count = VOXELS if voxels is None else voxels
    require_voxels(count)
    return None if spacing is None else three_lengths("spacing", spacing), int(count)


def require_voxels(voxels: object) -> None:
    """Raise MjframesError for what is no number of voxels."""
    if not (is_whole(voxels) and voxels >= 1):
        raise MjframesError(f"voxels is {voxels!r}; it must be a whole number from 1 on.")


def require_room(cells: NDArray[np.float64], spacing: NDArray[np.float64]) -> tuple[int, int, int]:
    """Return cells (3,) along the axes as numbers. Raise MjframesError for more than a grid or the memory can hold."""
    count, lengths = float(np.prod(cells)), cells * spacing
    if count > MOST_CELLS:
        least = float(np.prod(lengths) / MOST_CELLS) ** (1 / 3)
        raise MjframesError(
            f"spacing is {spacing.tolist()} m, which makes {count:.1e} cells of a body of "
            f"{np.array2string(lengths, precision=3)} m; take more than {least:.1g} m, or correct the body's size."
        )
    if (needed := CELL * count) > (available := available_memory()):
        raise MjframesError(
            f"spacing is {spacing.tolist()} m, which makes {count:.1e} cells: these take about "
            f"{needed / 1e9:.1f} GB, but {available / 1e9:.1f} GB of memory are free; take a spacing of "
            f"{float(np.max(spacing)) * 1.1 * (needed / available) ** (1 / 3):.2g} m or more, or --voxels."
        )
    nx, ny, nz = cells.astype(int).tolist()
    return nx, ny, nz
