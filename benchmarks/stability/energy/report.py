"""What the benchmark found: a table to print, a CSV of every run, and a picture of the worst of each body."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.table import Table

from benchmarks.stability.energy.loops import KINDS
from benchmarks.stability.energy.loops import LIMIT as LOOP_LIMIT
from benchmarks.stability.energy.motions import LIMIT, MOTIONS
from benchmarks.stability.energy.trial import GAIN, LOOP, MADE, REST, RETURN, Found, Number
from mjframes.base.errors import MjframesError
from mjframes.base.files import replacing

OTHERS = (
    *("total", "motion", "turned", "moved_J", "mismatch", "doubt", "order"),
    *("drift_2ms", "drift_1ms", "drift_0.5ms", "drift_0.25ms"),
)
HEADER = (
    *("body", "voxels", "frames", "young_Pa", "poisson", "ratio", "law", "method"),
    *("measure", "case", "timestep_s", "run", "value", "limit", "passes", *OTHERS),
)
VERDICTS = {
    GAIN: f"runs gain more than {LIMIT:g} of what moves",
    LOOP: "closed loops do work, or may, as their quadrature is in doubt",
    MADE: "runs make energy at the shortest step",
    RETURN: "starts do not return to the shape of rest",
    REST: "damped bodies do not come to rest",
}
SHOWN = 12  # of the worst runs
SMALLEST, LARGEST = 1e-9, 1e6  # [-] of the picture's colours
RESOLUTION = 120  # [dots per inch]


def table(found: Sequence[Found]) -> Table:
    """Return a table with a line for each body: the worst of each motion, with its step in ms and run."""
    shown = Table(title="Energy from nothing, to what moves", title_justify="left", box=None, pad_edge=False)
    shown.add_column("")
    for column in ("frames", "E [Pa]", *MOTIONS, "loops", MADE, "return", "rests"):
        shown.add_column(column, justify="right")
    for body in found:
        gains = [_worst(body.of(GAIN, name)) for name in MOTIONS]
        back = [number.passes for number in body.of(RETURN)]
        ends = (f"{sum(back)}/{len(back)}", *("yes" if number.passes else "no" for number in body.of(REST)))
        first = (body.subject.label, str(body.subject.frames), f"{body.subject.young:.1e}")
        shown.add_row(*first, *gains, _worst(body.of(LOOP)), _worst(body.of(MADE)), *ends)
    return shown


def summary(found: Sequence[Found]) -> list[str]:
    """Return lines on all bodies together."""
    lines = []
    for measure, what in VERDICTS.items():
        wrong = [sum(not number.passes for number in body.of(measure)) for body in found]
        if total := sum(len(body.of(measure)) for body in found):
            lines.append(f"{sum(wrong)} of {total} {what}, of {np.count_nonzero(wrong)} bodies.")
    doubts = [number.others["doubt"] for body in found for number in body.of(LOOP)]
    if unknown := sum(doubt > LOOP_LIMIT for doubt in doubts):
        lines.append(
            f"{unknown} of {len(doubts)} loops are known to {max(doubts):.1g} or better only, not to {LOOP_LIMIT:g}."
        )
    gains = [(body, number) for body in found for number in body.of(GAIN)]
    turning = [some for some in gains if some[1].passes and some[1].others["total"] > LIMIT]
    if turning:
        body, worst = max(turning, key=lambda some: some[1].others["total"])
        lines.append(
            f"{len(turning)} runs only seem to gain: a step's turn stretches stiff bodies, which goes with the turn; "
            f"at most {worst.others['total']:.2g} ({_place(body, worst)})."
        )
    wrong = sorted((some for some in gains if not some[1].passes), key=lambda some: -some[1].value)
    return lines + [f"- {_place(body, number)}: {number.value:.2g}" for body, number in wrong[:SHOWN]]


def write(found: Sequence[Found], folder: Path) -> list[Path]:
    """Write energy.csv and energy.png. Raise MjframesError where one cannot be written."""
    paths = [folder / "energy.csv", folder / "energy.png"]
    with replacing(paths[0], "the table") as partial, partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(HEADER)
        writer.writerows(_line(body, number) for body in found for number in body.numbers)
    with replacing(paths[1], "the picture") as partial:
        _draw(found, partial)
    return paths


def _line(body: Found, number: Number) -> list[str]:
    subject = body.subject
    what = (f"{subject.young:.4g}", f"{subject.poisson:.3g}", f"{subject.ratio:g}", subject.law, subject.method)
    others = ["" if name not in number.others else f"{number.others[name]:.4g}" for name in OTHERS]
    values = (f"{number.timestep:g}", number.run, f"{number.value:.4g}", f"{number.limit:g}", int(number.passes))
    first = (subject.name, body.voxels, subject.frames, *what, number.measure, number.case)
    return [str(some) for some in (*first, *values, *others)]


def _worst(numbers: Sequence[Number]) -> str:
    if not numbers:
        return "–"
    worst = max(numbers, key=lambda number: number.value)
    if worst.passes:
        return "ok"
    return f"{worst.value:.1e} " + (f"@{worst.timestep * 1e3:g}:{worst.run}" if worst.timestep else worst.case)


def _place(body: Found, number: Number) -> str:
    return f"{body.subject.label}, {number.case}, h = {number.timestep * 1e3:g} ms, run {number.run}"


def _draw(found: Sequence[Found], path: Path) -> None:
    try:
        from matplotlib.colors import LogNorm
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MjframesError(
            'the picture needs matplotlib, which is not installed; pip install "mjframes[plot]".'
        ) from error
    columns = [(GAIN, name) for name in MOTIONS] + [(LOOP, kind) for kind in KINDS]
    values = [[max((n.value for n in body.of(*column)), default=np.nan) for column in columns] for body in found]
    worst = np.clip(np.array(values).reshape(len(found), len(columns)), SMALLEST, LARGEST)
    figure = Figure(figsize=(7, 1.6 + 0.17 * max(len(found), 8)), layout="constrained")
    axes = figure.subplots()
    image = axes.imshow(worst, norm=LogNorm(SMALLEST, LARGEST), cmap="RdYlGn_r", aspect="auto")
    axes.set_xticks(range(len(columns)), [case if kind == GAIN else f"loop, {case}" for kind, case in columns])
    axes.tick_params(axis="x", rotation=40, labelsize=8)
    axes.set_yticks(range(len(found)), [body.subject.label for body in found], fontsize=7)
    axes.set_title("Worst energy from nothing, to what moves [-]", fontsize=10)
    figure.colorbar(image, ax=axes)
    figure.savefig(path, dpi=RESOLUTION)
