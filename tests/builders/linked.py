"""A bar whose ends bodies of a scene hold, with frames of every type, and scenes for it."""

from __future__ import annotations

from functools import cache

import mujoco
import numpy as np
from builders.scenes import (
    compiled,
)

import mjframes as mf
from mjframes.body.soft_body import SoftBody

SHAPE = (24, 6, 6)


SPACING = 0.01


SOFT = {1: mf.Material(young=5e4, poisson=0.35, density=1000), 2: mf.Material(young=5e5, poisson=0.3, density=1200)}


# an upper arm and a forearm along x, an elbow between them, and a third link and a mocap body beside them
ARM = """<mujoco><option gravity="0 0 0"/><worldbody>
<body name="upper" pos="0 .03 .03"><joint name="shoulder" type="ball"/><geom size=".01" mass="0.3"/>
  <body name="lower" pos=".12 0 0" euler="0 0 10"><joint name="elbow" axis="0 1 .2"/><geom size=".01" mass="0.2"/>
  </body></body>
<body name="other" pos=".2 .03 0"><joint name="slider" type="slide" axis="1 0 0"/><joint name="wrist" axis="0 1 0"/>
  <geom size=".01" mass="0.1"/></body>
<body name="mocap" mocap="true" pos=".2 0 0"/>
</worldbody></mujoco>"""


def ends(first: bool, layers: int = 3) -> np.ndarray:
    mask = np.zeros(SHAPE, bool)
    mask[slice(0, layers) if first else slice(-layers, None)] = True
    return mask


@cache
def bar() -> mf.Volume:
    labels = np.ones(SHAPE, int)
    labels[:, 3:] = 2
    return mf.Volume.from_labels(labels, SPACING, SOFT)


@cache
def body(
    types: str | tuple[str, ...], links: tuple[str, ...] = (), method: str = "whole_body", mass: str = "consistent"
) -> SoftBody:
    supports = [mf.Attached(link, ends(n == 0)) if link else mf.Fixed(ends(n == 0)) for n, link in enumerate(links)]
    frames = 4 if isinstance(types, str) else len(types)
    return mf.build(bar(), frames, frame_type=types, supports=supports, method=method, mass=mass, damping=(0.5, 0.002))


MIXED = ("point", "rigid", "affine", "quadratic")


CASES: dict[str, tuple[str | tuple[str, ...], tuple[str, ...], str]] = {
    "point": ("point", (), "world"),
    "rigid": ("rigid", (), "world"),
    "affine": ("affine", (), "world"),
    "quadratic": ("quadratic", (), "world"),
    "all types": (MIXED, (), "world"),
    "all types on a moving link": (MIXED, (), "lower"),
    "rigid, fixed end": ("rigid", ("",), "world"),
    "two links of one branch": ("affine", ("upper", "lower"), "world"),
    "all types, two links of one branch": (MIXED, ("upper", "lower"), "upper"),
    "mocap body": ("affine", ("mocap",), "world"),
    "mocap body and a link": (MIXED, ("mocap", "lower"), "world"),
}


def scene(case: str, method: str = "whole_body", **options: object) -> tuple[mujoco.MjModel, mujoco.MjData]:
    types, links, parent = CASES[case]
    made = body(types, links, method)
    pos = (0.0, 0.0, 0.0) if parent == "world" else (0.01, -0.03, -0.03)
    return compiled(ARM, (made, pos, (1, 0, 0, 0)), parent=parent, contact=False, **options)
