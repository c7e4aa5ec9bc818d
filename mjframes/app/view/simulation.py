"""A scene that runs in real time, can be halted, set back and drawn at; what it did of late."""

from __future__ import annotations

import time
from collections import deque

import mujoco
import numpy as np

from mjframes.app.measure import measure, penetration, state_of, weight_of
from mjframes.app.recording import Instant
from mjframes.app.view.grip import Grip
from mjframes.scene import view
from mjframes.scene.load import DIVERGED, start

PAST = 10.0  # [s] of simulated time that the plots show
RATE = 20.0  # [Hz] of simulated time, of their points
BEHIND = 0.1  # [s] of wall time: a simulation that is slower than it should be does not catch up by more


class Simulation:
    """A scene while it is watched.  Not for several threads.

    model, data: what is stepped.  bodies: the soft ones, by name.  past: instants of the last PAST seconds.
    paused: whether time stands still.  speed: simulated time per wall time that is aimed at.
    diverged: whether it was set back and halted for that.
    held, target, stiffness: the point that the mouse holds, where it draws it (3,) [m], by what spring [N/m].
    force: of that spring in the last step (3,) [N].
    """

    def __init__(self, model: mujoco.MjModel, warnings: list[str]) -> None:
        """Start at the scene's initial state.  warnings, and what is raised: as of `load.start`."""
        self.model = model
        model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_ENERGY)
        self.data = start(model, warnings)
        self.bodies = {name: view.soft(model, self.data, name) for name in view.soft_names(model)}
        self.past: deque[Instant] = deque(maxlen=round(PAST * RATE))
        self.paused, self.diverged, self.speed = False, False, 1.0
        self.held: Grip | None = None
        self.target, self.force = np.zeros(3), np.zeros(3)
        self.stiffness = _handy(weight_of(model), model.stat.extent)
        self._anchor = (time.perf_counter(), 0.0)
        self.reset()

    def reset(self, keyframe: int | None = None) -> None:
        """Go back to the initial state, or to a keyframe."""
        if keyframe is None:
            mujoco.mj_resetData(self.model, self.data)
        else:
            mujoco.mj_resetDataKeyframe(self.model, self.data, keyframe)
        mujoco.mj_forward(self.model, self.data)
        self.past.clear()
        self.release()
        self.diverged, self._deepest = False, 0.0
        self._set_anchor()

    def advance(self, budget: float) -> int:
        """Step up to where the clock is, for at most `budget` [s] of wall time; return how many steps it took."""
        begin = time.perf_counter()
        if self.paused:
            self._set_anchor()
            return 0
        steps = 0
        while self._due(time.perf_counter()) and time.perf_counter() - begin < budget and not self.paused:
            self.step()
            steps += 1
        if self.speed * (time.perf_counter() - self._anchor[0]) > self._since() + self.speed * BEHIND:
            self._set_anchor()
        return steps

    def step(self) -> None:
        """Take one step; set back and halt what diverges."""
        if self.held is not None:
            self.force = self.held.pull(self.model, self.data, self.target, self.stiffness)
        state = state_of(self.data)
        mujoco.mj_step(self.model, self.data)
        if self.data.warning.number[DIVERGED].any():
            self.reset()
            self.paused = self.diverged = True
            return
        self._deepest = max(self._deepest, penetration(self.data))
        if not self.past or state.time - self.past[-1].time > (1 - 1e-6) / RATE:
            self.past.append(measure(self.model, self.data, self.bodies, state, self._deepest))
            self._deepest = 0.0

    def hold(self, grip: Grip) -> None:
        """Hold a point where it is."""
        self.held, self.target = grip, grip.position(self.data)

    def release(self) -> None:
        """Let go of what is held."""
        self.held, self.force = None, np.zeros(3)
        self.data.qfrc_applied[:] = 0

    def set_speed(self, speed: float) -> None:
        """Aim at another simulated time per wall time."""
        self.speed = speed
        self._set_anchor()

    def _due(self, now: float) -> bool:
        return self._since() < self.speed * (now - self._anchor[0])

    def _since(self) -> float:
        """Simulated time since the anchor [s]."""
        return self.data.time - self._anchor[1]

    def _set_anchor(self) -> None:
        """Count from now on."""
        self._anchor = (time.perf_counter(), self.data.time)


def _handy(weight: float, extent: float) -> float:
    """Return the stiffness [N/m], rounded, by which a twentieth of the scene's extent holds what weighs so much [N]."""
    return float(f"{max(1.0, weight) / (0.05 * extent):.2g}")
