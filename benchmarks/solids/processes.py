"""Work for the full report, spread over processes."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import TypeVar

from mjframes.base.threads import processors

R = TypeVar("R")


def by_name(work: Callable[[str], R], names: Sequence[str], progress: Callable[[str], None]) -> dict[str, R]:
    """Return what `work` makes of each name, several at once: bodies and cases cannot be sent to another process."""
    workers = min(processors(), len(names))
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as pool:
        jobs = {name: pool.submit(work, name) for name in names}
        for name in names:
            progress(f"finite elements: {name}")
            jobs[name].result()
    return {name: job.result() for name, job in jobs.items()}
