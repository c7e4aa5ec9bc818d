"""Programs made of seeds, each in a process of its own, so that even a crash is told, with its seed."""

from __future__ import annotations

import multiprocessing
import signal
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from multiprocessing.pool import Pool

import mujoco

from mjframes.base.threads import workers


@dataclass(frozen=True)
class Report:
    """What became of programs.

    done: how much they did, edits or files.
    failures: a sentence each, with the seed of its program.
    said: how often each warning and refusal was told.
    """

    done: int = 0
    failures: tuple[str, ...] = ()
    said: Counter[str] = field(default_factory=Counter)

    def __add__(self, other: Report) -> Report:
        return Report(self.done + other.done, self.failures + other.failures, self.said + other.said)


def reports(program: Callable[[int], Report], seeds: range, length: int) -> Iterator[Report]:
    """Yield what becomes of a program for each of some seeds.

    Where a process dies, those that were not finished run again, each in one of its own.
    length: how much one does that dies.
    """
    context = multiprocessing.get_context("spawn")
    left = list(seeds)
    with ProcessPoolExecutor(workers(), context) as pool:
        jobs = {pool.submit(program, seed): seed for seed in left}
        for job in as_completed(jobs):
            try:
                report = job.result()
            except BrokenProcessPool:
                continue
            left.remove(jobs[job])
            yield report
    for seed in left:
        with ProcessPoolExecutor(1, context) as pool:
            try:
                yield pool.submit(program, seed).result()
            except BrokenProcessPool:
                yield Report(length, (f"seed {seed}: the process died.",))


def quiet_pool(processes: int) -> Pool:
    """Return processes for what counts MuJoCo's warnings itself; Ctrl-C is their parent's."""
    return multiprocessing.get_context("spawn").Pool(processes, _quiet)


def _quiet() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    mujoco.set_mju_user_warning(lambda message: None)  # else it goes to stderr and MUJOCO_LOG.TXT


def told(report: Report, what: str) -> int:
    """Print what became of programs; return the exit code, 1 for any failure."""
    print(f"{what}: {len(report.failures)} failures.")
    for failure in report.failures:
        print(f"- {failure}")
    print("What was told, and how often:")
    for text, count in report.said.most_common():
        print(f"{count:6d} × {text}")
    return 1 if report.failures else 0
