"""Colours of numbers, and the keys that explain colours."""

from __future__ import annotations

import colorsys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable
    from matplotlib.ticker import Formatter

Color = tuple[float, float, float, float] | NDArray[np.float64]
Legend = Sequence[tuple[str, Color]]  # names and their colours

MOST = 26  # rows of a legend
NOTHING = (0.86, 0.86, 0.86, 1.0)  # where a field has no value
NO_COLOR = (0.0, 0.0, 0.0, 0.0)  # of lines in a legend that are only text


@dataclass(frozen=True, eq=False)
class Bar:
    """A bar of colours: what gives a value its colour, what the values are, its marks and how these are written."""

    scheme: ScalarMappable
    label: str
    ticks: Sequence[float] | None = None
    form: Formatter | None = None


def categorical(count: int) -> NDArray[np.float64]:
    """Return colours (count, 4), those of near numbers far apart: hues by the golden ratio, in three lightnesses."""
    hue = (0.58 + 0.618034 * np.arange(count)) % 1
    value = np.array([0.88, 0.68, 0.97])[np.arange(count) % 3]
    saturation = np.array([0.62, 0.72, 0.38])[np.arange(count) % 3]
    return np.array([(*colorsys.hsv_to_rgb(h, s, v), 1.0) for h, s, v in zip(hue, saturation, value, strict=True)])


def draw_key(axes: Axes, legend: Legend, bar: Bar | None) -> None:
    """Draw names and their colours, as many as there is room for, and below them a bar of colours."""
    from matplotlib.patches import Patch

    axes.set_axis_off()
    room = MOST if bar is None else MOST // 2
    shown = list(legend) if len(legend) <= room else [*legend[: room - 1], (f"… {len(legend)} in all", NO_COLOR)]
    patches = [Patch(facecolor=tuple(c), edgecolor="0.3" if c[3] else "none", label=name) for name, c in shown]
    if patches:
        axes.legend(
            handles=patches, loc="upper left", fontsize=8, frameon=False, borderaxespad=0, handlelength=1,
            handletextpad=0.5,
        )  # fmt: skip
    if bar is not None:
        place = axes.inset_axes((0.0, 0.0, 0.1, 0.45))
        drawn = axes.figure.colorbar(bar.scheme, cax=place, ticks=bar.ticks, format=bar.form)
        drawn.minorticks_off()
        drawn.set_label(bar.label, size=9)
        drawn.ax.tick_params(labelsize=8)
