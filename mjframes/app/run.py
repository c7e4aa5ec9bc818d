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
from mjframes.scene import view
from mjframes.scene.load import DIVERGED, mujoco_warnings, reset_to, start
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
    """Step a scene from its initial state for `duration` [s] and record it.

    ctrl: constant controls by the names of actuators, or a file with controls over time, .csv or .npy
    (`app.control_table`).
    keyframe: of the scene to start from, its name or number.
    video, log, plot: files to write (.mp4, .mcap, .png), all of them or, where the run fails, none; `Log(…)` chooses
    what is logged, and how often.
    camera, fps, size: of the video, see `video.film`.  scene: what the model was compiled from, which goes into the log
    with the files that it names; a log without it has no film later.
    progress: show a bar on a terminal.
    Warn (InstabilityWarning) once of each soft body that makes energy, grows or stays folded over.
    Raises MjframesError for bad arguments, a scene the plugin refuses and a simulation that diverges.
    """
    if not (math.isfinite(duration) and duration > 0):
        raise MjframesError(f"duration is {duration!r}; it must be a positive time in seconds.")
    timestep = model.opt.timestep
    if not (math.isfinite(timestep) and timestep > 0):
        raise MjframesError(f"the scene's timestep is {timestep!r}; it must be a positive time in seconds, as 0.002.")
    controls = None if ctrl is None else control_table(model, ctrl)
    steps = max(1, round(duration / timestep))
    stride = math.ceil(steps / RECORDS)
    instants: list[Instant] = []
    states: list[State] = []
    seconds = deepest = 0.0
    with ExitStack() as stack:
        warnings = stack.enter_context(mujoco_warnings())
        stack.enter_context(_potential_energy(model))
        data = start(model, warnings)
        if keyframe is not None:
            reset_to(model, data, keyframe)
        begun = data.time
        bodies = {name: view.soft(model, data, name) for name in view.soft_names(model)}
        weight, logging, watch = weight_of(model), None, Watch(model, data, bodies)
        if log is not None:
            from mjframes.app.log.session import Logging
            from mjframes.app.log.write import log_file

            chosen = log if isinstance(log, Log) else Log(log)
            topics = chosen.topics or tuple(topic for topic in TOPICS if topic != "video" or video is not None)
            files = pack(scene, model) if scene else {}
            writer = stack.enter_context(log_file(chosen.path, model, list(bodies), topics, files))
            writer.about({"timestep": timestep, "weight": weight, "mujoco": mujoco.mj_versionString()})
            logging = Logging(writer, topics, chosen.rate, fps, timestep)
        draw = stack.enter_context(_pictures(model, video, logging, camera, fps, size))
        save_plot = None
        if plot is not None:
            from mjframes.app.plot import plot_file

            save_plot = stack.enter_context(plot_file(plot))
        hidden = not (progress and sys.stderr.isatty())
        for step in track(range(steps), "stepping", console=Console(stderr=True), transient=True, disable=hidden):
            state = state_of(data)
            if controls is not None:
                controls.set(data, data.time - begun, timestep)
            begin = time.perf_counter()
            mujoco.mj_step(model, data)
            seconds += time.perf_counter() - begin
            if data.warning.number[DIVERGED].any():
                reason = warnings[-1] if warnings else f"Time = {state.time:.4f}."
                raise MjframesError(
                    f"the simulation diverged: {reason} Try a smaller timestep, or damping where the scene has none."
                )
            depth = penetration(data)
            deepest = max(deepest, depth)
            kept = step % stride == 0 or step == steps - 1
            if kept:
                instants.append(measure(model, data, bodies, state, deepest))
                states.append(state)
                deepest = 0.0
                watch.look(instants[-1])
            watch.step()
            if logging is not None:
                logging.step(model, data, bodies, state, depth, instants[-1] if kept else None)
            if draw is not None:
                draw(data, state.time)
        log_seconds = math.nan
        if logging is not None:
            log_seconds = logging.end({"steps": steps, "seconds": seconds})
        recording = Recording(tuple(instants), tuple(states), steps, seconds, timestep, weight, log_seconds)
        if save_plot is not None:
            save_plot(recording)
    return recording


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
