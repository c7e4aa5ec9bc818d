"""The plugin's work on contacts as a share of a step, by MuJoCo's own timers.

The plugin finds contacts in MuJoCo's collision stage, and writes their rows in that of the forces, where it also does
all that a body in free flight needs. So its work on contacts is what these two stages take more than in free flight;
MuJoCo's own search for pairs of geoms is counted with it.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from statistics import median
from typing import Any

import mujoco
import numpy as np
from numba import cfunc

from benchmarks.speed.step_scenes import Run

CLOCK_MONOTONIC = 1  # of Linux


def contact_share(touching: Run, free: Run, steps: int, rounds: int) -> float:
    """Return the plugin's work on contacts as a share of a step [-], from medians of rounds of so many steps in turns.

    free: the same body without contacts.
    """
    spent: list[list[Sequence[float]]] = [[], []]
    with _timed():
        for _ in range(rounds):
            for run, some in zip((touching, free), spent, strict=True):
                before = _durations(run.data)
                run.step(steps)
                some.append((_durations(run.data) - before).tolist())
    (work, whole), (less, _) = ([median(times) for times in zip(*some, strict=True)] for some in spent)
    return (work - less) / whole


def _durations(data: mujoco.MjData) -> np.ndarray:
    """Seconds (2,) until now: of the stages with work on contacts, and of whole steps."""
    timer = mujoco.mjtTimer
    stages = timer.mjTIMER_POS_COLLISION, timer.mjTIMER_VELOCITY, timer.mjTIMER_STEP
    collision, forces, whole = (data.timer[stage].duration for stage in stages)
    return np.array([collision + forces, whole])


@contextmanager
def _timed() -> Iterator[None]:
    mujoco.set_mjcb_time(_clock().ctypes)
    try:
        yield
    finally:
        mujoco.set_mjcb_time(None)


@cache
def _clock() -> Any:
    """Seconds, compiled: MuJoCo asks twenty times a step, which by way of Python takes as long as the step itself."""
    gettime = ctypes.CDLL(None).clock_gettime
    gettime.argtypes, gettime.restype = [ctypes.c_int, ctypes.c_void_p], ctypes.c_int

    @cfunc("float64()")
    def clock() -> float:
        time = np.empty(2, np.int64)  # seconds, nanoseconds
        gettime(CLOCK_MONOTONIC, time.ctypes.data)
        return time[0] + 1e-9 * time[1]

    return clock
