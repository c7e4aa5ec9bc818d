"""What of a run goes into its log, and when; and what that costs."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Collection, Mapping
from dataclasses import replace

import mujoco

from mjframes.app.log.write import LogWriter
from mjframes.app.measure import measure
from mjframes.app.recording import Instant, State
from mjframes.app.ticks import Ticks
from mjframes.scene.view import Soft


class Logging:
    """The log of a run.

    topics: some of `options.TOPICS`.  rate: entries a second, see `options.Log`.  fps: of states and the scene unless
    there is a rate [Hz].  timestep: of the simulation [s].
    """

    def __init__(
        self, writer: LogWriter, topics: Collection[str], rate: float | None, fps: float, timestep: float
    ) -> None:
        self.has_video = "video" in topics
        self._writer, self._has_scene = writer, "scene" in topics
        self._numbers = Ticks(rate, early=timestep / 2) if rate else None
        self._states = Ticks(rate or fps, early=timestep / 2)
        self._last: State | None = None  # where it is not logged yet
        self._deepest, self._seconds = 0.0, 0.0

    def step(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        bodies: Mapping[str, Soft],
        state: State,
        depth: float,
        kept: Instant | None,
    ) -> None:
        """Log what is due after a step.

        data, bodies, state: as `measure.measure` takes them.  depth: penetration in this step [m].
        kept: the instant that the recording keeps of this step, if it does.
        """
        start = time.perf_counter()
        self._deepest = max(self._deepest, depth)
        if self._numbers is None:
            if kept is not None:
                self._writer.numbers(kept, data)
        elif self._numbers.due(state.time):
            instant = replace(kept or measure(model, data, bodies, state, depth), penetration=self._deepest)
            self._writer.numbers(instant, data)
            self._deepest = 0.0
        self._last = state
        if self._states.due(state.time):
            self._writer.state(state)
            self._last = None
            if self._has_scene:
                self._writer.scene(data, state.time)
        self._seconds += time.perf_counter() - start

    def pictures(self, packets: list[bytes], camera: str, times: deque[float], start: float) -> None:
        """Log the pictures that are encoded.

        times: at which those not logged yet were drawn [s]; what is logged goes.
        start: since when there was work on them, by `time.perf_counter` [s].
        """
        for packet in packets:
            self._writer.video(packet, camera, times.popleft())
        self._seconds += time.perf_counter() - start

    def end(self, facts: Mapping[str, object]) -> float:
        """Log the last state and facts of the run that are known at its end.  Return the wall time of the log [s]."""
        if self._numbers is None and self._last is not None:
            self._writer.state(self._last)
        self._writer.about(facts)
        return self._seconds
