"""The task of lifting a steak (`mjframes.dm.lift`) for Gymnasium: one world, or many on the threads of one process.

Action (9,) in [−1, 1]: velocities of the joints, of the most that each motor does. Observation: the features of
`mjframes.dm.lifting` one behind the other, with touch also the pressures on 2 × 8 × 12 taxels [kPa], all cut off at
±BOUND. Reward, start and length of an episode are those of the task; it is truncated after 10 s, and terminated where
the physics fails. A world does the same to the bit alone and among others, for a seed and its actions.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from functools import cache
from typing import Any

import gymnasium
import mujoco
import numpy as np
from dm_control import mjcf
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from mujoco.batch import Batch
from numpy.typing import NDArray

from mjframes.base.errors import MjframesError
from mjframes.base.numbers import is_whole
from mjframes.dm import lift, lifting
from mjframes.dm.lifting import Layout
from mjframes.scene.load import DIVERGED
from mjframes.scene.scaling import scale

Array = NDArray[np.float64]

EPISODE = round(lifting.TIME_LIMIT / lifting.CONTROL_TIMESTEP)  # control steps
BOUND = 100.0  # [m, rad/s, N, …] of observations; nothing but hard blows goes beyond
PICTURE = (240, 320)  # height and width of what is drawn


@cache
def _compiled(touch: bool) -> tuple[mujoco.MjModel, Layout]:
    scene = lift.scene(touch)
    model = mjcf.Physics.from_mjcf_model(scene.arena.mjcf_model).model.ptr
    return model, scene.layout(model)


def _spaces(model: mujoco.MjModel, at: Layout) -> tuple[gymnasium.spaces.Box, gymnasium.spaces.Box]:
    """Of actions and observations."""
    size = lifting.features(at, mujoco.MjData(model)).size
    box = gymnasium.spaces.Box
    return box(-1.0, 1.0, (model.nu,), np.float64), box(-BOUND, BOUND, (size,), np.float64)


def _observed(at: Layout, data: Any) -> Array:
    return np.clip(lifting.features(at, data), -BOUND, BOUND)


def _require_finite(name: str, action: Array) -> None:
    """Raise MjframesError for an action that has a number which is none."""
    if not np.isfinite(action).all():
        raise MjframesError(f"{name} is {np.asarray(action).tolist()}; it must be of finite numbers, from -1 to 1.")


class LiftSteak(gymnasium.Env):
    """One world."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": round(1 / lifting.CONTROL_TIMESTEP)}  # noqa: RUF012

    def __init__(self, render_mode: str | None = None, touch: bool = False) -> None:
        """Compile the scene, which takes seconds the first time in a process; render_mode: None or "rgb_array".

        touch: whether it observes what taxels above and below the steak's end feel.
        """
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise MjframesError(f"render_mode is {render_mode!r}; it must be None or 'rgb_array'.")
        model, self._at = _compiled(touch)
        self.model = copy.copy(model)
        self.data = mujoco.MjData(self.model)
        self.render_mode = render_mode
        self.action_space, self.observation_space = _spaces(self.model, self._at)
        self._renderer: Any = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Start an episode."""
        super().reset(seed=seed, options=options)
        start = lifting.starting(self.model, self._at, self.np_random)
        scale(self.model, self._at.name, start.stiffness)
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:] = start.qpos
        mujoco.mj_forward(self.model, self.data)
        return _observed(self._at, self.data), {}

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Go on by 40 ms.  Raise MjframesError for an action that is not finite."""
        _require_finite("action", action)
        self.data.ctrl[:] = action * self.model.actuator_ctrlrange[:, 1]
        mujoco.mj_step(self.model, self.data, nstep=lifting.STEPS)
        mujoco.mj_step1(self.model, self.data)  # sensors of the new state
        failed = bool(self.data.warning.number[DIVERGED].any())
        reward = 0.0 if failed else float(lifting.reward(self._at, self.data))
        return _observed(self._at, self.data), reward, failed, False, {}

    def render(self) -> NDArray[np.uint8] | None:
        """Return a picture (height, width, 3) in the mode "rgb_array"."""
        if self.render_mode is None:
            return None
        renderer = self._renderer = self._renderer or mujoco.Renderer(self.model, *PICTURE)
        renderer.update_scene(self.data, lift.CAMERA["name"])
        return renderer.render()

    def close(self) -> None:
        """Free the renderer."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None


class LiftSteakVector(VectorEnv):
    """Many worlds in one process, each with a steak of its own stiffness; threads step them.

    A world that has ended starts again in the next step, whose action it ignores. A seed is that of world 0, seed + i
    that of world i; or give one each. `LiftSteakVector(64, threads=2)`, or `gymnasium.make_vec`.
    """

    metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012

    def __init__(
        self,
        num_envs: int = 1,
        threads: int = 0,
        max_episode_steps: int = EPISODE,
        render_mode: str | None = None,
        touch: bool = False,
    ) -> None:
        """Make the worlds. threads: 0 takes all processors.  touch: as of `LiftSteak`."""
        for name, value, least in (("num_envs", num_envs, 1), ("threads", threads, 0)):
            if not (is_whole(value) and value >= least):
                raise MjframesError(f"{name} is {value!r}; it must be a whole number ≥ {least}.")
        if render_mode is not None:
            raise MjframesError(f"render_mode is {render_mode!r}; many worlds are not drawn, make one LiftSteak.")
        model, self._at = _compiled(touch)
        self.batch: Any = Batch(model, num_envs, threads)  # its fields are found by name
        for name in ("qpos", "qvel", "sensordata", "site_xpos", "site_xmat"):
            self.batch.bind(name)
        self.num_envs, self.render_mode = num_envs, None
        self.single_action_space, self.single_observation_space = _spaces(model, self._at)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._limit = max_episode_steps
        self._random: list[np.random.Generator] = [seeding.np_random()[0] for _ in range(num_envs)]
        self._count = np.zeros(num_envs, int)
        self._ended = np.zeros(num_envs, bool)

    def reset(  # type: ignore[override]
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Start an episode in every world."""
        for world, own in enumerate(self._seeds(seed)):
            if own is not None:
                self._random[world] = seeding.np_random(int(own))[0]
        self._start(np.arange(self.num_envs))
        return _observed(self._at, self.batch), {}

    def step(self, actions: Array) -> tuple[Array, Array, NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Go on by 40 ms, or start again where the step before ended an episode.

        Raise MjframesError for an action that is not finite, before any world steps.
        """
        ended = self._ended
        going = np.flatnonzero(~ended)
        for world in going[~np.isfinite(np.asarray(actions)[going]).all(axis=1)]:
            _require_finite(f"action of world {world}", actions[world])
        if ended.any():
            self._start(np.flatnonzero(ended))
        if len(going):
            self.batch.ctrl[going] = np.asarray(actions)[going] * self.batch.model.actuator_ctrlrange[:, 1]
            self.batch.step(going, lifting.STEPS, mujoco.mjtStage.mjSTAGE_VEL.value)
            self._count[going] += 1
        failed = self.batch.warning[:, DIVERGED, 1].any(axis=1) & ~ended
        rewards = np.where(failed | ended, 0.0, lifting.reward(self._at, self.batch))
        truncated = (self._count >= self._limit) & ~ended
        self._ended = failed | truncated
        return _observed(self._at, self.batch), rewards, failed, truncated, {}

    def close_extras(self, **kwargs: Any) -> None:
        """Do nothing: the worlds go with the object."""

    def _seeds(self, seed: int | Sequence[int | None] | None) -> Sequence[int | None]:
        """The seed of each world. Raise MjframesError for anything else than None, one, or one a world."""
        if seed is None:
            return [None] * self.num_envs
        seeds = [seed + i for i in range(self.num_envs)] if is_whole(seed) else seed
        if not (isinstance(seeds, (Sequence, np.ndarray)) and all(own is None or is_whole(own) for own in seeds)):
            raise MjframesError(f"seed is {seed!r}; give a whole number ≥ 0, or {self.num_envs} of them.")
        if len(seeds) != self.num_envs:
            raise MjframesError(f"seed has {len(seeds)} numbers; give one, or {self.num_envs}.")
        return seeds

    def _start(self, worlds: NDArray[np.int64]) -> None:
        """Start an episode in some worlds."""
        self.batch.reset(worlds, stage=mujoco.mjtStage.mjSTAGE_NONE.value)
        for world in worlds:
            start = lifting.starting(self.batch.model, self._at, self._random[world])
            self.batch.qpos[world] = start.qpos
            scale(self.batch, self._at.name, start.stiffness, worlds=[world])
        self.batch.forward(worlds)
        self._count[worlds] = 0
