"""`make report`: error against run time, against finite elements and MuJoCo's own flex (the paper, §6).

bodies → exact (finite elements) → survey: what the defaults give for bodies nobody tuned
cases → reference (finite elements) → contenders (frames) and flex, in the simulator → measures
both → plots and page
"""

from __future__ import annotations

import argparse
import shlex
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path

from rich.console import Console

from benchmarks.accuracy.measures import Outcome, compare
from benchmarks.accuracy.page import Findings, write_csv, write_page
from benchmarks.accuracy.plots import draw_scatter, draw_survey, draw_vibration
from benchmarks.accuracy.survey import judge
from benchmarks.accuracy.survey_page import write_survey_csv
from benchmarks.accuracy.table2 import Line, measure
from benchmarks.accuracy.vibration import exact_vibration, vibrations
from benchmarks.contenders.flex import FlexProcess
from benchmarks.contenders.frames import timed_build
from benchmarks.solids.bodies import all_bodies
from benchmarks.solids.cases import all_cases, bar
from benchmarks.solids.exact import exact_solution, exact_solutions
from benchmarks.solids.reference import references, refined
from benchmarks.tables import machine
from mjframes.base.choices import METHODS
from mjframes.base.packages import optional
from mjframes.cli.arguments import Parser
from mjframes.cli.commands import exit_code

COMMAND = "benchmarks.accuracy.report"
HOW = "left out: `make report`, or --mujoco4 with a Python that has mujoco 4.0.0, brings it in"


def write_report(
    folder: Path, quick: bool, mujoco4: str | None, models: Mapping[str, str], progress: Callable[[str], None]
) -> None:
    """Measure everything and write report.md, report.csv, survey.csv and the figures.

    mujoco4: a Python that has MuJoCo 4.0.0, for flex; None leaves flex out.  models: files for Table 2, by model.
    Raise MjframesError where an extra package is missing, for a Python without flex and for unusable files.
    """
    optional("matplotlib", "the report", "plot,harmonic")
    start = time.perf_counter()
    progress("finite elements")
    bodies = all_bodies(quick)
    truth = (
        {body.name: exact_solution(body) for body in bodies}
        if quick
        else exact_solutions([b.name for b in bodies], progress)
    )
    for method in METHODS:  # kernels are compiled or loaded where they are first used
        timed_build(bodies[0].volume, 2, method=method)
    verdicts = []
    for body in bodies:
        verdicts.append(judge(body, truth[body.name], quick, progress))
        write_survey_csv(folder / "survey.csv", verdicts)  # of so much work none is lost
    progress("finite elements")
    chosen = all_cases(quick)
    names = [case.name for case in chosen]
    known = {case.name: refined(case) for case in chosen} if quick else references(names, progress)
    swing = bar("release", "cantilever, let go", "weight", across=6)
    bent = refined(swing)
    outcomes: list[Outcome] = []
    with FlexProcess(mujoco4) if mujoco4 else nullcontext() as flex:
        for case in chosen:
            outcomes.append(compare(case, known[case.name], flex, quick, progress))
            write_csv(folder / "report.csv", outcomes)
        progress("free vibration")
        found = vibrations(swing, bent, flex, quick)
        first, _, swinging = exact_vibration(swing, bent)
        version = f"MuJoCo {flex.version}" if flex else HOW
    progress("drawing")
    draw_scatter(folder / "error_time.png", outcomes, lambda row: 1e6 * row.step_seconds, "µs a step")
    draw_scatter(folder / "error_dofs.png", outcomes, lambda row: row.dofs, "degrees of freedom")
    draw_scatter(folder / "error_build.png", outcomes, lambda row: row.build_seconds, "seconds to build")
    draw_survey(folder / "survey_time.png", verdicts, lambda row: 1e6 * row.step_seconds, "µs a step")
    draw_survey(folder / "survey_dofs.png", verdicts, lambda row: row.dofs, "degrees of freedom")
    draw_survey(folder / "survey_build.png", verdicts, lambda row: row.build_seconds, "seconds to build")
    draw_vibration(folder / "vibration.png", found, first, swinging)
    command = shlex.join(["python", "-m", COMMAND, *sys.argv[1:]])

    def publish(lines: list[Line]) -> None:
        seconds = time.perf_counter() - start
        findings = Findings(command, machine(), version, verdicts, outcomes, found, first, lines, seconds)
        write_page(folder / "report.md", findings)

    publish([])
    publish(measure(models, quick, progress))


def _model(text: str) -> tuple[str, str]:
    name, equals, file = text.partition("=")
    if not (name and equals and file):
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=FILE")
    return name, file


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; return the exit code."""
    parser = Parser(
        prog=f"python -m {COMMAND}",
        description="Measure error and run time against finite elements and MuJoCo's flex.",
    )
    parser.add_argument("-o", "--output", default="report", metavar="FOLDER", help="(default %(default)s)")
    parser.add_argument("--quick", action="store_true", help="a few small cases, under three minutes")
    parser.add_argument("--mujoco4", metavar="PYTHON", help="a Python that has MuJoCo 4.0.0, for flex")
    parser.add_argument(
        "--model",
        type=_model,
        action="append",
        default=[],
        metavar="NAME=FILE",
        help="dragon, ribbon, knee or rat, for the paper's Table 2: a label image or a mesh",
    )
    arguments = parser.parse_args(argv)
    start = time.perf_counter()
    folder = Path(arguments.output)
    with Console(stderr=True).status("starting") as status:
        write_report(folder, arguments.quick, arguments.mujoco4, dict(arguments.model), status.update)
    print(f"{folder / 'report.md'}: {time.perf_counter() - start:.0f} s")
    return 0


if __name__ == "__main__":
    raise SystemExit(exit_code(main))
