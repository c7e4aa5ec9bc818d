"""Energy that comes from nothing: bodies that nobody tuned, dropped, thrown, squeezed and let go.

python -m benchmarks.stability.energy --bodies 40
"""

from __future__ import annotations

import multiprocessing
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

import mujoco

from benchmarks.stability.energy.bodies import Subject, subjects
from benchmarks.stability.energy.trial import QUICK, Found, Job, Plan, measured

__all__ = ["QUICK", "Found", "Job", "Plan", "Subject", "main", "measured", "run_all", "subjects"]

PROCESSES = 2


def main(chosen: Sequence[Subject], plan: Plan, folder: Path) -> int:
    """Measure the bodies; print the table and write all numbers to energy.csv in the folder; return the code.

    Interrupted, it tells of the bodies that it has finished.
    """
    from rich.console import Console

    from benchmarks.stability.energy.report import summary, table, write

    found = run_all([Job(subject, plan) for subject in chosen])
    console = Console()
    if not console.is_terminal:
        console.width = 200  # a pipe's 80 columns would break the table
    console.print(table(found))
    for line in summary(found):
        console.print(line, highlight=False, soft_wrap=True)
    write(found, folder / "energy.csv")
    print(folder / "energy.csv")
    return 0


def run_all(jobs: Sequence[Job]) -> list[Found]:
    """Return what was found of the jobs, in their order, in two processes; of those that are done, if interrupted."""
    from rich.console import Console
    from rich.progress import Progress

    done: dict[Subject, Found] = {}
    console = Console(stderr=True)
    with (
        Progress(console=console, transient=True, disable=not sys.stderr.isatty()) as progress,
        multiprocessing.get_context("spawn").Pool(PROCESSES, _quiet) as pool,
    ):
        task = progress.add_task("measuring", total=len(jobs))
        try:
            for found in pool.imap_unordered(measured, jobs):
                done[found.subject] = found
                progress.advance(task)
                if found.why:
                    console.print(f"{found.subject.label} is left out: {found.why}", highlight=False, soft_wrap=True)
        except KeyboardInterrupt:
            console.print(f"Interrupted: {len(done)} of {len(jobs)} bodies are told of.", highlight=False)
    return [done[job.subject] for job in jobs if job.subject in done and not done[job.subject].why]


def _quiet() -> None:
    """MuJoCo tells its warnings to stderr and MUJOCO_LOG.TXT; here they are counted. Ctrl-C is the parent's."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    mujoco.set_mju_user_warning(_nothing)


def _nothing(message: str) -> None:
    del message
