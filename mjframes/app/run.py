"""Runs of a scene: plain `mj_step`, watched."""

from __future__ import annotations

import math
import os
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

import mujoco
from rich.console import Console
from rich.progress import track

from mjframes.app.control_table import control_table
from mjframes.app.log.options import TOPICS, Log
from mjframes.app.measure import measure, penetration, state_of, weight_of
from mjframes.app.recording import Instant, Recording, State
from mjframes.app.ticks import Ticks
from mjframes.app.watch import Watch
from mjframes.base.errors import MjframesError
from mjframes.base.numbers import is_number
from mjframes.scene import view
from mjframes.scene.load import DIVERGED, mujoco_warnings, require_model, reset_to, start
from mjframes.scene.packed import pack

if TYPE_CHECKING:
    from mjframes.app.log.session import Logging

RECORDS = 5000  # instants kept of a run at most: enough for a plot, and a log of a few megabytes


def record(
    model: mujoco.MjModel,
    duration: float,
    *,
    video: str | os.PathLike[str] | None = None,
    log: str | os.PathLike[str] | Log | None = None,
    plot: str | os.PathLike[str] | None = None,
    camera: str | None = None,
    fps: float = 30.0,
    size: tuple[int, int] = (1280, 720),
    scene: mujoco.MjSpec | None = None,
    ctrl: Mapping[str, float] | str | os.PathLike[str] | None = None,
    keyframe: str | int | None = None,
    progress: bool = False,
) -> Recording:
    """Step a scene from its initial state and record it.

    Parameters
    ----------
    model
        The compiled model.
    duration
        How long to simulate [s].
    video, log, plot
        Files to write (.mp4, .mcap, .png). All of them appear, or none if the run fails. A `Log` chooses what is
        logged, and how often.
    camera, fps, size
        Camera, frames per second and size of the video, see `film`.
    scene
        The spec that the model was compiled from. It goes into the log with the files that it names; without it, no
        film can be made of the log later.
    ctrl
        Constant controls by the names of actuators, or a file with controls over time (.csv or .npy).
    keyframe
        Name or number of the keyframe to start from.
    progress
        Whether to show a progress bar on a terminal.

    Returns
    -------
    Recording
        What was recorded.

    Raises
    ------
    MjframesError
        For arguments out of range, for a scene that the plugin refuses, and for a simulation that diverges.

    Warns
    -----
    InstabilityWarning
        Once for each soft body that gains energy from nothing, grows or stays folded over.
    """
    require_model(model)
    timestep = _checked_timestep(model, duration)
    controls = None if ctrl is None else control_table(model, ctrl)
    steps = max(1, round(duration / timestep))
    with ExitStack() as stack:
        warnings = stack.enter_context(mujoco_warnings())
        stack.enter_context(_potential_energy(model))
        data = start(model, warnings)
        if keyframe is not None:
            reset_to(model, data, keyframe)
        bodies = {name: view.soft(model, data, name) for name in view.soft_names(model)}
        begun, logging = data.time, None
        if log is not None:
            chosen = log if isinstance(log, Log) else Log(log)
            logging = stack.enter_context(_log(chosen, model, list(bodies), scene, fps, video is not None))
        draw = stack.enter_context(_pictures(model, video, logging, camera, fps, size))
        save_plot = None
        if plot is not None:
            from mjframes.app.plot import plot_file

            save_plot = stack.enter_context(plot_file(plot))
        made = _Made(model, data, bodies, steps)
        hidden = not (progress and sys.stderr.isatty())
        for step in track(range(steps), "stepping", console=Console(stderr=True), transient=True, disable=hidden):
            if controls is not None:
                controls.set(data, data.time - begun, timestep)
            made.step(step, warnings, logging)
            if draw is not None:
                draw(data, made.state.time)
        recording = made.recording(logging)
        if save_plot is not None:
            save_plot(recording)
    return recording


def _checked_timestep(model: mujoco.MjModel, duration: float) -> float:
    """Return the scene's timestep [s].  Raise MjframesError where it or the duration cannot be."""
    if not (is_number(duration) and duration > 0):
        raise MjframesError(f"duration is {duration!r}; it must be a positive time in seconds.")
    timestep = model.opt.timestep
    if not (math.isfinite(timestep) and timestep > 0):
        raise MjframesError(f"the scene's timestep is {timestep!r}; it must be a positive time in seconds, as 0.002.")
    return timestep


