"""The report's figures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from benchmarks.accuracy.measures import Outcome, Row, front
from benchmarks.accuracy.survey import Judged, Verdict
from benchmarks.accuracy.vibration import LOST, PERIODS, Vibration
from mjframes.base.choices import PAPER, WHOLE_BODY
from mjframes.base.files import replacing

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = NDArray[np.float64]

RESOLUTION = 110  # [dots per inch]
COLUMNS = 4  # of small figures
SWING = 1.5  # [-] of the first deflection that is shown
STYLES = {  # beginning of a family: colour, marker
    "affine, by hand": ("tab:pink", "*"),
    "affine": ("tab:blue", "o"),
    "rigid": ("tab:cyan", "s"),
    "quadratic": ("tab:purple", "D"),
    "paper's method": ("0.3", "x"),
    "flex full": ("tab:red", "^"),
    "flex trilinear": ("tab:orange", "v"),
    "flex quadratic": ("tab:green", "P"),
}


def style(family: str) -> tuple[str, str]:
    return next(value for beginning, value in STYLES.items() if family.startswith(beginning))


def draw_scatter(path: Path, outcomes: Sequence[Outcome], value: Callable[[Row], float], label: str) -> None:
    """Draw errors of every contender against a value of it, one small figure a case; lines join what nothing beats."""
    from matplotlib.figure import Figure

    figure, panels = _panels(Figure, len(outcomes))
    seen: dict[str, object] = {}
    for axes, outcome in zip(panels, outcomes, strict=False):
        for row in outcome.rows:
            color, marker = style(row.family)
            handle = axes.scatter(value(row), 100 * row.error, s=22, marker=marker, linewidths=1, color=color)
            seen.setdefault(_legend(row), handle)
        for kind, color in (("mjframes", "tab:blue"), ("flex", "tab:orange")):
            best = front([row for row in outcome.rows if row.rival == kind], value)
            axes.plot([value(r) for r in best], [100 * r.error for r in best], color=color, linewidth=1, alpha=0.6)
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_ylim(None, 200)
        _title(axes, outcome.case.title)
    for axes in panels:
        axes.set_xlabel(label, fontsize="small")
    figure.supylabel("relative L2 error of the displacements [%]", fontsize="medium")
    figure.legend(list(seen.values()), list(seen), loc="outside lower center", ncols=4, fontsize="small")
    _save(path, figure)


def draw_survey(path: Path, verdicts: Sequence[Verdict], value: Callable[[Judged], float], label: str) -> None:
    """Draw errors of the defaults, of the static loads and of pushes, and of the paper's method against a value."""
    from matplotlib.figure import Figure

    curves: tuple[tuple[str, str, Callable[[Verdict, Judged], float], str, str], ...] = (
        ("defaults, weight and ends", WHOLE_BODY, lambda verdict, row: verdict.bounded(row), "tab:blue", "o"),
        ("defaults, pushes on 5 %", WHOLE_BODY, lambda _, row: row.push("5%"), "tab:green", "s"),
        ("the paper's method, weight and ends", PAPER, lambda verdict, row: verdict.bounded(row), "0.4", "x"),
    )
    figure, panels = _panels(Figure, len(verdicts))
    seen: dict[str, object] = {}
    for axes, verdict in zip(panels, verdicts, strict=True):
        for name, method, error, color, marker in curves:
            rows = verdict.of(method)
            across, up = [value(row) for row in rows], [100 * error(verdict, row) for row in rows]
            seen[name] = axes.plot(across, up, color=color, marker=marker, markersize=4, linewidth=1)[0]
        bound = 100 * verdict.body.bound
        seen["bound at 5 frames"] = axes.axhline(bound, color="tab:red", linewidth=0.8, linestyle=":")
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_ylim(0.3, 200)
        axes.set_xlabel(label, fontsize="small")
        _title(axes, verdict.body.title + (", against the same mesh" if verdict.body.same_mesh else ""))
    figure.supylabel("relative L2 error of the displacements, worst load [%]", fontsize="medium")
    figure.legend(list(seen.values()), list(seen), loc="outside lower center", ncols=4, fontsize="small")
    _save(path, figure)


def _legend(row: Row) -> str:
    return row.family if row.kind == "flex" or row.family.startswith("paper") else f"mjframes {row.family}"


def draw_vibration(path: Path, found: Sequence[Vibration], first: float, exact: Array) -> None:
    """Draw the quantity of interest after release, over the periods of the first mode [Hz]."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 5.5), layout="constrained")
    for axes, kind in zip(figure.subplots(1, 2, sharey=True), ("mjframes", "flex"), strict=True):
        start = exact[0]
        axes.plot(np.linspace(0, PERIODS, len(exact)), exact / start, color="0.4", linewidth=2, label="finite elements")
        for one in found:
            if one.kind == kind:
                history = np.array(one.history)
                error = f"{100 * one.error:+.1f} %" if one.left < LOST else "lost"
                label = f"{one.family}, {one.name}: {error}"
                axes.plot(np.linspace(0, PERIODS, len(history)), history / start, linewidth=0.8, label=label)
        axes.set_xlabel(f"periods of {first:.2f} Hz")
        axes.set_ylim(-SWING, SWING)
        axes.legend(fontsize=6, loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=2, frameon=False)
        _title(axes, f"{kind}: tip after release; relative error of the frequency")
    _save(path, figure)


def _panels(figure_type: Callable, count: int) -> tuple:
    columns = min(COLUMNS, count)
    rows = -(-count // columns)
    figure = figure_type(figsize=(3.6 * columns, 2.9 * rows + 0.8), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes in panels[count:]:
        axes.set_visible(False)
    return figure, panels[:count]


def _title(axes: Axes, text: str) -> None:
    axes.set_title(text, fontsize="small", loc="left", wrap=True)
    axes.grid(alpha=0.3, which="both", linewidth=0.4)
    axes.tick_params(which="major", labelsize=7)
    axes.tick_params(which="minor", labelsize=5)


def _save(path: Path, figure) -> None:
    with replacing(path, "the plot") as partial:
        figure.savefig(partial, dpi=RESOLUTION)
