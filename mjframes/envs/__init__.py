"""Environments of Gymnasium with soft bodies: `gymnasium.make("mjframes.envs:LiftSteak-v0")`.

    worlds = gymnasium.make_vec("mjframes.envs:LiftSteak-v0", num_envs=64, vectorization_mode="vector_entry_point")

steps many worlds in one process, on threads. It needs Gymnasium and, for the arm, dm_control: `pip install
"mjframes[gym]"`.
"""

from __future__ import annotations

from mjframes.base.errors import MjframesError

try:
    import gymnasium
except ImportError as error:
    raise MjframesError('gymnasium is not installed; run pip install "mjframes[gym]".') from error

from mjframes.envs.lift_steak import EPISODE, LiftSteak, LiftSteakVector

__all__ = ["LiftSteak", "LiftSteakVector"]

for name, options in (("LiftSteak-v0", {}), ("LiftSteakTouch-v0", {"touch": True})):
    gymnasium.register(
        name,
        entry_point="mjframes.envs.lift_steak:LiftSteak",
        vector_entry_point="mjframes.envs.lift_steak:LiftSteakVector",
        max_episode_steps=EPISODE,
        kwargs=options,
    )
