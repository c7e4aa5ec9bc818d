"""Colours of values and of numbers, and the keys that explain them."""

from __future__ import annotations

import colorsys
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mjframes.app.pictures.page import Key, Place

if TYPE_CHECKING:
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure
    from matplotlib.ticker import Formatter

Color = tuple[float, float, float, float] | NDArray[np.float64]
Legend = Sequence[tuple[str, Color]]  # names and their colours

ROW, LETTER = 0.21, 0.075  # [inch] of a legend
NOTHING = (0.86, 0.86, 0.86, 1.0)  # where a field has no value
NO_COLOR = (0.0, 0.0, 0.0, 0.0)  # of lines in a legend that are only text


def categorical(count: int) -> NDArray[np.float64]:
    """Return colours (count, 4), those of near numbers far apart: hues by the golden ratio, in three lightnesses."""
    hue = (0.58 + 0.618034 * np.arange(count)) % 1
    value = np.array([0.88, 0.68, 0.97])[np.arange(count) % 3]
    saturation = np.array([0.62, 0.72, 0.38])[np.arange(count) % 3]
    return np.array([(*colorsys.hsv_to_rgb(h, s, v), 1.0) for h, s, v in zip(hue, saturation, value, strict=True)])


def graded(values: NDArray[np.float64], norm: Normalize, scheme: str) -> NDArray[np.float64]:
    """Return the colours (n, 4) of values (n,)."""
    import matplotlib

    return np.asarray(matplotlib.colormaps[scheme](norm(values)))


def color_bar(
    norm: Normalize,
    scheme: str,
    label: str,
    legend: Legend = (),
    *,
    ticks: Sequence[float] | None = None,
    form: Formatter | None = None,
) -> Key:
    """Return a key with a bar of colours and, beside it, names of single colours. ticks, form: of the bar's scale."""

    def draw(figure: Figure, place: Place) -> None:
        from matplotlib.cm import ScalarMappable

        left, bottom, width, height = place
        w, h = figure.get_size_inches()
        if wide := width > 2 * height:
            bar, rest = (left, bottom + height / 2, 3.0, 0.2), (left + 3.5, bottom, width - 3.5, height)
        else:
            tall = min(height, 3.0)
            bar, rest = (left, bottom + (height - tall) / 2, 0.2, tall), (left + 1.1, bottom, width - 1.1, height)
        axes = figure.add_axes((bar[0] / w, bar[1] / h, bar[2] / w, bar[3] / h))
        way = "horizontal" if wide else "vertical"
        drawn = figure.colorbar(ScalarMappable(norm, scheme), cax=axes, orientation=way, ticks=ticks, format=form)
        drawn.minorticks_off()
        drawn.set_label(label, size=9)
        drawn.ax.tick_params(labelsize=8)
        draw_legend(figure, rest, legend)

    return draw


def name_list(legend: Legend) -> Key:
    """Return a key that only names colours."""

    def draw(figure: Figure, place: Place) -> None:
        draw_legend(figure, place, legend)

    return draw


def draw_legend(figure: Figure, place: Place, legend: Legend) -> None:
    """Draw names and their colours, as many as the place has room for."""
    from matplotlib.colors import to_hex
    from matplotlib.lines import Line2D

    if not legend:
        return
    left, bottom, width, height = place
    w, h = figure.get_size_inches()
    rows = max(1, int(height / ROW))
    column = 0.45 + LETTER * max(len(name) for name, _ in legend)
    columns = max(1, min(int(width / column), -(-len(legend) // rows)))
    shown = list(legend)
    if len(shown) > rows * columns:
        shown = [*shown[: rows * columns - 1], (f"… {len(legend)} in all", NO_COLOR)]
    colors = [to_hex(tuple(color), keep_alpha=True) for _, color in shown]
    edges = ["0.3" if color[3] else "none" for _, color in shown]
    handles = [
        Line2D([], [], linestyle="", marker="s", markersize=9, color=color, markeredgecolor=edge)
        for color, edge in zip(colors, edges, strict=True)
    ]
    figure.legend(
        handles,
        [name for name, _ in shown],
        loc="center left",
        bbox_to_anchor=(left / w, (bottom + height / 2) / h),
        ncols=columns,
        fontsize=8.5,
        frameon=False,
        borderaxespad=0,
        handletextpad=0.4,
    )
