"""What the runs gave: a table to print, the same in Markdown with every failure's reason, a CSV, and the map."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from itertools import groupby
from pathlib import Path

import numpy as np
from rich.table import Table

from benchmarks.stability.check.cases import FREE, STEPS, YOUNG, Case
from benchmarks.stability.check.map import draw
from benchmarks.stability.check.reasons import Reason, reason
from benchmarks.stability.check.trial import Outcome
from mjframes.base.files import replacing

COLUMNS = ("runs", "survive", "recover", "gain, free", "gain, loaded", "of motion")
HEADER = (
    *("body", "young_Pa", "timestep_s", "disturbance", "survives", "recovers"),
    *("gain", "gain_of_motion", "shape_error", "warning", "reason", "measured"),
)


def table(outcomes: Sequence[Outcome]) -> Table:
    """Return a table with a line for each body."""
    shown = Table(title="Stability", title_justify="left", box=None, pad_edge=False)
    shown.add_column("")
    for column in COLUMNS:
        shown.add_column(column, justify="right")
    for row in _rows(outcomes):
        shown.add_row(*row)
    return shown


def summary(outcomes: Sequence[Outcome]) -> str:
    """Return one line on all outcomes."""
    survive, recover = sum(o.survives for o in outcomes), sum(o.recovers for o in outcomes)
    return f"{len(outcomes)} runs: {survive} survive, {recover} recover their shape of rest."


def failures(outcomes: Iterable[Outcome]) -> dict[str, list[tuple[Case, str]]]:
    """Return the runs that do not survive or recover, by kind of reason, each with what was measured of it."""
    found: dict[str, list[tuple[Case, str]]] = {}
    for outcome in outcomes:
        if not outcome.recovers:
            why = reason(outcome)
            found.setdefault(why.kind, []).append((outcome.case, why.numbers))
    return found


def heading(kind: str, runs: Sequence[object]) -> str:
    """Return the heading of the failures of one kind."""
    return f"{len(runs)} {'run' if len(runs) == 1 else 'runs'}: {kind}"


def write(outcomes: Sequence[Outcome], folder: Path) -> list[Path]:
    """Write stability.csv, stability.md and stability.png. Raise MjframesError where one cannot be written."""
    paths = [folder / f"stability.{ending}" for ending in ("csv", "md", "png")]
    with replacing(paths[0], "the table") as partial:
        _write_csv(outcomes, partial)
    with replacing(paths[1], "the table") as partial:
        partial.write_text(_markdown(outcomes), encoding="utf-8")
    with replacing(paths[2], "the map") as partial:
        draw(outcomes, summary(outcomes), partial)
    return paths


def _rows(outcomes: Sequence[Outcome]) -> list[list[str]]:
    """Of each body, and of all."""
    bodies = groupby(outcomes, lambda outcome: outcome.case.kind.name)
    return [*(_row(name, list(some)) for name, some in bodies), _row("all", outcomes)]


def _row(name: str, outcomes: Sequence[Outcome]) -> list[str]:
    free = [o.gain for o in outcomes if o.case.disturbance in FREE]
    loaded = [o.gain for o in outcomes if o.case.disturbance not in FREE]
    return [
        name,
        str(len(outcomes)),
        str(sum(o.survives for o in outcomes)),
        str(sum(o.recovers for o in outcomes)),
        _number(max(free, default=np.nan)),
        _number(max(loaded, default=np.nan)),
        _number(max(o.motion for o in outcomes)),
    ]


def _markdown(outcomes: Sequence[Outcome]) -> str:
    lines = ["# Stability", "", summary(outcomes), "", NOTES, ""]
    lines += [f"| body | {' | '.join(COLUMNS)} |", f"|---|{'---:|' * len(COLUMNS)}"]
    lines += [f"| {' | '.join(row)} |" for row in _rows(outcomes)]
    lines += ["", "![map](stability.png)", "", "## What does not survive or recover", ""]
    for kind, runs in failures(outcomes).items():
        lines += [
            f"### {heading(kind, runs)}",
            "",
            "| body | E [Pa] | h [ms] | start | measured |",
            "|---|---:|---:|---|---|",
        ]
        lines += [f"| {' | '.join(_place(case))} | {numbers} |" for case, numbers in runs]
        lines.append("")
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
For point frames on a line −x is half a turn, with hardly any energy to compare with.
MuJoCo's integrator Euler holds gyroscopic torques over a step: at half a radian a step a free body of three different
moments is lost in 65 steps, with no soft body near; `implicit` knows their slope. Where none is named it is Euler.
Hyperelastic laws see F at quadrature points alone: between those of quadratic frames voxels can stay inside out."""


def _write_csv(outcomes: Sequence[Outcome], path: Path) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(HEADER)
        for o in outcomes:
            case, why = o.case, Reason("", "") if o.recovers else reason(o)
            numbers = (f"{value:.4g}" for value in (o.gain, o.motion, o.error))
            place = (case.kind.name, f"{case.young:g}", f"{case.timestep:.6g}", case.disturbance)
            writer.writerow([*place, int(o.survives), int(o.recovers), *numbers, o.warning, why.kind, why.numbers])


def _place(case: Case) -> tuple[str, str, str, str]:
    return case.kind.name, f"{case.young:g}", f"{case.timestep * 1e3:.3g}", case.disturbance


def _number(value: float) -> str:
    return "–" if np.isnan(value) else f"{value:.3g}"
