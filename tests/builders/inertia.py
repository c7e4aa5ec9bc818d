"""Scenes and soft bodies for the inertia of a step."""

from __future__ import annotations

from functools import cache

import mujoco
import numpy as np
from builders.scenes import beam, compiled, jumble
from builders.shapes import mixed

import mjframes as mf
from mjframes.body.soft_body import SoftBody

# two robots: one without anything soft, one that holds a soft body and has fingers that branch off
ROBOTS = """<mujoco><option gravity="0 0 -1"/><worldbody>
<body name="alone" pos="0 1 0"><joint axis="0 0 1"/><geom size=".05" mass="1"/>
  <body pos=".2 0 0"><joint axis="0 1 0"/><geom size=".05" mass="1"/></body></body>
<body name="base" pos="0 0 1"><joint name="swing" axis="0 1 0" armature=".01"/><geom size=".05" mass="1"/>
  <body name="hand" pos="0 0 .2"><joint axis="1 0 0"/><geom size=".05" mass="1"/>
    <body pos=".1 0 0"><joint axis="0 1 0"/><geom size=".02" mass=".1"/></body>
    <body pos="-.1 0 0"><joint axis="0 1 0"/><geom size=".02" mass=".1"/></body>
  </body></body>
</worldbody></mujoco>"""


@cache
def rigid_pair() -> SoftBody:
    return mf.build(mixed(), 3, frame_type=("rigid", "affine", "point"))


def scene(*bodies: SoftBody) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Soft bodies in the hand of one of the robots, in a random state."""
    placed = [(body, (0.3 * n, 0.02, 0.1), (0.8, 0, 0.6, 0)) for n, body in enumerate(bodies)]
    model, data = compiled(ROBOTS, *placed, parent="hand", contact=False)
    jumble(model, data, np.random.default_rng(0), 0.003, 0.4)
    data.qvel[:] = np.random.default_rng(1).normal(size=model.nv)
    mujoco.mj_forward(model, data)
    return model, data


SCENES = {"slides": ("beam", "beam"), "frames that turn": ("pair",), "slides and frames that turn": ("beam", "pair")}


def bodies(name: str) -> list[SoftBody]:
    return [beam(alpha=0.3) if kind == "beam" else rigid_pair() for kind in SCENES[name]]
