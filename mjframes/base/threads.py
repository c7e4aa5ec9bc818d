"""Compiled loops that release the interpreter lock, on the processors this process may use."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

MOST_WORKERS = 8  # each has arrays of its own; beyond this, memory is what limits

T = TypeVar("T")
R = TypeVar("R")


def processors() -> int:
    """Return how many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def workers() -> int:
    """Return how many threads a stage uses."""
    return min(processors(), MOST_WORKERS)


def in_parallel(work: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
    """Yield the results of `work` on each item, in the order of the items, whichever thread is first."""
    with ThreadPoolExecutor(workers()) as pool:
        yield from pool.map(work, items)
