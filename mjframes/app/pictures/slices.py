"""Cuts through the voxels along the axes of their image, each voxel one rectangle.

A slice is drawn in coordinates along the image's axes, turned to point the way of the nearest axis of the volume: they
are the volume's own where the image's axes lie along them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mjframes.volume.grid import Grid

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MM = 1e3  # [mm/m]

Extent = tuple[float, float, float, float]  # left, right, bottom, top [mm]


def directions(grid: Grid) -> NDArray[np.float64]:
    """Return (3, 3) the image's axes as columns, each turned to point the way of the volume's axis nearest to it."""
    nearest = np.abs(grid.axes).argmax(axis=0)
    return grid.axes * np.sign(grid.axes[nearest, np.arange(3)])


def axis_order(grid: Grid) -> list[int]:
    """Return the image's axes from the one nearest to the volume's x to the one nearest to its z."""
    return sorted(range(3), key=lambda a: (int(np.abs(grid.axes[:, a]).argmax()), a))


def axis_name(grid: Grid, axis: int) -> str:
    """Return what an axis of the image is called: "x" along the volume's, "x′" near to it."""
    place = axis_order(grid).index(axis)
    return "xyz"[place] + ("" if np.abs(grid.axes[:, axis]).max() > 1 - 1e-6 else "′")


def bounds(grid: Grid) -> NDArray[np.float64]:
    """Return coordinates (2, 3) of where the voxels begin and end in the order of their indices, on each axis [mm]."""
    ends = np.stack([grid.index.min(axis=0), grid.index.max(axis=0) + 1]) * grid.spacing
    turned = directions(grid)
    return MM * (grid.origin @ turned + ends * np.sign(np.sum(turned * grid.axes, axis=0)))


def draw_cut(
    axes: Axes,
    grid: Grid,
    right: int,
    up: int,
    number: int,
    colors: NDArray[np.float64],
    lines: NDArray[np.integer] | None,
    contours: tuple[NDArray[np.float64], NDArray[np.float64]] | None,
) -> None:
    """Draw the slice with index `number` across the third axis, of axes `right` and `up`: colors (n, 4) of the voxels.

    lines: (n,) numbers, with dark lines where they change.  contours: a field (n,) and levels.
    """
    across = 3 - right - up
    low, high = grid.index.min(axis=0), grid.index.max(axis=0) + 1
    image = grid.lookup[tuple(slice(a, b) for a, b in zip(low, high, strict=True))]
    voxel = np.take(image, number - low[across], axis=across)
    voxel = voxel.T if right < up else voxel
    inside = voxel >= 0
    first, last = bounds(grid)
    place = (first[right], last[right], first[up], last[up])
    shown = np.where(inside[..., None], colors[voxel], 0.0)
    axes.imshow(shown, origin="lower", extent=place, interpolation="nearest")
    if contours is not None:
        _draw_contours(axes, np.ma.masked_where(~inside, contours[0][voxel]), contours[1], place)
    _draw_borders(axes, np.where(inside, 0 if lines is None else lines[voxel], -1), place)


def _draw_contours(axes: Axes, values: np.ma.MaskedArray, levels: NDArray[np.float64], place: Extent) -> None:
    """Draw thin lines where values (rows, columns), at the centres of pixels, have one of the levels."""
    if min(values.shape) < 2 or not np.any((levels > values.min()) & (levels < values.max())):
        return
    left, right, bottom, top = place
    x, y = (
        low + (np.arange(n) + 0.5) * (high - low) / n
        for low, high, n in ((left, right, values.shape[1]), (bottom, top, values.shape[0]))
    )
    axes.contour(x, y, values, levels, colors="k", linewidths=0.5, alpha=0.5)


def _draw_borders(axes: Axes, group: NDArray[np.integer], place: Extent) -> None:
    """Draw lines along the edges between pixels (rows, columns) of different groups; −1 is the outside."""
    from matplotlib.collections import LineCollection

    left, right, bottom, top = place
    x, y = np.linspace(left, right, group.shape[1] + 1), np.linspace(bottom, top, group.shape[0] + 1)
    group = np.pad(group, 1, constant_values=-1)
    row, column = np.nonzero(group[1:-1, 1:] != group[1:-1, :-1])
    upright = np.stack([x[column], y[row], x[column], y[row + 1]], axis=1)
    row, column = np.nonzero(group[1:, 1:-1] != group[:-1, 1:-1])
    level = np.stack([x[column], y[row], x[column + 1], y[row]], axis=1)
    segments = np.concatenate([upright, level]).reshape(-1, 2, 2)
    axes.add_collection(LineCollection(list(segments), colors="0.1", linewidths=0.8, capstyle="projecting"))
