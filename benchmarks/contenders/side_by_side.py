"""How many steps a second worlds of one model make side by side, and alone; of frames and of flex alike.

This module imports nothing of mjframes: a second Python with another MuJoCo runs it too. Times are of the wall, and of
the processors, which tell the same of a machine that has nothing else to do, and more of one that has.
"""

from __future__ import annotations

import time

import mujoco
import numpy as np

STATE = mujoco.mjtState.mjSTATE_INTEGRATION
WINDOW = 50  # steps from the start that are measured, again and again
CALL = 10  # steps a call of the batch, as many as a task makes between two actions


def integration_state(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Return all that the next steps depend on."""
    state = np.zeros(mujoco.mj_stateSize(model, STATE))
    mujoco.mj_getState(model, data, state, STATE)
    return state


def processor_seconds(model: mujoco.MjModel, data: mujoco.MjData, start: np.ndarray, steps: int) -> float:
    """Return the processor time [s] of so many steps.  start: the state before them, of `integration_state`."""
    mujoco.mj_setState(model, data, start, STATE)
    before = time.thread_time()
    mujoco.mj_step(model, data, nstep=steps)
    return time.thread_time() - before


def mean_contacts(model: mujoco.MjModel, data: mujoco.MjData, start: np.ndarray, steps: int) -> tuple[float, float]:
    """Return the mean numbers of contacts and of the solver's iterations over so many steps."""
    mujoco.mj_setState(model, data, start, STATE)
    contacts = iterations = 0
    for _ in range(steps):
        mujoco.mj_step(model, data)
        contacts += data.ncon
        iterations += int(data.solver_niter[: max(1, data.nisland)].max())
    return contacts / steps, iterations / steps


def batch_rate(
    model: mujoco.MjModel, start: np.ndarray, worlds: int, threads: int, least: int, numerics: np.ndarray | None = None
) -> tuple[float, float]:
    """Return world-steps a second of wall time, and a second of processor time.

    start: the state that worlds start from, of `integration_state`.  least: world-steps to measure.
    numerics: (worlds, nnumericdata) of each, the model's unless given.
    """
    from mujoco.batch import Batch

    batch = Batch(model, worlds, threads)
    if numerics is not None:
        batch.expand("numeric_data")[:] = numerics
    batch.state[:] = start
    batch.step()  # which makes the threads, and memory resident
    wall = processor = 0.0
    windows = -(-least // (worlds * WINDOW))
    for _ in range(windows):
        batch.state[:] = start
        before = time.perf_counter(), time.process_time()
        for _ in range(WINDOW // CALL):
            batch.step(nstep=CALL)
        wall += time.perf_counter() - before[0]
        processor += time.process_time() - before[1]
    steps = windows * worlds * WINDOW
    return steps / wall, steps / processor


def single_rate(model: mujoco.MjModel, start: np.ndarray, least: int) -> tuple[float, float]:
    """Return steps a second of `mj_step` alone, of wall and of processor time, of the same steps as `batch_rate`."""
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, start, STATE)
    mujoco.mj_step(model, data)
    wall = processor = 0.0
    windows = -(-least // WINDOW)
    for _ in range(windows):
        mujoco.mj_setState(model, data, start, STATE)
        before = time.perf_counter(), time.process_time()
        mujoco.mj_step(model, data, nstep=WINDOW)
        wall += time.perf_counter() - before[0]
        processor += time.process_time() - before[1]
    return windows * WINDOW / wall, windows * WINDOW / processor
