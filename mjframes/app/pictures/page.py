"""One page a field: the surface from two sides, three slices at one scale, and a key.

The slices stand as in a technical drawing: that across the thinnest axis, and beside and below it the two in which it
is seen from the side.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mjframes.app.pictures.keys import Bar, Legend, draw_key
from mjframes.app.pictures.slices import MM, axis_name, axis_order, bounds, directions, draw_cut
from mjframes.app.pictures.surface import DrawnSurface, draw_surface
from mjframes.volume.grid import Grid

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH, HEIGHT = 15.0, 8.2  # [inch]
RESOLUTION = 120  # [dots per inch] 1800 pixels wide
COLUMNS = (5.0, 6.2, 2.4)  # of the page's width: views, slices, key
NEAR = 3  # [voxels] from a slice within which points are drawn on it
RIM = 0.02  # [-] of the largest extent: space around the slices


@dataclass(frozen=True, eq=False)
class Marks:
    """Points, drawn through the surface and on the slices they are near to.

    at: (m, 3) volume coordinates [m].
    colors: (m, 4).
    size: of each dot [points].
    numbers: (m,) to write into them, or None.
    """

    at: NDArray[np.float64]
    colors: NDArray[np.float64]
    size: float
    numbers: NDArray[np.integer] | None = None


@dataclass(frozen=True, eq=False)
class Picture:
    """A field on n voxels.

    name: of the file.
    colors: (n, 4).
    through: (3,) the voxel index where the slices cut.
    legend, bar: what the colours mean.
    lines: (n,) numbers, with dark lines where they change.
    contours: a field (n,) and levels.
    """

    name: str
    title: str
    colors: NDArray[np.float64]
    through: NDArray[np.integer]
    legend: Legend = ()
    bar: Bar | None = None
    lines: NDArray[np.integer] | None = None
    contours: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None
    marks: tuple[Marks, ...] = field(default=())


def draw_page(figure: Figure, picture: Picture, grid: Grid, surface: DrawnSurface, caption: str) -> None:
    """Draw a picture on an empty figure of WIDTH × HEIGHT."""
    draw_title(figure, picture.title, caption)
    columns = figure.add_gridspec(1, 3, width_ratios=COLUMNS, left=0.01, right=0.99, bottom=0.07, top=0.86, wspace=0.14)
    views = columns[0].subgridspec(2, 1, hspace=0.08)
    for number in range(2):
        axes: Any = figure.add_subplot(views[number], projection="3d", computed_zorder=False)
        draw_surface(axes, surface, picture.colors, back=bool(number))
        for some in picture.marks:
            _draw_marks(axes, MM * some.at, some)
    order, size = axis_order(grid), np.abs(np.diff(bounds(grid), axis=0)[0])
    thin = min(reversed(order), key=lambda a: round(size[a], 6))  # of equal axes the last
    right, up = (a for a in order if a != thin)
    size += 2 * RIM * size.max()
    slices = columns[1].subgridspec(
        2, 2, width_ratios=size[[right, thin]], height_ratios=size[[up, thin]], wspace=0.25, hspace=0.3
    )
    for place, along in (((0, 0), (right, up)), ((0, 1), (thin, up)), ((1, 0), (right, thin))):
        _draw_slice(figure.add_subplot(slices[place]), picture, grid, *along)
    draw_key(figure.add_subplot(columns[2]), picture.legend, picture.bar)


def draw_title(figure: Figure, title: str, caption: str) -> None:
    """Draw the two lines at the top of every page."""
    figure.text(0.25 / WIDTH, 1 - 0.33 / HEIGHT, title, size=15, weight="bold", va="center")
    figure.text(0.25 / WIDTH, 1 - 0.6 / HEIGHT, caption, size=9, color="0.35", va="center")


def _draw_slice(axes: Axes, picture: Picture, grid: Grid, right: int, up: int) -> None:
    across = 3 - right - up
    turned, names = directions(grid), [axis_name(grid, a) for a in range(3)]
    number = int(picture.through[across])
    draw_cut(axes, grid, right, up, number, picture.colors, picture.lines, picture.contours)
    level = float((grid.origin + (number + 0.5) * grid.spacing[across] * grid.axes[:, across]) @ turned[:, across])
    for some in picture.marks:
        places = some.at @ turned
        near = np.abs(places[:, across] - level) <= NEAR * grid.spacing[across]
        _draw_marks(axes, MM * places[:, [right, up]], some, near)
    axes.set_title(f"{names[across]} = {round(MM * level, 1) + 0.0:.1f} mm", size=9, loc="left", pad=4)
    axes.set_xlabel(f"{names[right]} [mm]", size=8, labelpad=1)
    axes.set_ylabel(f"{names[up]} [mm]", size=8, labelpad=1)
    axes.tick_params(labelsize=7, length=2)
    low, high = np.sort(bounds(grid), axis=0)
    rim = RIM * (high - low).max()
    axes.set_xlim(low[right] - rim, high[right] + rim)
    axes.set_ylim(low[up] - rim, high[up] + rim)
    axes.set_aspect("equal")
    share = (high - low) / (high - low).max()
    axes.locator_params("x", nbins=max(2, round(7 * share[right])))
    axes.locator_params("y", nbins=max(2, round(7 * share[up])))
    axes.spines[["top", "right"]].set_visible(False)


def _draw_marks(axes: Any, at: NDArray[np.float64], marks: Marks, shown: NDArray[np.bool_] | None = None) -> None:
    """Draw those of the marks that are shown, all unless given, at their places (m, 2) or (m, 3) [mm]."""
    chosen = np.flatnonzero(np.ones(len(at), bool) if shown is None else shown)
    flat = {"depthshade": False} if at.shape[1] == 3 else {}
    for k in chosen:  # one after the other, so that each covers those before
        axes.scatter(
            *at[k], s=marks.size**2, color=marks.colors[k], edgecolors="white", linewidths=0.8, zorder=3, **flat
        )
        if marks.numbers is not None:
            axes.text(
                *at[k], str(marks.numbers[k]), size=0.62 * marks.size, color="white", ha="center",
                va="center_baseline", zorder=3,
            )  # fmt: skip
