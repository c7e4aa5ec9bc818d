"""The report as a Markdown page and a table of all numbers."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path

import numpy as np

from benchmarks.accuracy.measures import Outcome, Race, Row, race, slopes
from benchmarks.accuracy.survey import Verdict
from benchmarks.accuracy.survey_page import survey_page
from benchmarks.accuracy.table2 import PAPER, Line
from benchmarks.accuracy.vibration import LOST, PERIODS, TIMESTEP, Vibration
from benchmarks.tables import markdown_table, write_table
from mjframes.base.files import replacing

FASTER, FASTER_AT_5 = 10.0, 2.0  # times faster than flex: heterogeneous cases; the homogeneous cantilever at 5 %


@dataclass(frozen=True, eq=False)
class Findings:
    """What the report measured.

    flex: MuJoCo's version there, or why there is none.
    """

    command: str
    machine: dict[str, str]
    flex: str
    verdicts: list[Verdict]
    outcomes: list[Outcome]
    vibrations: list[Vibration]
    frequency: float
    table2: list[Line]
    seconds: float


def write_csv(path: Path, outcomes: Sequence[Outcome]) -> None:
    """Write every row of every case."""
    write_table(path, [entry.name for entry in fields(Row)], [astuple(row) for some in outcomes for row in some.rows])


def write_page(path: Path, findings: Findings) -> None:
    with replacing(path, "the report") as partial:
        partial.write_text("\n".join(_page(findings)) + "\n", encoding="utf-8")


def _page(findings: Findings) -> Iterable[str]:
    yield "# mjframes against finite elements and MuJoCo's flex"
    yield ""
    minutes = f"{findings.seconds / 60:.0f} min"
    yield f"Written by `{findings.command}` in {minutes}. Every number is in `survey.csv` and `report.csv`."
    yield ""
    yield from (f"- {name}: {text}" for name, text in findings.machine.items())
    yield f"- flex: {findings.flex}"
    yield ""
    yield from survey_page(findings.verdicts)
    yield from ("", "## Beside flex, and frames placed by hand", "")
    yield (
        "Errors are relative L2 over all voxels, against finite elements on the same voxels. Frames and flex are "
        "stepped by `mj_step` from rest to equilibrium, with the largest of three time steps that comes "
        "to rest; times a "
        "step are of steps of 2 ms, in turns, medians. Flex runs with the integrator `discrete` and "
        "Newton's solver, without "
        "contact. Where stiffness varies its compiled `flex_stiffness` is replaced by that of the "
        "voxels (exact sums in cells, "
        "means in tetrahedra), which MuJoCo itself does not offer. What is named by hand "
        "has frames on the centre line with hats for weights; all others are placed by `build`, and only "
        "these are compared with flex."
    )
    races = [race(outcome.case.name, outcome.rows) for outcome in findings.outcomes]
    if any(row.kind == "flex" for outcome in findings.outcomes for row in outcome.rows):
        yield from _races(findings, races)
    yield from ("", "## Error against time a step", "", "![error against time a step](error_time.png)")
    yield from ("", "## Error against degrees of freedom", "", "![error against degrees of freedom](error_dofs.png)")
    yield from ("", "## Error against time of the precomputation", "", "![error against build time](error_build.png)")
    yield from _convergence(findings)
    yield from _references(findings)
    yield from _vibration(findings)
    yield from _table2(findings)
    yield from _cases(findings)


def _races(findings: Findings, races: Sequence[Race]) -> Iterable[str]:
    yield from ("", "## Frames against flex at the same error", "")
    yield (
        "Bound: the first of 5, 10, 20, 30 % that frames reach. Lead: seconds a step of the fastest flex that is as "
        "exact as the frames named or better, by theirs; the frames are those within the bound that lead most."
    )
    yield ""
    lines, missed = [], []
    for outcome, one in zip(findings.outcomes, races, strict=True):
        wanted = FASTER if outcome.case.heterogeneous else None
        if outcome.case.name == "cantilever":
            wanted = FASTER_AT_5
        lead = one.lead_within_bound if wanted == FASTER_AT_5 else one.lead
        verdict = "" if wanted is None else "holds" if lead >= wanted else "**does not hold**"
        if verdict.startswith("*"):
            missed.append((outcome, one, wanted))
        lines.append(
            (
                outcome.case.title,
                f"{100 * one.bound:.0f} %",
                _named(one.mine),
                _named(one.theirs) if one.mine else "",
                _times(one.lead),
                _times(one.lead_within_bound),
                f"{verdict} (≥ {wanted:g})" if wanted else "",
            )
        )
    yield from markdown_table(["case", "bound", "frames", "flex", "lead", "fastest within the bound", ""], lines)
    if missed:
        yield ""
        yield from (f"- {outcome.case.title}: {_cause(outcome, one)}" for outcome, one, _ in missed)


def _cause(outcome: Outcome, one: Race) -> str:
    """Why the lead is missed."""
    best = min((r for r in outcome.rows if r.rival == "mjframes"), key=lambda r: r.error)
    if one.mine is None:
        return (
            f"no frames come within {100 * one.bound:.0f} % (best: {best.family}, {best.name}, "
            f"{100 * best.error:.0f} %): the frames' weights, or the stiffness of their regions, do not follow it."
        )
    assert one.theirs
    return (
        f"frames within {100 * one.bound:.0f} % need {one.mine.dofs} degrees of freedom in dense chains "
        f"({1e6 * one.mine.step_seconds:.0f} µs a step), flex gets there with {one.theirs.dofs} "
        f"({1e6 * one.theirs.step_seconds:.0f} µs)."
    )


def _named(row: Row | None) -> str:
    if row is None:
        return "none so exact"
    return f"{row.family}, {row.name}: {100 * row.error:.1f} %, {1e6 * row.step_seconds:.0f} µs, {row.dofs} dofs"


def _times(ratio: float) -> str:
    return "none so exact" if np.isinf(ratio) else "–" if ratio == 0 else f"{ratio:.1f} ×"


def _convergence(findings: Findings) -> Iterable[str]:
    yield from ("", "## Convergence", "")
    yield "Order: minus the slope of log error against log degrees of freedom, fitted over all sizes."
    yield ""
    entries = [slope for outcome in findings.outcomes for slope in slopes(outcome.case.name, outcome.rows)]
    yield from markdown_table(
        ["case", "family", "errors [%]", "order", ""],
        [
            (
                slope.case,
                slope.family,
                " ".join(f"{100 * error:.1f}" for error in slope.errors),
                f"{slope.order:.2f}",
                "stops converging" if slope.stalled else "",
            )
            for slope in entries
        ],
    )


def _references(findings: Findings) -> Iterable[str]:
    yield from ("", "## The finite elements", "")
    yield (
        "Bricks of order p, split r × r × r a voxel; the last level is the reference. Change: relative L2 distance "
        "from it. Large displacements: St. Venant–Kirchhoff."
    )
    yield ""
    yield from markdown_table(
        ["case", "voxels", "levels (p, r): nodes", "change", "quantity of interest [mm]"],
        [
            (
                outcome.case.title,
                str(len(outcome.case.grid.index)),
                ", ".join(f"({p}, {r}): {nodes}" for p, r, nodes in outcome.reference.levels),
                ", ".join(f"{100 * change:.2f} %" for change in outcome.reference.change),
                ", ".join(f"{1e3 * quantity:.5g}" for quantity in outcome.reference.quantity),
            )
            for outcome in findings.outcomes
        ],
    )


def _vibration(findings: Findings) -> Iterable[str]:
    if not findings.vibrations:
        return
    yield from ("", "## Free vibration after release", "", "![vibration](vibration.png)", "")
    yield (
        f"A cantilever bent by its weight is let go: {PERIODS} periods of {findings.frequency:.3f} Hz "
        f"(finite elements), "
        f"steps of {1e3 * TIMESTEP:g} ms. Left: amplitude at the end, of that at the start; implicit "
        f"Euler takes the rest."
    )
    yield ""
    yield from markdown_table(
        ["contender", "dofs", "frequency [Hz]", "error", "left", "L2 in the first period"],
        [
            (
                f"{one.family}, {one.name}",
                str(one.dofs),
                *(
                    (f"{one.frequency:.3f}", f"{100 * one.error:+.1f} %", f"{100 * one.left:.0f} %")
                    if one.left < LOST
                    else ("lost", "", "")
                ),
                f"{100 * one.distance:.0f} %",
            )
            for one in findings.vibrations
        ],
    )


def _table2(findings: Findings) -> Iterable[str]:
    if not findings.table2:
        return
    yield from ("", "## The paper's Table 2", "")
    yield (
        "Here: the paper's method, with its samples; "
        "steps of 2 ms with contact, and the same with each step drawn (0 where nothing can be "
        "drawn). The paper's "
        "frames a second include drawing and contact, on a PC of 2011."
    )
    yield ""
    lines = []
    for line in findings.table2:
        vertices, voxels, seconds, rate = PAPER[line.model, line.frames, line.samples]
        lines.append(
            (
                line.model,
                f"{line.frames} / {line.samples}",
                f"{line.vertices} ({vertices})",
                f"{line.voxels} ({voxels})",
                f"{line.build_seconds:.2f} ({seconds})",
                f"{line.steps:.0f}",
                f"{line.drawn:.0f}",
                str(rate),
            )
        )
    yield from markdown_table(
        [
            "model",
            "frames / samples",
            "vertices (paper)",
            "voxels (paper)",
            "t_ini [s] (paper)",
            "steps/s",
            "drawn",
            "paper",
        ],
        lines,
    )


def _cases(findings: Findings) -> Iterable[str]:
    yield from ("", "## All contenders", "")
    for outcome in findings.outcomes:
        yield from (f"### {outcome.case.title}", "")
        yield from markdown_table(
            ["contender", "dofs", "L2", "quantity", "µs a step", "steps to 1 %", "ms to 1 %", "at h [s]", "build [s]"],
            [
                (
                    f"{row.family}, {row.name}{' (stiffness edited)' if row.edited else ''}",
                    str(row.dofs),
                    f"{100 * row.error:.1f} %",
                    f"{100 * row.goal_error:+.1f} %",
                    f"{1e6 * row.step_seconds:.1f}",
                    str(row.steps),
                    f"{1e3 * row.rest_seconds:.3g}",
                    f"{row.timestep:g}",
                    f"{row.build_seconds:.2f}",
                )
                for row in outcome.rows
            ],
        )
        yield ""
        for family, name, reason in outcome.refused:
            yield f"- left out: {family}, {name}: {reason}"
        yield ""
