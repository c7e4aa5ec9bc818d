"""What the benchmark found: a table to print, and a CSV of every run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.table import Table

from benchmarks.stability.energy.loops import LIMIT as LOOP_LIMIT
from benchmarks.stability.energy.motions import LIMIT, MOTIONS
from benchmarks.stability.energy.trial import GAIN, LOOP, MADE, REST, RETURN, Found, Number
from benchmarks.tables import table_of, write_table

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


def table(found: Sequence[Found]) -> Table:
    """Return a table with a line for each body: the worst of each motion, with its step in ms and run."""
    columns = ("frames", "E [Pa]", *MOTIONS, "loops", MADE, "return", "rests")
    shown = table_of("Energy from nothing, to what moves", *columns)
    for body in found:
        gains = [_worst(body.of(GAIN, name)) for name in MOTIONS]
        back = [number.passes for number in body.of(RETURN)]
        still = ["yes" if number.passes else "no" for number in body.of(REST)]
        ends = (f"{sum(back)}/{len(back)}" if back else "–", *(still or ["–"]))
        first = (body.subject.label, str(body.subject.frames), f"{body.subject.young:.1e}")
        shown.add_row(*first, *gains, _worst(body.of(LOOP)), _worst(body.of(MADE)), *ends)
    return shown


def summary(found: Sequence[Found]) -> list[str]:
    """Return lines on all bodies together."""
    lines = []
    for measure, what in VERDICTS.items():
        of_bodies = [numbers for body in found if (numbers := body.of(measure))]
        wrong = [sum(not number.passes for number in numbers) for numbers in of_bodies]
        if of_bodies:
            where = f", in {np.count_nonzero(wrong)} of {len(of_bodies)} bodies" if any(wrong) else ""
            lines.append(f"{sum(wrong)} of {sum(map(len, of_bodies))} {what}{where}.")
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


def write(found: Sequence[Found], path: Path) -> None:
    """Write every number (.csv)."""
    write_table(path, HEADER, [_line(body, number) for body in found for number in body.numbers])


def _line(body: Found, number: Number) -> tuple[object, ...]:
    subject = body.subject
    what = (f"{subject.young:.4g}", f"{subject.poisson:.3g}", f"{subject.ratio:g}", subject.law, subject.method)
    others = ["" if name not in number.others else f"{number.others[name]:.4g}" for name in OTHERS]
    values = (f"{number.timestep:g}", number.run, f"{number.value:.4g}", f"{number.limit:g}", int(number.passes))
    first = (subject.name, body.voxels, subject.frames, *what, number.measure, number.case)
    return *first, *values, *others


def _worst(numbers: Sequence[Number]) -> str:
    if not numbers:
        return "–"
    worst = max(numbers, key=lambda number: number.value)
    if worst.passes:
        return "ok"
    return f"{worst.value:.1e} " + (f"@{worst.timestep * 1e3:g}:{worst.run}" if worst.timestep else worst.case)


def _place(body: Found, number: Number) -> str:
    return f"{body.subject.label}, {number.case}, h = {number.timestep * 1e3:g} ms, run {number.run}"
