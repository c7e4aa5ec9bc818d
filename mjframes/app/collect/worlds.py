"""Some of the worlds of a plan, stepped side by side: the same bits whichever they are, on however many threads.

`mujoco.batch` steps them. Materials are rows of `numeric_data`, starts rows of `qpos`; pushes and random controls are
given step by step. An entry is the state that a step starts from, and the sensors that MuJoCo computes in that step.
A world that MuJoCo warns of, as it diverges or its memory is full, ends with the last entry before.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco.batch import Batch, SimulationError

from mjframes.app.collect.plan import Plan
from mjframes.app.collect.push import LENGTH, pushes
from mjframes.app.collect.variation import movables, set_materials, starts, stream, variations
from mjframes.app.watch import FOLDED, Overlaps
from mjframes.base.errors import MjframesError
from mjframes.scene import view
from mjframes.scene.instability import GROWN, warn, warn_inside
from mjframes.scene.load import mujoco_warnings, start

HOLD = 0.1  # [s] that a random control lasts
CONTROLS = int(mujoco.mjtState.mjSTATE_CTRL | mujoco.mjtState.mjSTATE_XFRC_APPLIED)
MOST_STEPS = 100  # a call of the batch: what is put on worlds in each of them is in memory
NUMBER = 1  # of a warning's counters: how often
ERROR = "ERROR"  # why a world ended, where MuJoCo gives no warning


@dataclass(frozen=True, eq=False)
class Worlds:
    """What became of n worlds.

    drawn: of each, what was drawn, by name.  times: (t,) of the entries [s].
    qpos, qvel, act, ctrl, sensors: (n, t, …).  count: (n,) entries that each has.  ended: why each has no more, "".
    """

    drawn: tuple[dict[str, float], ...]
    times: np.ndarray
    qpos: np.ndarray
    qvel: np.ndarray
    act: np.ndarray
    ctrl: np.ndarray
    sensors: np.ndarray
    count: np.ndarray
    ended: tuple[str, ...]


class Stepping:
    """A plan's scene, ready for some of its worlds.

    model: of the scene; it is not to be used by others meanwhile.
    Raise MjframesError for a plan that does not go with the scene, and a scene that MuJoCo cannot start.
    """

    def __init__(self, plan: Plan, model: mujoco.MjModel) -> None:
        self.plan, self.model = plan, model
        with mujoco_warnings() as warnings:
            self.data = start(model, warnings)
            mujoco.mj_forward(model, self.data)
        self._variations = variations(model, plan.vary)
        self._start, self._moved = self.data.qpos.copy(), movables(model, self.data, self._variations)
        self.pushes = pushes(model, self.data, plan.push, plan.seconds)
        if plan.control == "random" and not model.nu:
            raise MjframesError("control is 'random', but the scene has no actuators; leave it out.")

    def draw(self, world: int) -> dict[str, float]:
        """Return what is drawn for a world, by name."""
        plan = self.plan
        found: dict[str, float] = {one.name: one.draw(plan.seed, world) for one in self._variations}
        for push in self.pushes:
            found |= push.draw(plan.seed, world, plan.seconds)
        return found

    def run(self, worlds: Sequence[int], threads: int) -> Worlds:
        """Step some worlds to their end, or where MuJoCo warns of them; threads: 0 for one a processor.

        Raise MjframesError where memory does not suffice.
        """
        plan, model, n = self.plan, self.model, len(worlds)
        timestep = model.opt.timestep
        steps, stride = _steps(plan.seconds, timestep), _steps(1 / plan.rate, timestep)
        ticks = range(0, steps, stride)
        drawn = tuple(self.draw(world) for world in worlds)
        batch = Batch(model, n, threads, persistent=bool(model.opt.enableflags & mujoco.mjtEnableBit.mjENBL_SLEEP))
        set_materials(batch, self._variations, drawn)
        batch.bind("qpos")[:] = begun = starts(self._start, self._moved, drawn)
        inputs = _inputs(self, worlds, drawn, begun)
        sizes = {"qpos": model.nq, "qvel": model.nv, "act": model.na, "ctrl": model.nu, "sensors": model.nsensordata}
        kept = {name: np.zeros((n, len(ticks), size)) for name, size in sizes.items()}
        count, ended, going = np.zeros(n, int), [""] * n, np.arange(n)
        for tick, step in enumerate(ticks):
            for name in ("qpos", "qvel", "act"):
                kept[name][going, tick] = batch.bind(name)[going]
            kept["ctrl"][going, tick] = inputs.during(going, range(step, step + 1))[:, 0, : model.nu]
            until = min(step + stride, steps)
            for first in range(step, until, MOST_STEPS):
                span = range(first, min(first + MOST_STEPS, until))
                sensed = np.zeros((len(going), len(span), model.nsensordata))
                with mujoco_warnings(), suppress(SimulationError):  # `warning` and `status` tell of both
                    batch.rollout(
                        len(span),
                        inputs.during(going, span),
                        CONTROLS,
                        record=("sensordata",),
                        ids=going,
                        out={"sensordata": sensed},
                    )
                if first == step:
                    kept["sensors"][going, tick] = sensed[:, 0]
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
        return Worlds(drawn, timestep * np.array(ticks), count=count, ended=tuple(ended), **kept)

    def tell_of_bodies(self, qpos: np.ndarray, count: np.ndarray, worlds: Sequence[int]) -> None:
        """Warn (InstabilityWarning) of soft bodies that are at the end of some worlds as they should not be: far too
        large, folded over or inside each other.

        qpos: (n, t, nq) of the entries.  count: (n,) how many of these each world has.
        """
        last = _steps(FOLDED, 1 / self.plan.rate)
        bodies = {name: view.soft(self.model, self.data, name).quiet() for name in view.soft_names(self.model)}
        kept = [entries[:number] for entries, number in zip(qpos, count.tolist(), strict=True)]
        for name, body in bodies.items():
            looks = [[self._looked_at(body, entry) for entry in entries[-last:]] for entries in kept]
            grown = [world for world, found in zip(worlds, looks, strict=True) if found and found[-1][0]]
            folded = [
                world
                for world, found in zip(worlds, looks, strict=True)
                if len(found) == last and all(is_folded for _, is_folded in found)
            ]
            for what, some in (("far larger than at rest", grown), ("folded over, inside out,", folded)):
                if some:
                    warn(f"{name!r} is {what} at the end of {len(some)} worlds, the first of them {some[0]}")
        overlaps = Overlaps(self.model, bodies)
        inside: dict[tuple[str, str], list[tuple[int, float]]] = {}
        for world, entries in zip(worlds, kept, strict=True):
            if not len(entries):
                continue
            self.data.qpos[:] = entries[-1]
            mujoco.mj_fwdPosition(self.model, self.data)
            for pair, depth in overlaps.find(self.data).items():
                inside.setdefault(pair, []).append((world, depth))
        for pair, some in inside.items():
            warn_inside(*pair, some[0][1], f"at the end of {len(some)} worlds, the first of them {some[0][0]}")

    def _looked_at(self, body: view.Soft, qpos: np.ndarray) -> tuple[bool, bool]:
        """Whether a body is grown, and folded, at qpos."""
        self.data.qpos[:] = qpos
        mujoco.mj_kinematics(self.model, self.data)
        return body.size_ratio > GROWN, body.is_folded


@dataclass(frozen=True, eq=False)
class _Inputs:
    """What is put on n worlds in each step: controls and wrenches, as `mujoco.batch` takes them.

    controls: (n, blocks, nu), each for `hold` steps.
    first, wrenches: (n, p) steps at which pushes start and (n, p, 6 nbody), each for `length` steps.
    """

    hold: int
    controls: np.ndarray
    length: int
    first: np.ndarray
    wrenches: np.ndarray

    def during(self, worlds: np.ndarray, span: range) -> np.ndarray:
        """Return what some of the worlds get in each step of a span, (n, steps, nu + 6 nbody)."""
        steps, first = np.array(span), self.first[worlds][:, None]
        lasts = (first <= steps[:, None]) & (steps[:, None] < first + self.length)
        pushed = np.einsum("nsp,npw->nsw", lasts.astype(float), self.wrenches[worlds])
        return np.concatenate([self.controls[worlds[:, None], steps // self.hold], pushed], axis=2)


def _inputs(stepping: Stepping, worlds: Sequence[int], drawn: Sequence[dict[str, float]], begun: np.ndarray) -> _Inputs:
    """Return what is put on worlds.  drawn: for each.  begun: (n, nq) where they start."""
    model, plan, data = stepping.model, stepping.plan, stepping.data
    timestep, n, pushed = model.opt.timestep, len(worlds), len(stepping.pushes)
    hold = _steps(HOLD, timestep)
    controls = np.zeros((n, _steps(plan.seconds, timestep) // hold + 1, model.nu))
    if plan.control == "random":
        limited = model.actuator_ctrllimited.astype(bool)
        low, high = (np.where(limited, model.actuator_ctrlrange[:, k], side) for k, side in enumerate((-1, 1)))
        for row, world in zip(controls, worlds, strict=True):
            row[:] = low + (high - low) * stream(plan.seed, world, "control").random(row.shape)
    first, wrenches = np.zeros((n, pushed), int), np.zeros((n, pushed, 6 * model.nbody))
    for i, (some, qpos) in enumerate(zip(drawn, begun, strict=True)):
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        for k, push in enumerate(stepping.pushes):
            first[i, k] = round(some[f"{push.body}.push.time"] / timestep)
            wrenches[i, k] = push.wrenches(data, some).ravel()
    return _Inputs(hold, controls, _steps(LENGTH, timestep), first, wrenches)


def _steps(seconds: float, timestep: float) -> int:
    return max(1, round(seconds / timestep))
