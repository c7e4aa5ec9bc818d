"""Energy that comes from nothing: bodies that nobody tuned, dropped, thrown, squeezed and let go.

python -m mjframes.benchmarks.energy --bodies 40
"""

from __future__ import annotations

import multiprocessing
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

import mujoco

from mjframes.benchmarks.energy.bodies import Subject, subjects
from mjframes.benchmarks.energy.trial import QUICK, Job, Plan, Row, measured

__all__ = ["QUICK", "Job", "Plan", "Row", "Subject", "main", "measured", "run_all", "subjects"]

PROCESSES = 2


def main(chosen: Sequence[Subject], plan: Plan, folder: Path) -> int:
    """Measure the bodies, print the table and write it, with a CSV and a picture, into the folder; return the exit code.

    Interrupted, it tells of the bodies that it has finished.
    """
    from rich.console import Console

    from mjframes.benchmarks.energy.report import summary, table, write

    rows = run_all([Job(subject, plan) for subject in chosen])
    console = Console()
    if not console.is_terminal:
        console.width = 200  # a pipe's 80 columns would break the table
    console.print(table(rows))
    for line in summary(rows):
        console.print(line, highlight=False, soft_wrap=True)
    for path in write(rows, folder):
        print(path)
    return 0


def run_all(jobs: Sequence[Job]) -> list[Row]:
    """Return the rows of all jobs in their order, measured in two processes; of those that are done, if interrupted."""
    from rich.console import Console
    from rich.progress import Progress

    found: dict[Subject, list[Row]] = {}
    console = Console(stderr=True)
    hidden = not sys.stderr.isatty()
    with (
        Progress(console=console, transient=True, disable=hidden) as progress,
        multiprocessing.get_context("spawn").Pool(PROCESSES, _quiet, maxtasksperchild=None) as pool,
    ):
        task = progress.add_task("measuring", total=len(jobs))
        try:
            for subject, rows, why in pool.imap_unordered(measured, jobs):
                found[subject] = rows
                progress.advance(task)
                if why:
                    console.print(f"{subject.label} is left out: {why}", highlight=False, soft_wrap=True)
        except KeyboardInterrupt:
            console.print(f"Interrupted: {len(found)} of {len(jobs)} bodies are told of.", highlight=False)
    return [row for job in jobs for row in found.get(job.subject, [])]


def _quiet() -> None:
    """MuJoCo tells its warnings to stderr and MUJOCO_LOG.TXT; here they are counted. The parent is who is interrupted."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    mujoco.set_mju_user_warning(_nothing)


def _nothing(message: str) -> None:
    del message
