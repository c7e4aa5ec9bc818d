"""The command `python -m benchmarks.stability.check`."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from benchmarks.stability.apart import quiet_pool
from benchmarks.stability.check.cases import all_cases, few_cases
from benchmarks.stability.check.report import summary, table, write
from benchmarks.stability.check.trial import run
from benchmarks.tables import advancing, screen
from mjframes.cli.arguments import Parser
from mjframes.cli.commands import exit_code

CHUNK = 8  # runs that a process is given at a time: about as many share a body


def main(argv: Sequence[str] | None = None) -> int:
    """Run bodies through extreme states, print the table and write every run; return the exit code."""
    parser = Parser(
        prog="python -m benchmarks.stability.check",
        description="Try out the numerical stability: stiff bodies, large steps, impacts.",
    )
    parser.add_argument("--quick", action="store_true", help="a tenth of the runs")
    parser.add_argument("--out", default="out", metavar="FOLDER", help="of stability.csv (default %(default)s)")
    arguments = parser.parse_args(argv)
    cases = few_cases() if arguments.quick else all_cases()
    workers = min(os.cpu_count() or 1, max(1, len(cases) // CHUNK))
    outcomes = []
    with advancing("trying out", len(cases)) as (_, advance), quiet_pool(workers) as pool:
        for outcome in pool.imap(run, cases, CHUNK):
            outcomes.append(outcome)
            advance()
    console = screen()
    console.print(table(outcomes))
    console.print(summary(outcomes), highlight=False)
    path = Path(arguments.out) / "stability.csv"
    write(outcomes, path)
    print(path)
    return 0


if __name__ == "__main__":
    raise SystemExit(exit_code(main))
