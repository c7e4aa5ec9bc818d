"""Some of the worlds of a collection, stepped side by side: the same bits whichever they are, on however many threads.

`mujoco.batch` steps them. Materials are rows of `numeric_data`, starts rows of `qpos`; pushes and random controls are
given step by step. An entry is the state that a step starts from, and the sensors that MuJoCo computes in that step.
A world that MuJoCo warns of, as it diverges or its memory is full, ends with the last entry before.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco.batch import Batch, SimulationError

from mjframes.app.collect.options import RANDOM, CollectOptions
from mjframes.app.collect.push import LENGTH, pushes
from mjframes.app.collect.variation import movables, set_materials, starts, stream, variations
from mjframes.app.overlaps import Overlaps
from mjframes.app.watch import FOLDED
from mjframes.base.errors import MjframesError
from mjframes.scene import view
from mjframes.scene.instability import GROWN, warn, warn_inside
from mjframes.scene.load import mujoco_warnings, start

HOLD = 0.1  # [s] that a random control lasts
DRIVEN = int(mujoco.mjtState.mjSTATE_CTRL | mujoco.mjtState.mjSTATE_XFRC_APPLIED)
MOST_STEPS = 100  # a call of the batch: what is put on worlds in each of them is in memory
NUMBER = 1  # of a warning's counters: how often
ERROR = "ERROR"  # why a world ended, where MuJoCo gives no warning
LARGE, FOLDED_OVER = "far larger than at rest", "folded over, inside out,"


@dataclass(frozen=True, eq=False)
class Worlds:
    """What became of n worlds.

    drawn: of each, what was drawn, by name.  times: (t,) of the entries [s].
    kept: qpos, qvel, act, ctrl, sensors, (n, t, …).  count: (n,) entries that each has.  ended: why each has no more.
    """

    drawn: tuple[dict[str, float], ...]
    times: np.ndarray
    kept: dict[str, np.ndarray]
    count: np.ndarray
    ended: tuple[str, ...]


class Stepping:
    """A collection's scene, ready for some of its worlds.

    model: of the scene; it is not to be used by others meanwhile.
    Raise MjframesError for options that do not go with the scene, and a scene that MuJoCo cannot start.
    """

    def __init__(self, options: CollectOptions, model: mujoco.MjModel) -> None:
        self.options, self.model = options, model
        assert isinstance(options.vary, tuple)
        assert isinstance(options.push, tuple)
        with mujoco_warnings() as warnings:
            self.data = start(model, warnings)
            mujoco.mj_forward(model, self.data)
        self._variations = variations(model, options.vary)
        self._start, self._moved = self.data.qpos.copy(), movables(model, self.data, self._variations)
        self._pushes = pushes(model, self.data, options.push, options.seconds)
        if options.control == RANDOM and not model.nu:
            raise MjframesError("control is 'random', but the scene has no actuators; leave it out.")

    def run(self, worlds: Sequence[int], threads: int) -> Worlds:
        """Step some worlds to their end, or where MuJoCo warns of them; threads: 0 for one a processor.

        Raise MjframesError where memory does not suffice.
        """
        model, n = self.model, len(worlds)
        steps, stride = self._steps(self.options.seconds), self._steps(1 / self.options.rate)
        ticks = range(0, steps, stride)
        drawn = tuple(self._draw(world) for world in worlds)
        batch = Batch(model, n, threads, persistent=bool(model.opt.enableflags & mujoco.mjtEnableBit.mjENBL_SLEEP))
        set_materials(batch, self._variations, drawn)
        batch.bind("qpos")[:] = begun = starts(self._start, self._moved, drawn)
        inputs = self._inputs(worlds, drawn, begun)
        sizes = {"qpos": model.nq, "qvel": model.nv, "act": model.na, "ctrl": model.nu, "sensors": model.nsensordata}
        kept = {name: np.zeros((n, len(ticks), size)) for name, size in sizes.items()}
        count, ended, going = np.zeros(n, int), [""] * n, np.arange(n)
        for tick, step in enumerate(ticks):
            for name in ("qpos", "qvel", "act"):
                kept[name][going, tick] = batch.bind(name)[going]
            until = min(step + stride, steps)
            for first in range(step, until, MOST_STEPS):
                given = inputs(going, range(first, min(first + MOST_STEPS, until)))
                sensed = np.zeros((*given.shape[:2], model.nsensordata))
                with mujoco_warnings(), suppress(SimulationError):  # `warning` and `status` tell of both
                    batch.rollout(
                        given.shape[1], given, DRIVEN, record=("sensordata",), ids=going, out={"sensordata": sensed}
                    )
                if first == step:
                    kept["ctrl"][going, tick], kept["sensors"][going, tick] = given[:, 0, : model.nu], sensed[:, 0]
                for world in going.tolist():
                    if (found := batch.warning[world, :, NUMBER] != 0).any():
                        ended[world] = mujoco.mjtWarning(int(np.argmax(found))).name.removeprefix("mjWARN_")
                    elif batch.status[world]:
                        ended[world] = ERROR
                going = np.array([world for world in going.tolist() if not ended[world]], int)
            count[going] += 1
            if not len(going):
                break
        self.tell_of_bodies(kept["qpos"], count, worlds)
        return Worlds(drawn, model.opt.timestep * np.array(ticks), kept, count, tuple(ended))

    def tell_of_bodies(self, qpos: np.ndarray, count: np.ndarray, worlds: Sequence[int]) -> None:
        """Warn (InstabilityWarning) of soft bodies that are at the end of some worlds as they should not be: far too
        large, folded over or inside each other.

        qpos: (n, t, nq) of the entries.  count: (n,) how many of these each world has.
        """
        last = max(1, round(FOLDED * self.options.rate))
        bodies = {name: view.soft(self.model, self.data, name).quiet() for name in view.soft_names(self.model)}
        overlaps = Overlaps(self.model, bodies)
        found: dict[tuple[str, str], list[int]] = defaultdict(list)
        inside: dict[tuple[str, str], list[tuple[int, float]]] = defaultdict(list)
        for world, entries, number in zip(worlds, qpos, count.tolist(), strict=True):
            folded = dict.fromkeys(bodies, number >= last)
            for entry in entries[max(0, number - last) : number]:
                self.data.qpos[:] = entry
                mujoco.mj_kinematics(self.model, self.data)
                folded = {name: folded[name] and body.is_folded for name, body in bodies.items()}
            if number:
                mujoco.mj_fwdPosition(self.model, self.data)
                for name, body in bodies.items():
                    for what, is_so in ((LARGE, body.size_ratio > GROWN), (FOLDED_OVER, folded[name])):
                        found[name, what] += [world] if is_so else []
                for pair, depth in overlaps.find(self.data).items():
                    inside[pair].append((world, depth))
        for (name, what), some in found.items():
            if some:
                warn(f"{name!r} is {what} {_at_the_end(some)}")
        for pair, cases in inside.items():
            warn_inside(*pair, cases[0][1], _at_the_end([world for world, _ in cases]))

    def _steps(self, seconds: float) -> int:
        return max(1, round(seconds / self.model.opt.timestep))

    def _draw(self, world: int) -> dict[str, float]:
        """What is drawn for a world, by name."""
        found: dict[str, float] = {one.name: one.draw(self.options.seed, world) for one in self._variations}
        for push in self._pushes:
            found |= push.draw(self.options.seed, world, self.options.seconds)
        return found

    def _inputs(
        self, worlds: Sequence[int], drawn: Sequence[dict[str, float]], begun: np.ndarray
    ) -> Callable[[np.ndarray, range], np.ndarray]:
        """A function: what some of n worlds get in each step of a span, (n, steps, nu + 6 nbody), as `mujoco.batch`
        takes it.  drawn: for each.  begun: (n, nq) where they start.
        """
        model, data, n, pushed = self.model, self.data, len(worlds), len(self._pushes)
        hold, length = self._steps(HOLD), self._steps(LENGTH)
        controls = np.zeros((n, self._steps(self.options.seconds) // hold + 1, model.nu))
        if self.options.control == RANDOM:
            limited = model.actuator_ctrllimited.astype(bool)
            low, high = (np.where(limited, model.actuator_ctrlrange[:, k], side) for k, side in enumerate((-1, 1)))
            for row, world in zip(controls, worlds, strict=True):
                row[:] = low + (high - low) * stream(self.options.seed, world, "control").random(row.shape)
        first, wrenches = np.zeros((n, pushed), int), np.zeros((n, pushed, 6 * model.nbody))
        for i, (some, qpos) in enumerate(zip(drawn, begun, strict=True)):
            data.qpos[:] = qpos
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            for k, push in enumerate(self._pushes):
                first[i, k] = round(some[f"{push.body}.push.time"] / model.opt.timestep)
                wrenches[i, k] = push.wrenches(model, data, some).ravel()

        def during(chosen: np.ndarray, span: range) -> np.ndarray:
            steps, begins = np.array(span), first[chosen][:, None]
            lasts = (begins <= steps[:, None]) & (steps[:, None] < begins + length)
            forces = np.einsum("nsp,npw->nsw", lasts.astype(float), wrenches[chosen])
            return np.concatenate([controls[chosen[:, None], steps // hold], forces], axis=2)

        return during


def _at_the_end(worlds: Sequence[int]) -> str:
    return f"at the end of {len(worlds)} worlds, the first of them {worlds[0]}"
