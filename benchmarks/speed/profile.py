"""Where a step goes, by MuJoCo's own timers, and what of it is the plugin's work on contacts.

The plugin finds contacts in MuJoCo's collision stage, and writes their rows in that of the forces, where it also does
all that a body in free flight needs. So its work on contacts is what these two stages take more than in free flight;
MuJoCo's own search for pairs of geoms is counted with it.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from statistics import median
from typing import Any

import mujoco
import numpy as np
from numba import cfunc

PARTS = ("position", "collision", "forces", "solver", "other")
CLOCK_MONOTONIC = 1  # of Linux


def profile(
    data: Mapping[str, mujoco.MjData], step: Mapping[str, Callable[[], object]], rounds: int
) -> dict[str, dict[str, float]]:
    """Return the seconds of each part, medians, of models by name that are stepped in turns.

    data: whose timers tell.  step: runs the steps of a model; the sum of its parts is the time of all of these.
    """
    found: dict[str, list[Sequence[float]]] = {name: [] for name in data}
    with _timed():
        for _ in range(rounds):
            for name, run in step.items():
                before = _durations(data[name])
                run()
                found[name].append(_parts(_durations(data[name]) - before))
    return {
        name: {part: median(some[i] for some in spent) for i, part in enumerate(PARTS)} for name, spent in found.items()
    }


def contact_share(touching: Mapping[str, float], free: Mapping[str, float]) -> float:
    """Return the plugin's work on contacts as a share of a step, from the seconds of parts there and in free flight."""
    work = sum(touching[part] - free[part] for part in ("collision", "forces"))
    return work / sum(touching.values())


def _durations(data: mujoco.MjData) -> np.ndarray:
    return np.array([entry.duration for entry in data.timer])


def _parts(spent: np.ndarray) -> Sequence[float]:
    timer = mujoco.mjtTimer
    stages = timer.mjTIMER_POSITION, timer.mjTIMER_POS_COLLISION, timer.mjTIMER_VELOCITY, timer.mjTIMER_CONSTRAINT
    position, collision, forces, solver = (float(spent[stage]) for stage in stages)
    other = float(spent[timer.mjTIMER_STEP]) - position - forces - solver
    return position - collision, collision, forces, solver, other


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
