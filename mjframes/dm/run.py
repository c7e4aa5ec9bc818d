"""Run through a corridor: dm_control's rodent with soft flesh, and the same task with the bare one.

The task is `RunThroughCorridor` of dm_control.locomotion. An episode starts with the walker upright at the corridor's
beginning, drawn up to 30 cm beside the middle and 0.3 rad off the direction. It ends after 20 s, or earlier, with
discount 0, where a foot or a lower arm is 30 cm below the ground. The action is that of the walker's 38 motors in
[-1, 1]. The reward, in every step, is 1 at a speed of 1 m/s along the corridor and falls off to 0 at 0 and 2 m/s. Seed,
actions and machine determine an episode to the bit.

With flesh the rodent has 0.66 kg instead of 0.34, of water's density in the skin, and the same motors.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from dm_control import composer, mjcf
from dm_control.composer.variation import distributions
from dm_control.locomotion.arenas import corridors as arenas
from dm_control.locomotion.tasks import corridors as tasks
from dm_control.locomotion.walkers import legacy_base
from dm_control.locomotion.walkers import rodent as walkers

from mjframes.dm.registry import FEATURES, TASKS
from mjframes.dm.rodent import clothe, rodent

TIME_LIMIT = 20.0  # [s] as of dm_control's tasks with a rodent
CONTROL_TIMESTEP, PHYSICS_TIMESTEP = 0.02, 0.001  # [s]
SPEED = 1.0  # [m/s] along the corridor
LENGTH, WIDTH = 40.0, 2.0  # [m] of the corridor
START = (0.5, distributions.Uniform(-0.3, 0.3), 0.0)  # [m] of the walker
TURN = distributions.Uniform(-0.3, 0.3)  # [rad] from the corridor's direction
DEEPEST = -0.3  # [m] where an episode ends for feet and lower arms


@cache
def _fleshed() -> str:
    """MJCF of the rodent with flesh."""
    spec = rodent()
    clothe(spec)
    spec.compile()
    return spec.to_xml()


class SoftRat(walkers.Rat):
    """dm_control's rodent with flesh on its bones: the same motors, observables and geoms that touch."""

    def _build(self, name: str = "walker", initializer: Any = None) -> None:
        self.params = None
        self._mjcf_root = mjcf.from_xml_string(_fleshed())
        self._mjcf_root.model = name
        self.body_sites = []
        legacy_base.Walker._build(self, initializer=initializer)


def _environment(walker: walkers.Rat, seed: int | None) -> composer.Environment:
    arena = arenas.EmptyCorridor(corridor_width=WIDTH, corridor_length=LENGTH)
    arena.mjcf_model.option.noslip_iterations = 0  # it does not see the step's elasticity
    task = tasks.RunThroughCorridor(
        walker,
        arena,
        walker_spawn_position=START,
        walker_spawn_rotation=TURN,
        target_velocity=SPEED,
        contact_termination=False,
        terminate_at_height=DEEPEST,
        physics_timestep=PHYSICS_TIMESTEP,
        control_timestep=CONTROL_TIMESTEP,
    )
    walker.observables.egocentric_camera.enabled = False
    return composer.Environment(
        task, TIME_LIMIT, seed, recompile_mjcf_every_episode=False, strip_singleton_obs_buffer_dim=True
    )


@TASKS.add(FEATURES)
def run_rat_features(seed: int | None = None) -> composer.Environment:
    """Return the task of the rodent with flesh."""
    return _environment(SoftRat(), seed)


@TASKS.add(FEATURES)
def run_bare_rat_features(seed: int | None = None) -> composer.Environment:
    """Return the task of the bare rodent."""
    return _environment(walkers.Rat(), seed)
