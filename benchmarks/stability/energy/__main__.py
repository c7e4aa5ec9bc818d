"""The command `python -m benchmarks.stability.energy`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from benchmarks.stability.apart import quiet_pool
from benchmarks.stability.energy.bodies import MESHES, METHODS, Subject, subjects
from benchmarks.stability.energy.report import summary, table, write
from benchmarks.stability.energy.trial import MEASURES, QUICK, Found, Job, Plan, measured
from benchmarks.tables import advancing, screen
from mjframes.cli.arguments import Parser
from mjframes.cli.commands import exit_code

BODIES, FEW = 40, 4  # drawn bodies, and with --quick
PROCESSES = 2


def main(argv: Sequence[str] | None = None) -> int:
    """Look for energy that comes from nothing, print the table and write all numbers; return the exit code.

    Interrupted, it tells of the bodies that it has finished.
    """
    parser = Parser(
        prog="python -m benchmarks.stability.energy", description="Look for energy that comes from nothing."
    )
    parser.add_argument("--bodies", type=int, metavar="N", help=f"how many are drawn (default: {BODIES})")
    parser.add_argument("--quick", action="store_true", help=f"{FEW} bodies, one step, no meshes: within two minutes")
    parser.add_argument("--seed", type=int, default=0, help="of what is drawn (default: %(default)s)")
    parser.add_argument("--laws", nargs="+", choices=METHODS, default=METHODS, metavar="LAW", help=", ".join(METHODS))
    parser.add_argument("--only", nargs="+", choices=MEASURES, metavar="MEASURE", help="of " + ", ".join(MEASURES))
    parser.add_argument("--out", default="out", metavar="FOLDER", help="of energy.csv (default: %(default)s)")
    given = parser.parse_args(argv)
    count = given.bodies if given.bodies is not None else FEW if given.quick else BODIES
    if not given.quick and not MESHES.is_dir():
        print(f"There are no meshes in {MESHES}; the drawn bodies are measured alone.", file=sys.stderr)
    plan = QUICK if given.quick else Plan()
    if given.only:
        plan = replace(plan, measures=tuple(name for name in MEASURES if name in given.only))
    found = run_all([Job(some, plan) for some in subjects(count, given.seed, given.laws, meshes=not given.quick)])
    console = screen()
    console.print(table(found))
    for line in summary(found):
        console.print(line, highlight=False, soft_wrap=True)
    path = Path(given.out) / "energy.csv"
    write(found, path)
    print(path)
    return 0


def run_all(jobs: Sequence[Job]) -> list[Found]:
    """Return what was found of the jobs, in their order, in two processes; of those that are done, if interrupted."""
    done: dict[Subject, Found] = {}
    with advancing("measuring", len(jobs)) as (console, advance), quiet_pool(PROCESSES) as pool:
        try:
            for found in pool.imap_unordered(measured, jobs):
                done[found.subject] = found
                advance()
                if found.why:
                    console.print(f"{found.subject.label} is left out: {found.why}", highlight=False, soft_wrap=True)
        except KeyboardInterrupt:
            console.print(f"Interrupted: {len(done)} of {len(jobs)} bodies are told of.", highlight=False)
    return [done[job.subject] for job in jobs if job.subject in done and not done[job.subject].why]


if __name__ == "__main__":
    raise SystemExit(exit_code(main))
