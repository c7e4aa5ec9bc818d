"""What the benchmark found: a table to print, a CSV of every run, and a picture of the worst of each body."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from itertools import groupby
from pathlib import Path

import numpy as np
from rich.table import Table

from mjframes.base.errors import MjframesError
from mjframes.base.files import replacing
from mjframes.benchmarks.energy.loops import KINDS
from mjframes.benchmarks.energy.motions import LIMIT, MOTIONS
from mjframes.benchmarks.energy.trial import GAIN, LOOP, MADE, REST, RETURN, Row

OTHERS = (
    *("total", "motion", "turned", "moved_J", "mismatch", "doubt", "order"),
    *("drift_2ms", "drift_1ms", "drift_0.5ms", "drift_0.25ms"),
)
HEADER = (
    *("body", "voxels", "frames", "young_Pa", "poisson", "ratio", "law", "method"),
    *("measure", "case", "timestep_s", "run", "value", "limit", "passes", *OTHERS),
)
SMALLEST, LARGEST = 1e-9, 1e6  # [-] of the picture's colours
RESOLUTION = 120  # [dots per inch]


def table(rows: Sequence[Row]) -> Table:
    """Return a table with a line for each body: the worst of each motion, with its step in ms and run."""
    shown = Table(title="Energy from nothing, to what moves", title_justify="left", box=None, pad_edge=False)
    columns = ("frames", "E [Pa]", *MOTIONS, "loops", MADE, "return", "rests")
    shown.add_column("")
    for column in columns:
        shown.add_column(column, justify="right")
    for label, some in groupby(rows, lambda row: row.subject.label):
        own = list(some)
        subject = own[0].subject
        gains = [_worst([row for row in own if row.measure == GAIN and row.case == name]) for name in MOTIONS]
        others = [_worst([row for row in own if row.measure == measure]) for measure in (LOOP, MADE)]
        back = [row.passes for row in own if row.measure == RETURN]
        rests = ["yes" if row.passes else "no" for row in own if row.measure == REST]
        ends = (f"{sum(back)}/{len(back)}", *rests)
        shown.add_row(label, str(subject.frames), f"{subject.young:.1e}", *gains, *others, *ends)
    return shown


def summary(rows: Sequence[Row]) -> list[str]:
    """Return lines on all bodies together."""
    lines = []
    for measure, what in (
        (GAIN, f"runs gain more than {LIMIT:g} of what moves"),
        (LOOP, "closed loops do work"),
        (MADE, "runs make energy at the shortest step"),
        (RETURN, "starts do not return to the shape of rest"),
        (REST, "damped bodies do not come to rest"),
    ):
        own = [row for row in rows if row.measure == measure]
        wrong = [row for row in own if not row.passes]
        bodies = len({row.subject.label for row in wrong})
        if own:
            lines.append(f"{len(wrong)} of {len(own)} {what}, of {bodies} bodies.")
    turning = [row for row in rows if row.measure == GAIN and row.passes and row.others["total"] > LIMIT]
    if turning:
        worst = max(turning, key=lambda row: row.others["total"])
        lines.append(
            f"{len(turning)} runs only seem to gain: a step's turn stretches stiff bodies, and that goes with the turn; "
            f"at most {worst.others['total']:.2g} ({_place(worst)})."
        )
    wrong = [row for row in rows if row.measure == GAIN and not row.passes]
    lines += [f"- {_place(row)}: {row.value:.2g}" for row in sorted(wrong, key=lambda row: -row.value)[:12]]
    return lines


def write(rows: Sequence[Row], folder: Path) -> list[Path]:
    """Write energy.csv and energy.png. Raise MjframesError where one cannot be written."""
    paths = [folder / "energy.csv", folder / "energy.png"]
    with replacing(paths[0], "the table") as partial, partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(HEADER)
        writer.writerows(_line(row) for row in rows)
    with replacing(paths[1], "the picture") as partial:
        _draw(rows, partial)
    return paths


def _line(row: Row) -> list[str]:
    subject = row.subject
    what = (f"{subject.young:.4g}", f"{subject.poisson:.3g}", f"{subject.ratio:g}", subject.law, subject.method)
    others = ["" if name not in row.others else f"{row.others[name]:.4g}" for name in OTHERS]
    numbers = (f"{row.timestep:g}", str(row.number), f"{row.value:.4g}", f"{row.limit:g}", str(int(row.passes)))
    return [subject.name, str(row.voxels), str(subject.frames), *what, row.measure, row.case, *numbers, *others]


def _worst(rows: Sequence[Row]) -> str:
    if not rows:
        return "–"
    worst = max(rows, key=lambda row: row.value)
    if worst.passes:
        return "ok"
    return f"{worst.value:.1e}" + (f" @{worst.timestep * 1e3:g}:{worst.number}" if worst.timestep else f" {worst.case}")


def _place(row: Row) -> str:
    return f"{row.subject.label}, {row.case}, h = {row.timestep * 1e3:g} ms, run {row.number}"


def _draw(rows: Iterable[Row], path: Path) -> None:
    try:
        from matplotlib.colors import LogNorm
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MjframesError(
            'the picture needs matplotlib, which is not installed; pip install "mjframes[plot]".'
        ) from error
    columns = [(GAIN, name) for name in MOTIONS] + [(LOOP, kind) for kind in KINDS]
    bodies = {row.subject.label: i for i, row in enumerate({row.subject.label: row for row in rows}.values())}
    worst = np.full((len(bodies), len(columns)), np.nan)
    for row in rows:
        if (row.measure, row.case) in columns:
            at = bodies[row.subject.label], columns.index((row.measure, row.case))
            worst[at] = np.fmax(worst[at], np.clip(row.value, SMALLEST, LARGEST))
    figure = Figure(figsize=(7, 1.6 + 0.17 * max(len(bodies), 8)), layout="constrained")
    axes = figure.subplots()
    image = axes.imshow(worst, norm=LogNorm(SMALLEST, LARGEST), cmap="RdYlGn_r", aspect="auto")
    axes.set_xticks(range(len(columns)), [case if kind == GAIN else f"loop, {case}" for kind, case in columns])
    axes.tick_params(axis="x", rotation=40, labelsize=8)
    axes.set_yticks(range(len(bodies)), list(bodies), fontsize=7)
    axes.set_title("Worst energy from nothing, to what moves [-]", fontsize=10)
    figure.colorbar(image, ax=axes)
    figure.savefig(path, dpi=RESOLUTION)
