"""From rest to equilibrium by steps of MuJoCo alone, and how long a step takes.

Implicit Euler with a large time step h is a Newton iteration: M + h² K ≈ h² K. So a static solution is a few large
steps, for mjframes and for flex alike; the largest h of `TIMESTEPS` that comes to rest is taken. This module imports
nothing of mjframes: a second Python with another MuJoCo runs it too.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import mujoco
import numpy as np

TIMESTEPS = (1.0, 0.1, 0.01)  # [s]
AT_REST = 1e-6  # [-] change of the displacements by a step, relative to themselves
MOST_STEPS, MOST_SECONDS = 2000, 1.5  # of one attempt, of the processor; what comes to rest does so in a few dozen
NEAR = 0.01  # [-] of the final displacements: "at equilibrium within 1 %"
TIMED_STEP = 0.002  # [s] the time step at which seconds per step are measured


def settle(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    push: Callable[[], None],
    field: Callable[[], np.ndarray],
    timesteps: Sequence[float] = TIMESTEPS,
) -> dict[str, Any]:
    """Step until nothing moves any more; the state stays in `data`.

    push: sets the applied forces, at the present configuration.  field: displacements (n, 3) [m].
    Return moved (n, 3), steps to within 1 % of them, timestep [s]; {} if no time step leads to rest.
    """
    for timestep in timesteps:
        mujoco.mj_resetData(model, data)
        model.opt.timestep = timestep
        mujoco.mj_forward(model, data)
        history = [field()]
        start = time.process_time()
        while len(history) <= MOST_STEPS and time.process_time() - start < MOST_SECONDS:
            push()
            mujoco.mj_step(model, data)
            _place(model, data)
            history.append(field())
            size = np.linalg.norm(history[-1])
            if not np.isfinite(size) or data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number:
                break
            if len(history) > 3 and all(
                np.linalg.norm(history[-1] - history[-back]) < AT_REST * size for back in (2, 3)
            ):
                away = [np.linalg.norm(moved - history[-1]) for moved in history]
                steps = 1 + max(k for k, distance in enumerate(away) if distance > NEAR * size)
                return {"moved": history[-1], "steps": steps, "timestep": timestep}
    return {}


def seconds_to_rest(
    model: mujoco.MjModel, data: mujoco.MjData, push: Callable[[], None], steps: int, h: float
) -> float:
    """Return the wall time [s] of the first `steps` steps of h [s] from the undeformed state; the state is kept."""
    kind = mujoco.mjtState.mjSTATE_INTEGRATION
    state = np.zeros(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, state, kind)
    mujoco.mj_resetData(model, data)
    mujoco.mj_forward(model, data)
    model.opt.timestep, spent = h, 0.0
    for _ in range(steps):
        push()
        start = time.perf_counter()
        mujoco.mj_step(model, data)
        spent += time.perf_counter() - start
    mujoco.mj_setState(model, data, state, kind)
    mujoco.mj_forward(model, data)
    return spent


def release(
    model: mujoco.MjModel, data: mujoco.MjData, quantity: Callable[[], float], timestep: float, steps: int
) -> np.ndarray:
    """Return the quantity (steps,) after each step without applied forces, from the state in `data`, at rest."""
    model.opt.timestep = timestep
    data.xfrc_applied[:] = 0
    data.qvel[:] = 0
    history = np.empty(steps)
    for k in range(steps):
        mujoco.mj_step(model, data)
        _place(model, data)
        history[k] = quantity()
    return history


def _place(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Positions that belong to qpos: after a step they are those of its start."""
    mujoco.mj_kinematics(model, data)
    if model.nflex:
        mujoco.mj_comPos(model, data)
        mujoco.mj_flex(model, data)


def seconds_per_step(model: mujoco.MjModel, data: mujoco.MjData, timestep: float, least: float) -> float:
    """Return the mean wall time of a step [s], of as many as take about `least` seconds, from the state in `data`."""
    model.opt.timestep = timestep
    kind = mujoco.mjtState.mjSTATE_INTEGRATION
    state = np.zeros(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, state, kind)
    steps, spent = 1, 0.0
    try:
        while spent < least:
            mujoco.mj_setState(model, data, state, kind)
            start = time.perf_counter()
            mujoco.mj_step(model, data, nstep=steps)
            spent = time.perf_counter() - start
            if spent < least:
                steps = max(2 * steps, int(1.1 * least * steps / max(spent, 1e-7)))
        return spent / steps
    finally:
        mujoco.mj_setState(model, data, state, kind)
