"""What a log gives without simulating again: the film, the plot, a state."""

from __future__ import annotations

import os
from typing import Any

import mujoco
import numpy as np

from mjframes.app.log.read import Logged
from mjframes.app.plot import plot_file
from mjframes.app.recording import STATE
from mjframes.app.ticks import Ticks
from mjframes.app.video import film
from mjframes.base.errors import MjframesError
from mjframes.scene.load import mujoco_warnings, sentence, start
from mjframes.scene.packed import unpack

MOST_FRAMES = 10**6  # of a film: nine hours at 30 frames a second


def film_of(
    log: Logged,
    path: str | os.PathLike[str],
    camera: str | None = None,
    fps: float = 30.0,
    size: tuple[int, int] = (1280, 720),
) -> None:
    """Write the film of a log's states; arguments and what is raised as of `video.film`, and for a log without scene.

    A frame shows the first state that was logged at its time or later.
    """
    states, model = log.states(), unpack(log.files, log.path)
    with mujoco_warnings() as warnings:
        data = start(model, warnings)
    if (last := max(state["time"] for state in states)) * fps > MOST_FRAMES:
        raise MjframesError(
            f"{log.path}: its states go on to {last:g} s, for more than {MOST_FRAMES:,} frames; "
            "give a lower --fps, if it is not damaged."
        )
    ticks = Ticks(fps, early=float(log.about["timestep"]) / 2)
    with film(model, path, camera=camera, fps=fps, size=size) as draw, mujoco_warnings() as warnings:
        for state in states:
            if due := ticks.due(state["time"]):
                try:
                    set_state(model, data, state, log.path)
                    for _ in range(due):
                        draw(data)
                except mujoco.FatalError as error:
                    reason = sentence(error, warnings)
                    raise MjframesError(
                        f"{log.path}: MuJoCo cannot draw its state at {state['time']:g} s ({reason})."
                    ) from error


def plot_of(log: Logged, path: str | os.PathLike[str]) -> None:
    """Write the figure of a log, the same that `run` writes; raises what `plot.plot_file` does."""
    with plot_file(path) as save:
        save(log.recording())


def state_at(log: Logged, time: float) -> dict[str, Any]:
    """Return the logged state nearest to `time` [s]: its time, qpos, qvel, act and ctrl, as they were, bit by bit.

    Raise MjframesError for a time beyond the log, and for a state that is not finite.
    """
    states = log.states()
    first, last, timestep = states[0]["time"], log.end(), float(log.about["timestep"])
    if not first - timestep <= time <= last + 1.5 * timestep:  # the end of the run's last step, however it is rounded
        raise MjframesError(f"state is asked for at {time:g} s, but {log.path} goes from {first:g} to {last:g} s.")
    nearest = min(states, key=lambda state: abs(state["time"] - time))
    for key in STATE:
        if not np.isfinite(np.array(nearest[key], float)).all():
            raise MjframesError(
                f"{log.path}: its state at {nearest['time']:g} s has {key} that are not finite; ask for an earlier one."
            )
    return {key: nearest[key] for key in ("time", *STATE)}


def set_state(model: mujoco.MjModel, data: mujoco.MjData, state: dict[str, Any], path: str) -> None:
    """Put a logged state into a MjData.  Raise MjframesError where the scene has another size."""
    sizes = {"qpos": model.nq, "qvel": model.nv, "act": model.na, "ctrl": model.nu}
    for key, size in sizes.items():
        if key == "ctrl" and not state[key]:
            continue
        if len(state[key]) != size:
            raise MjframesError(f"{path}: its states have {len(state[key])} {key}, its scene {size}; it is damaged.")
        getattr(data, key)[:] = np.array(state[key], float)
    data.time = state["time"]
    mujoco.mj_forward(model, data)