class _Made:
    """What a run has made so far, of `steps` steps."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, bodies: Mapping[str, view.Soft], steps: int) -> None:
        self._model, self._data, self._bodies, self._steps = model, data, bodies, steps
        self._stride, self._watch = math.ceil(steps / RECORDS), Watch(model, data, bodies)
        self._instants: list[Instant] = []
        self._states: list[State] = []
        self._seconds = self._deepest = 0.0
        self._driven = False
        self.state = state_of(data)

    def step(self, number: int, warnings: list[str], logging: Logging | None) -> None:
        """Take a step; measure, watch and log it.  Raise MjframesError where it diverges."""
        model, data = self._model, self._data
        self.state = state_of(data)
        begin = time.perf_counter()
        mujoco.mj_step(model, data)
        self._seconds += time.perf_counter() - begin
        self._driven = self._driven or bool(data.qfrc_actuator.any())
        if data.warning.number[DIVERGED].any():
            reason = warnings[-1] if warnings else f"Time = {self.state.time:.4f}."
            raise MjframesError(
                f"the simulation diverged: {reason} Try a smaller timestep, or damping where the scene has none."
            )
        depth = penetration(data)
        self._deepest = max(self._deepest, depth)
        kept = None
        if number % self._stride == 0 or number == self._steps - 1:
            kept = measure(model, data, self._bodies, self.state, self._deepest)
            self._instants.append(kept)
            self._states.append(self.state)
            self._deepest = 0.0
            self._watch.look(kept)
        self._watch.step()
        if logging is not None:
            logging.step(model, data, self._bodies, self.state, depth, kept)

    def recording(self, logging: Logging | None) -> Recording:
        """Return what was made; end the log."""
        log_seconds = math.nan
        if logging is not None:
            log_seconds = logging.end({"steps": self._steps, "seconds": self._seconds})
        return Recording(
            tuple(self._instants),
            tuple(self._states),
            self._steps,
            self._seconds,
            self._model.opt.timestep,
            weight_of(self._model),
            log_seconds,
            self._driven,
        )


@contextmanager
def _log(
    log: Log, model: mujoco.MjModel, soft_names: list[str], scene: mujoco.MjSpec | None, fps: float, films: bool
) -> Iterator[Logging]:
    """Begin the log of a run.  films: whether a film is made as well, which is then logged unless topics are given."""
    from mjframes.app.log.session import Logging
    from mjframes.app.log.write import log_file

    topics = log.topics or tuple(topic for topic in TOPICS if topic != "video" or films)
    timestep = model.opt.timestep
    with log_file(log.path, model, soft_names, topics, pack(scene, model) if scene else {}) as writer:
        writer.about({"timestep": timestep, "weight": weight_of(model), "mujoco": mujoco.mj_versionString()})
        yield Logging(writer, topics, log.rate, fps, timestep)


@contextmanager
def _pictures(
    model: mujoco.MjModel,
    video: str | os.PathLike[str] | None,
    logging: Logging | None,
    camera: str | None,
    fps: float,
    size: tuple[int, int],
) -> Iterator[Callable[[mujoco.MjData, float], None] | None]:
    """A function that draws what is due at a time [s], once for the film and the log; None where neither has any."""
    in_log = logging is not None and logging.has_video
    if video is None and not in_log:
        yield None
        return
    from mjframes.app.video import find_camera, movie, packets, painter

    with ExitStack() as stack:
        add = stack.enter_context(movie(video, fps, size)) if video is not None else None
        encode = packets(fps, size) if in_log else None
        paint = stack.enter_context(painter(model, camera, size))
        number = find_camera(model, camera)
        name = (model.camera(number).name if number >= 0 else "") or "camera"
        ticks = Ticks(fps, early=model.opt.timestep / 2)
        times: deque[float] = deque()

        def draw(data: mujoco.MjData, now: float) -> None:
            due = ticks.due(now)
            if not due:
                return
            begin = time.perf_counter()
            picture = paint(data)
            if add is not None:
                for _ in range(due):
                    add(picture)
                begin = time.perf_counter()  # the log costs what the film does not
            if encode is not None and logging is not None:
                times.append(now)
                logging.pictures(encode(picture), name, times, begin)

        yield draw
        if encode is not None and logging is not None:
            logging.pictures(encode(None), name, times, time.perf_counter())


@contextmanager
def _potential_energy(model: mujoco.MjModel) -> Iterator[None]:
    """Lets MuJoCo keep `data.energy` current in every step."""
    before = model.opt.enableflags
    model.opt.enableflags = before | int(mujoco.mjtEnableBit.mjENBL_ENERGY)
    try:
        yield
    finally:
        model.opt.enableflags = before
