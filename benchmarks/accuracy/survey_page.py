"""The part of the report's page that judges what users get, and its table of all numbers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np

from benchmarks.accuracy.survey import PROMISED_FRAMES, Judged, Verdict
from benchmarks.solids.bodies import PUSHED
from benchmarks.tables import markdown_table, write_table
from mjframes.base.choices import PAPER, WHOLE_BODY

GROWTH = 1.2  # [-] more error than with fewer frames, that is promised not to be exceeded
SHARES = [f"{share:.0%}" for share in PUSHED]
HEADER = (
    *("body", "method", "frames", "dofs", "weight", "end"),
    *(f"push {share}" for share in SHARES),
    *("static_same_mesh", "frequency", "estimate_weight", "estimate_pushes", "step_seconds", "build_seconds"),
)


def write_survey_csv(path: Path, verdicts: Sequence[Verdict]) -> None:
    """Write every row of every body."""
    write_table(path, HEADER, [_values(row) for verdict in verdicts for row in verdict.rows])


def _values(row: Judged) -> tuple[object, ...]:
    kinds = ("weight", "end", *(f"push {share}" for share in SHARES))
    errors = (row.errors.get(kind, "") for kind in kinds)
    estimate = ("" if np.isnan(value) else value for value in row.estimate)
    return (
        *(row.body, row.method, row.frames, row.dofs, *errors),
        *(row.same_mesh, row.frequency, *estimate, row.step_seconds, row.build_seconds),
    )


def survey_page(verdicts: Sequence[Verdict]) -> Iterable[str]:
    """Yield the lines."""
    yield from ("", "## Bodies nobody tuned, with the default settings", "")
    yield (
        "Frames are where `build` places them, all settings are its defaults. Static: the worst of the own weight "
        "along each axis and of forces on an end, in steps of `mj_step` to rest; pushes: the worst of two places; both "
        "in L2 over all voxels, dents included, against bricks of order 2. Mesh: what finite elements on the voxels "
        "themselves (Wilson's) are off by. Frequencies: the worst of the first five. Bounds are for the static error "
        f"at {PROMISED_FRAMES} frames. Growth: the most by which more frames are worse than fewer."
    )
    frames = sorted({row.frames for verdict in verdicts for row in verdict.rows})
    numbers = "/".join(map(str, frames))
    yield ""
    yield from markdown_table(
        ["body", f"static [%], {numbers} frames", "the paper's method", "mesh", "bound", "", "growth"],
        [
            (
                verdict.body.title,
                _row_of(verdict, WHOLE_BODY, frames, lambda row: row.static),
                _row_of(verdict, PAPER, frames, lambda row: row.static),
                f"{100 * verdict.mesh:.1f}",
                f"{100 * verdict.body.bound:.0f} %{' of the same mesh' if verdict.body.same_mesh else ''}",
                _promise(verdict),
                f"{verdict.growth:.2f}{'' if verdict.growth <= GROWTH else ' **more**'}",
            )
            for verdict in verdicts
        ],
    )
    yield from ("", "Errors under pushes and of frequencies, default settings, in percent:", "")
    yield from markdown_table(
        [
            "body",
            *(f"pushes on {share}" for share in reversed(SHARES)),
            "frequencies",
            "`body.error`: weight",
            "pushes",
        ],
        [
            (
                verdict.body.title,
                *(_row_of(verdict, WHOLE_BODY, frames, lambda row, s=share: row.push(s)) for share in reversed(SHARES)),
                _row_of(verdict, WHOLE_BODY, frames, lambda row: row.frequency, "+.1f"),
                _row_of(verdict, WHOLE_BODY, frames, lambda row: row.estimate[0]),
                _row_of(verdict, WHOLE_BODY, frames, lambda row: row.estimate[1]),
            )
            for verdict in verdicts
        ],
    )
    for name, words in (
        ("time", "time a step"),
        ("dofs", "degrees of freedom"),
        ("build", "time of the precomputation"),
    ):
        yield from ("", f"![static error against {words}](survey_{name}.png)")
    refused = [(verdict.body.title, *entry) for verdict in verdicts for entry in verdict.refused]
    yield ""
    yield from (f"- left out: {title}, {method}, {count} frames: {reason}" for title, method, count, reason in refused)


def _row_of(
    verdict: Verdict, method: str, frames: Sequence[int], value: Callable[[Judged], float], form: str = ".1f"
) -> str:
    found = {row.frames: value(row) for row in verdict.of(method)}
    shown = (found.get(count, np.nan) for count in frames)
    return " / ".join("–" if np.isnan(number) else format(100 * number, form) for number in shown)


def _promise(verdict: Verdict) -> str:
    if verdict.promised is None:
        return ""
    error, load, holds = verdict.promised
    return f"{100 * error:.1f} %, {load}: {'holds' if holds else '**does not hold**'}"
