"""The map of all runs: bodies across, disturbances down, in each field Young's modulus across and time steps down."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from benchmarks.stability.check.cases import DISTURBANCES, KINDS, STEPS, YOUNG
from benchmarks.stability.check.reasons import LETTERS, reason
from benchmarks.stability.check.trial import Outcome
from mjframes.base.errors import MjframesError

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.colors import Colormap
    from matplotlib.figure import Figure

CALM, SHARP = 1.05, 10.0  # [-] gains of energy told apart
STATES = {  # colour
    f"recovers, energy × {CALM:g} at most": "#2e8b57",
    f"recovers, energy × {SHARP:g} at most": "#a5d46a",
    "recovers after a larger gain": "#f2c14e",
    "survives, does not recover": "#5b7db1",
    "does not survive": "#c0392b",
}
NOT_RUN = "#ececec"
RESOLUTION = 120  # [dots per inch]
POWERS = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")


def draw(outcomes: Sequence[Outcome], title: str, path: Path) -> None:
    """Draw the map of the outcomes as a picture. Raise MjframesError without matplotlib."""
    try:
        from matplotlib.colors import ListedColormap
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MjframesError(
            'the map needs matplotlib, which is not installed; pip install "mjframes[plot]".'
        ) from error
    fields: dict[tuple[str, str], list[Outcome]] = {}
    for o in outcomes:
        fields.setdefault((o.case.kind.name, o.case.disturbance), []).append(o)
    kinds = [kind.name for kind in KINDS if any(name == kind.name for name, _ in fields)]
    disturbances = [name for name in DISTURBANCES if any(other == name for _, other in fields)]
    steps = [h for h in STEPS if any(o.case.timestep == h for o in outcomes)]
    young = [e for e in YOUNG if any(o.case.young == e for o in outcomes)]
    figure = Figure(figsize=(2.2 + 1.35 * len(kinds), 2.6 + 0.9 * len(disturbances)), layout="constrained")
    grid = figure.subplots(len(disturbances), len(kinds), squeeze=False, sharex=True, sharey=True)
    colours = ListedColormap(list(STATES.values())).with_extremes(bad=NOT_RUN)
    for row, disturbance in zip(grid, disturbances, strict=True):
        for axes, kind in zip(row, kinds, strict=True):
            _field(axes, fields.get((kind, disturbance), []), steps, young, colours)
        row[0].set_ylabel(_broken(disturbance, "at ", "× "), fontsize=10, rotation=0, ha="right", va="center")
        row[0].set_yticks(range(len(steps)), [f"{h * 1e3:.3g} ms" for h in steps], fontsize=8)
    for axes, kind in zip(grid[0], kinds, strict=True):
        axes.set_title(_broken(kind, "frames", "1 :", "neo-"), fontsize=10)
    for axes in grid[-1]:
        axes.set_xticks(range(len(young)), list(map(_power, young)), fontsize=8)
    below = "Young's modulus [Pa], of the softer half where there are two"
    grid[-1][len(kinds) // 2].set_xlabel(below, fontsize=10)
    figure.suptitle(title, fontsize=13)
    _legend(figure, outcomes, wide=len(kinds) > 8)
    figure.savefig(path, dpi=RESOLUTION)


def _field(
    axes: Axes, outcomes: Sequence[Outcome], steps: Sequence[float], young: Sequence[float], colours: Colormap
) -> None:
    field = np.full((len(steps), len(young)), np.nan)
    for o in outcomes:
        down, across = steps.index(o.case.timestep), young.index(o.case.young)
        field[down, across] = _state(o)
        if not o.recovers:
            letter = LETTERS[reason(o).kind]
            axes.text(across, down, letter, color="white", fontsize=8, weight="bold", ha="center", va="center")
    axes.imshow(field, cmap=colours, vmin=-0.5, vmax=len(STATES) - 0.5, aspect="auto")
    axes.set_xticks(np.arange(len(young) + 1) - 0.5, minor=True)
    axes.set_yticks(np.arange(len(steps) + 1) - 0.5, minor=True)
    axes.grid(which="minor", color="white", linewidth=1)
    axes.tick_params(which="both", length=0)
    for side in axes.spines.values():
        side.set_visible(False)


def _legend(figure: Figure, outcomes: Sequence[Outcome], wide: bool) -> None:
    """Colours, and the letters that occur."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    keys: list[Artist] = [Patch(color=colour, label=state) for state, colour in STATES.items()]
    keys.append(Patch(color=NOT_RUN, label="not run"))
    found = {reason(o).kind for o in outcomes if not o.recovers}
    for kind, letter in LETTERS.items():
        if kind in found:
            words = kind.partition(":")[0]
            keys.append(Line2D([], [], color="black", marker=f"${letter}$", linestyle="", label=words))
    figure.legend(handles=keys, loc="outside lower center", ncols=7 if wide else 2, fontsize=9, frameon=False)


def _state(outcome: Outcome) -> int:
    """Place in STATES."""
    if not outcome.survives:
        return 4
    if not outcome.recovers:
        return 3
    return 0 if outcome.gain < CALM else 1 if outcome.gain < SHARP else 2


def _broken(name: str, *before: str) -> str:
    """Lines that start with these words."""
    for word in before:
        name = name.replace(f" {word}", f"\n{word}")
    return name.replace(",\n", "\n").replace(", ", "\n")


def _power(young: float) -> str:
    return "1" if young == 1 else "10" + str(round(np.log10(young))).translate(POWERS)
