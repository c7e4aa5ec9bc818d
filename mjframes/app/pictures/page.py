"""One page a field: the surface from two sides, three slices in their places, and a key.

The slices stand as in a technical drawing, all at one scale: that across the thinnest axis, and beside and below it the
two in which it is seen from the side.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mjframes.app.drawn import round_length
from mjframes.app.pictures.slices import (
    MM,
    axis_name,
    axis_order,
    bounds,
    directions,
    draw_contours,
    draw_cut,
    draw_radiograph,
)
from mjframes.app.pictures.views import Shot, field_image, glass, paint, radiograph
from mjframes.volume.grid import Grid

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Place = tuple[float, float, float, float]  # left, bottom, width, height [inch]
Key = Callable[["Figure", Place], None]

WIDTH, HEIGHT = 15.0, 8.2  # [inch]
RESOLUTION = 120  # [dots per inch] 1800 pixels wide
VIEW = (6.4, 3.45)  # [inch] of each view in space
LEFT, RIGHT, GAP, BELOW = 0.65, 0.75, 0.65, 0.45  # [inch] around and between the slices, for their scales
RIM = 0.03  # [-] of the largest extent: space around the slices
TOP = 1.0  # [inch] of the titles
KEY_BESIDE, KEY_BELOW = 3.2, 1.5  # [inch] width or height of the key
NEAR = 3  # [voxels] from a slice within which points are drawn on it
SOFT_GLASS, RIGID_GLASS = (0.55, 0.62, 0.72), (0.25, 0.22, 0.18)


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
    numbers: NDArray[np.integer] | None

    def among(self, chosen: NDArray[np.bool_]) -> Marks:
        """Return those of chosen (m,)."""
        numbers = None if self.numbers is None else self.numbers[chosen]
        return replace(self, at=self.at[chosen], colors=self.colors[chosen], numbers=numbers)


@dataclass(frozen=True, eq=False)
class Picture:
    """A field on n voxels.

    name: of the file.
    colors: (n, 4); empty for a body of glass.
    key: what the colours mean.
    lines: (n,) numbers, with dark lines where they change.
    contours: a field (n,) and levels.
    through: (3,) the voxel index where the slices cut.
    """

    name: str
    title: str
    colors: NDArray[np.float64] | None
    key: Key
    through: NDArray[np.integer]
    lines: NDArray[np.integer] | None = None
    contours: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None
    marks: tuple[Marks, ...] = field(default=())


def draw_page(figure: Figure, picture: Picture, grid: Grid, shots: tuple[Shot, Shot], caption: str) -> None:
    """Draw a picture on an empty figure of WIDTH × HEIGHT."""
    draw_title(figure, picture.title, caption)
    for number, shot in enumerate(shots):
        bottom = HEIGHT - 0.75 - (number + 1) * (VIEW[1] + 0.1)
        axes = _axes(figure, (0.15, bottom, *VIEW))
        axes.set_axis_off()
        _draw_view(axes, picture, grid, shot)
    slices, key = _places(grid)
    for (right, up), place in slices.items():
        _draw_slice(_axes(figure, place), picture, grid, right, up)
    picture.key(figure, key)


def draw_title(figure: Figure, title: str, caption: str) -> None:
    """Draw the two lines at the top of every page."""
    figure.text(0.25 / WIDTH, 1 - 0.33 / HEIGHT, title, size=15, weight="bold", va="center")
    figure.text(0.25 / WIDTH, 1 - 0.6 / HEIGHT, caption, size=9, color="0.35", va="center")


def _places(grid: Grid) -> tuple[dict[tuple[int, int], Place], Place]:
    """Where the slices stand, by their axes to the right and up, and the key."""
    size = np.abs(np.diff(bounds(grid), axis=0)[0])
    order = axis_order(grid)
    thin = min(reversed(order), key=lambda a: round(size[a], 6))  # of equal axes the last
    right, up = (a for a in order if a != thin)
    size = size + 2 * RIM * size.max()
    left = 0.15 + VIEW[0] + LEFT
    room = np.array([WIDTH - left - RIGHT, HEIGHT - TOP - BELOW])
    across = np.array([size[right] + size[thin], size[up] + size[thin]])
    beside, below = ((room - GAP - key) / across for key in (np.array([KEY_BESIDE, 0]), np.array([0, KEY_BELOW])))
    scale = max(beside.min(), below.min())
    x, y, z = scale * size[right], scale * size[up], scale * size[thin]
    main, low = HEIGHT - TOP - y, HEIGHT - TOP - y - GAP - z
    slices = {
        (right, up): (left, main, x, y),
        (thin, up): (left + x + GAP, main, z, y),
        (right, thin): (left, low, x, z),
    }
    if below.min() > beside.min():
        return slices, (left, low - BELOW - KEY_BELOW + 0.15, room[0], KEY_BELOW - 0.15)
    return slices, (left + x + GAP + z + 0.3, main, KEY_BESIDE - 0.3, y)


def _axes(figure: Figure, place: Place) -> Axes:
    left, bottom, width, height = place
    return figure.add_axes((left / WIDTH, bottom / HEIGHT, width / WIDTH, height / HEIGHT))


def _draw_view(axes: Axes, picture: Picture, grid: Grid, shot: Shot) -> None:
    left, right, bottom, top = (MM * value for value in shot.extent)
    place = (left, right, bottom, top)
    if picture.colors is None:
        for some, tint in ((grid.piece < 0, SOFT_GLASS), (grid.piece >= 0, RIGID_GLASS)):
            if some.any():
                axes.imshow(radiograph(shot, grid, some, tint), origin="lower", extent=place)
        axes.imshow(glass(shot), origin="lower", extent=place)
    else:
        axes.imshow(paint(shot, picture.colors, picture.lines), origin="lower", extent=place)
    if picture.contours is not None:
        field, levels = picture.contours
        draw_contours(axes, field_image(shot, grid, field), levels, place)
    for marks in picture.marks:
        _draw_marks(axes, MM * shot.camera.project(marks.at), marks)
    _draw_scale(axes, shot)
    axes.set_xlim(left, right)
    axes.set_ylim(bottom, top)


def _draw_scale(axes: Axes, shot: Shot) -> None:
    """A length and the directions of the coordinates, in the lower corners."""
    left, right, bottom, top = (MM * value for value in shot.extent)
    length = round_length((right - left) / 5)
    end, low = right - 0.02 * (right - left), bottom + 0.03 * (top - bottom)
    axes.plot([end - length, end], [low, low], color="0.2", linewidth=2, solid_capstyle="butt")
    axes.text(end - length / 2, low + 0.015 * (top - bottom), f"{length:g} mm", size=8, ha="center", va="bottom")
    arm = 0.075 * (top - bottom)
    x, y = left + 1.6 * arm, bottom + 1.4 * arm
    for direction, name, color in zip(np.eye(3), "xyz", ("#c03030", "#2e8b2e", "#3050c0"), strict=True):
        dx, dy = arm * shot.camera.project(direction[None])[0]
        axes.plot([x, x + dx], [y, y + dy], color=color, linewidth=1.5)
        axes.text(x + 1.3 * dx, y + 1.3 * dy, name, size=8, color=color, ha="center", va="center")


def _draw_slice(axes: Axes, picture: Picture, grid: Grid, right: int, up: int) -> None:
    from matplotlib.ticker import MaxNLocator

    across = 3 - right - up
    names = [axis_name(grid, a) for a in range(3)]
    turned = directions(grid)
    marks = picture.marks
    if picture.colors is None:
        for some, tint in ((grid.piece < 0, SOFT_GLASS), (grid.piece >= 0, RIGID_GLASS)):
            draw_radiograph(axes, grid, right, up, some, tint)
        title = f"seen along {names[across]}"
    else:
        number = int(picture.through[across])
        draw_cut(axes, grid, right, up, number, picture.colors, picture.lines, picture.contours)
        level = float((grid.origin + (number + 0.5) * grid.spacing[across] * grid.axes[:, across]) @ turned[:, across])
        title = f"{names[across]} = {round(MM * level, 1) + 0.0:.1f} mm".replace("-", "−")
        near = NEAR * grid.spacing[across]
        marks = tuple(m.among(np.abs(m.at @ turned[:, across] - level) <= near) for m in marks)
    for some in marks:
        _draw_marks(axes, MM * (some.at @ turned)[:, [right, up]], some)
    axes.set_title(title, size=9, loc="left", pad=4)
    axes.set_xlabel(f"{names[right]} [mm]", size=8, labelpad=1)
    axes.set_ylabel(f"{names[up]} [mm]", size=8, labelpad=1)
    axes.tick_params(labelsize=7, length=2)
    low, high = np.sort(bounds(grid), axis=0)
    rim = RIM * (high - low).max()
    axes.set_xlim(low[right] - rim, high[right] + rim)
    axes.set_ylim(low[up] - rim, high[up] + rim)
    for axis, length in ((axes.xaxis, high[right] - low[right]), (axes.yaxis, high[up] - low[up])):
        axis.set_major_locator(MaxNLocator(nbins=max(2, min(6, int(12 * length / (high - low).max())))))
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def _draw_marks(axes: Axes, flat: NDArray[np.float64], marks: Marks) -> None:
    if marks.numbers is None:
        axes.scatter(*flat.T, s=marks.size**2, c=marks.colors, edgecolors="black", linewidths=0.4, zorder=3)
        return
    for number, color, (x, y) in zip(
        marks.numbers, marks.colors, flat, strict=True
    ):  # so that each covers those before
        axes.plot(x, y, "o", markersize=marks.size, color=color, markeredgecolor="white", markeredgewidth=0.8, zorder=3)
        axes.text(x, y, str(number), size=0.62 * marks.size, color="white", ha="center", va="center_baseline", zorder=3)
