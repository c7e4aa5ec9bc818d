"""From rest to equilibrium by steps of MuJoCo alone, and how long a step takes.

Implicit Euler with a large time step h is a Newton iteration: M + h² K ≈ h² K. So a static solution is a few large steps,
for mjframes and for flex alike; the largest h of `TIMESTEPS` that comes to rest is taken. This module imports nothing
of mjframes: a second Python with another MuJoCo runs it too.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import mujoco
import numpy as np

TIMESTEPS = (1.0, 0.1, 0.01)  # [s]
AT_REST = 1e-6  # [-] change of the displacements by a step, relative to themselves
MOST_STEPS, MOST_SECONDS = 3000, 20.0  # of one attempt
NEAR = 0.01  # [-] of the final displacements: "at equilibrium within 1 %"
TIMED_STEP = 0.002  # [s] the time step at which seconds per step are measured


def settle(
    model: mujoco.MjModel, data: mujoco.MjData, push: Callable[[], None], field: Callable[[], np.ndarray]
) -> dict[str, object]:
    """Steps until nothing moves any more; the state stays in `data`.

    push: sets the applied forces, at the present configuration.  field: displacements (n, 3) [m].
    Returns moved (n, 3), steps to within 1 % of them, all steps, timestep [s]; {} if no time step leads to rest.
    """
    for timestep in TIMESTEPS:
        mujoco.mj_resetData(model, data)
        model.opt.timestep = timestep
        mujoco.mj_forward(model, data)
        history = [field()]
        start = time.perf_counter()
        while len(history) <= MOST_STEPS and time.perf_counter() - start < MOST_SECONDS:
            push()
            mujoco.mj_step(model, data)
            if data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number or not np.isfinite(data.qpos).all():
                break
            mujoco.mj_kinematics(model, data)
            mujoco.mj_flex(model, data) if model.nflex else None
            history.append(field())
            size = np.linalg.norm(history[-1])
            if len(history) > 3 and all(
                np.linalg.norm(history[-1] - history[-back]) < AT_REST * size for back in (2, 3)
            ):
                away = [np.linalg.norm(moved - history[-1]) for moved in history]
                steps = 1 + max(k for k, distance in enumerate(away) if distance > NEAR * size)
                return {"moved": history[-1], "steps": steps, "all_steps": len(history) - 1, "timestep": timestep}
    return {}


def seconds_per_step(model: mujoco.MjModel, data: mujoco.MjData, timestep: float, least: float) -> float:
    """Mean wall time of a step [s], of as many as take about `least` seconds, from the state that `data` is in."""
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
