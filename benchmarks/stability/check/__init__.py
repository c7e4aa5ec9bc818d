"""Numerical stability, tried out: `make check` runs bodies through extreme states and tells what became of them.

python -m benchmarks.stability.check --quick
"""

from __future__ import annotations

import multiprocessing
import os
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from benchmarks.stability.check.cases import Case, all_cases, few_cases
from benchmarks.stability.check.trial import Outcome, run

__all__ = ["Case", "Outcome", "all_cases", "few_cases", "main", "run", "run_all"]

CHUNK = 8  # runs that a process is given at a time: about as many share a body


def main(folder: Path, quick: bool = False) -> int:
    """Run the cases, print the table and write every run to stability.csv in the folder; return the exit code."""
    from rich.console import Console
    from rich.progress import Progress

    from benchmarks.stability.check.report import summary, table, write

    cases = few_cases() if quick else all_cases()
    with Progress(console=Console(stderr=True), transient=True, disable=not sys.stderr.isatty()) as progress:
        task = progress.add_task("trying out", total=len(cases))
        outcomes = run_all(cases, lambda: progress.advance(task))
    console = Console()
    if not console.is_terminal:
        console.width = 160  # a pipe's 80 columns would break the table
    console.print(table(outcomes))
    console.print(summary(outcomes), highlight=False)
    write(outcomes, folder / "stability.csv")
    print(folder / "stability.csv")
    return 0


def run_all(cases: Sequence[Case], advance: Callable[[], object] = lambda: None) -> list[Outcome]:
    """Return the outcomes in the order of the cases, run on all processors; call `advance` after each."""
    workers = min(os.cpu_count() or 1, max(1, len(cases) // CHUNK))
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), initializer=_quiet) as pool:
        outcomes = []
        for outcome in pool.map(run, cases, chunksize=CHUNK):
            outcomes.append(outcome)
            advance()
    return outcomes


def _quiet() -> None:
    """MuJoCo tells its warnings to stderr and MUJOCO_LOG.TXT; here they are counted."""
    import mujoco

    mujoco.set_mju_user_warning(_nothing)


def _nothing(message: str) -> None:
    del message
