"""What the runs gave: a table to print, the same in Markdown with every failure's reason, a CSV, and the map."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.table import Table

from mjframes.check.cases import DISTURBANCES, FREE, KINDS, STEPS, YOUNG, Case
from mjframes.check.reasons import reason
from mjframes.check.trial import Outcome
from mjframes.errors import MjframesError
from mjframes.files import replacing

if TYPE_CHECKING:
    from matplotlib.axes import Axes

CALM, SHARP = 1.05, 10.0  # [-] gains that the map tells apart
COLUMNS = ("runs", "survive", "recover", "gain, free", "gain, loaded", "of motion")
HEADER = (
    *("body", "young_Pa", "timestep_s", "disturbance", "survives", "recovers"),
    *("gain", "gain_of_motion", "shape_error", "warning", "reason"),
)
STATES = {  # of the map: colour
    f"returns, energy gain below {CALM:g}": "#2e8b57",
    f"returns, energy gain below {SHARP:g}": "#a5d46a",
    "returns after a larger gain": "#f2c14e",
    "does not return": "#5b7db1",
    "does not survive": "#c0392b",
}
RESOLUTION = 110  # [dots per inch]


def table(outcomes: Sequence[Outcome]) -> Table:
    """A line for each body."""
    shown = Table(title="Stability", title_justify="left", box=None, pad_edge=False)
    shown.add_column("")
    for column in COLUMNS:
        shown.add_column(column, justify="right")
    for row in _rows(outcomes):
        shown.add_row(*row)
    return shown


def summary(outcomes: Sequence[Outcome]) -> str:
    """One line."""
    survive, recover = sum(o.survives for o in outcomes), sum(o.recovers for o in outcomes)
    return f"{len(outcomes)} runs: {survive} survive, {recover} recover their shape of rest."


def failures(outcomes: Iterable[Outcome]) -> list[str]:
    """The reasons why runs do not survive or recover, each with what it concerns."""
    found: dict[str, list[Case]] = {}
    for outcome in outcomes:
        if not outcome.recovers:
            found.setdefault(reason(outcome), []).append(outcome.case)
    lines = []
    for why, concerned in found.items():
        names = {name: list(some) for name, some in groupby(concerned, lambda case: case.kind.name)}
        runs = "; ".join(f"{name}: {', '.join(map(_place, some))}" for name, some in names.items())
        lines.append(f"{len(concerned)} {'run' if len(concerned) == 1 else 'runs'}: {why} ({runs})")
    return lines


def write(outcomes: Sequence[Outcome], folder: Path) -> list[Path]:
    """stability.csv, stability.md and stability.png. Raises MjframesError where one cannot be written."""
    paths = [folder / f"stability.{ending}" for ending in ("csv", "md", "png")]
    with replacing(paths[0], "the table") as partial:
        _write_csv(outcomes, partial)
    with replacing(paths[1], "the table") as partial:
        partial.write_text(_markdown(outcomes), encoding="utf-8")
    with replacing(paths[2], "the map") as partial:
        _draw(outcomes, partial)
    return paths


def _rows(outcomes: Sequence[Outcome]) -> list[list[str]]:
    rows = []
    for name, group in groupby(outcomes, lambda outcome: outcome.case.kind.name):
        some = list(group)
        free = [o.gain for o in some if o.case.disturbance in FREE]
        loaded = [o.gain for o in some if o.case.disturbance not in FREE]
        rows.append(
            [
                name,
                str(len(some)),
                str(sum(o.survives for o in some)),
                str(sum(o.recovers for o in some)),
                _number(max(free, default=np.nan)),
                _number(max(loaded, default=np.nan)),
                _number(max(o.motion for o in some)),
            ]
        )
    return rows


def _markdown(outcomes: Sequence[Outcome]) -> str:
    lines = ["# Stability", "", summary(outcomes), "", NOTES, ""]
    lines += [f"| body | {' | '.join(COLUMNS)} |", f"|---|{'---:|' * len(COLUMNS)}"]
    lines += [f"| {' | '.join(row)} |" for row in _rows(outcomes)]
    lines += ["", "![map](stability.png)", "", "## What does not survive or recover", ""]
    lines += [f"- {line}" for line in failures(outcomes)] or ["Nothing."]
    return "\n".join(lines) + "\n"


NOTES = f"""\
A free bar of 6 × 3 × 3 mm with three frames, Young's modulus E = {YOUNG[0]:g} … {YOUNG[-1]:.0e} Pa, steps
h = {STEPS[0] * 1e3:g} ms … 1/30 s. Control points start scrambled by up to one length of the bar, mirrored with noise,
at −x, stretched ten times or flattened to a thousandth; or the bar meets a floor at 34 m/s, which is 10⁴ g if one
length stops it, or lies under a free box of 10⁴ or 10⁻⁴ × its mass. A run survives without NaN, without a warning of
MuJoCo and within 10 km; it recovers if, relieved and damped, its surface comes within 2 % of a length of that at rest.
Gains are the largest energy of the undamped part to that of the start; *of motion* is what of it is not elastic.
A step moves points straight along the tangent, so that one that turns a body by an angle φ stretches it by φ²/2: in a
stiff one that is much elastic energy after an impact, which later steps take away and do not turn into motion.
For point frames on a line −x is half a turn, with hardly any energy to compare with."""


def _write_csv(outcomes: Sequence[Outcome], path: Path) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(HEADER)
        for o in outcomes:
            case, why = o.case, "" if o.recovers else reason(o)
            numbers = (f"{value:.4g}" for value in (o.gain, o.motion, o.error))
            place = (case.kind.name, f"{case.young:g}", f"{case.timestep:.6g}", case.disturbance)
            writer.writerow([*place, int(o.survives), int(o.recovers), *numbers, o.warning, why])


def _draw(outcomes: Sequence[Outcome], path: Path) -> None:
    """Bodies across, disturbances down, in each field E across and h down."""
    try:
        from matplotlib.colors import ListedColormap
        from matplotlib.figure import Figure
        from matplotlib.patches import Patch
    except ImportError as error:
        raise MjframesError(
            'the map needs matplotlib, which is not installed; pip install "mjframes[plot]".'
        ) from error
    states = list(STATES)
    fields = {(o.case.kind.name, o.case.disturbance): np.full((len(STEPS), len(YOUNG)), np.nan) for o in outcomes}
    for o in outcomes:
        place = STEPS.index(o.case.timestep), YOUNG.index(o.case.young)
        fields[o.case.kind.name, o.case.disturbance][place] = states.index(_state(o))
    kinds = [kind.name for kind in KINDS if any(name == kind.name for name, _ in fields)]
    disturbances = [name for name in DISTURBANCES if any(other == name for _, other in fields)]
    figure = Figure(figsize=(1.4 + 1.25 * len(kinds), 1.8 + 0.85 * len(disturbances)), layout="constrained")
    grid = figure.subplots(len(disturbances), len(kinds), squeeze=False, sharex=True, sharey=True)
    colours = ListedColormap(list(STATES.values()))
    for row, disturbance in zip(grid, disturbances, strict=True):
        for axes, kind in zip(row, kinds, strict=True):
            field = fields.get((kind, disturbance), np.full((len(STEPS), len(YOUNG)), np.nan))
            axes.imshow(field, cmap=colours, vmin=-0.5, vmax=len(states) - 0.5, aspect="auto")
            _cross(axes)
        row[0].set_ylabel(disturbance.replace(" × ", " ×\n").replace(" at ", "\nat "), fontsize=8)
        row[0].set_yticks(range(len(STEPS)), [f"{h * 1e3:.3g}" for h in STEPS], fontsize=7)
    for axes, kind in zip(grid[0], kinds, strict=True):
        axes.set_title(kind.replace(", ", "\n").replace(" frames", "\nframes").replace(" 1 :", "\n1 :"), fontsize=8)
    for axes in grid[-1]:
        axes.set_xticks(range(len(YOUNG)), [f"{np.log10(e):.0f}" for e in YOUNG], fontsize=7)
    below = "log₁₀ of Young's modulus [Pa], of the softer half where there are two"
    grid[-1][len(kinds) // 2].set_xlabel(below, fontsize=9)
    figure.supylabel("time step [ms]", fontsize=9)
    figure.suptitle(summary(outcomes), fontsize=11)
    keys = [Patch(color=colour, label=state) for state, colour in STATES.items()]
    figure.legend(
        handles=keys, loc="outside lower center", ncols=len(keys) if len(kinds) > 8 else 2, fontsize=8, frameon=False
    )
    figure.savefig(path, dpi=RESOLUTION)


def _cross(axes: Axes) -> None:
    """Lines between the fields' cells."""
    axes.set_xticks(np.arange(len(YOUNG) + 1) - 0.5, minor=True)
    axes.set_yticks(np.arange(len(STEPS) + 1) - 0.5, minor=True)
    axes.grid(which="minor", color="white", linewidth=1)
    axes.tick_params(which="both", length=0)
    for side in axes.spines.values():
        side.set_visible(False)


def _state(outcome: Outcome) -> str:
    states = list(STATES)
    if not outcome.survives:
        return states[4]
    if not outcome.recovers:
        return states[3]
    return states[0] if outcome.gain < CALM else states[1] if outcome.gain < SHARP else states[2]


def _place(case: Case) -> str:
    return f"{case.disturbance}, {case.young:g} Pa, {case.timestep * 1e3:.3g} ms"


def _number(value: float) -> str:
    return "–" if np.isnan(value) else f"{value:.3g}"
