"""Lift a T-bone steak: a Jaco arm and hand of dm_control, and a steak that juts out over the block it lies on.

An episode starts with the steak at rest in the air just above the block, a centimetre and 0.2 rad about its place, the
hand open before it, and all moduli of the steak times a factor between 0.5 and 2; it ends after 10 s. The action is the
velocities of the nine joints. The reward, in every step, is how far the centre of mass has risen, 1 from 15 cm on. The
discount is 1. Seed, actions and machine determine an episode to the bit.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from dm_control import composer, mjcf
from dm_control.composer.observation import observable
from dm_control.entities.manipulators import kinova
from numpy.typing import NDArray

from mjframes.body.build import build
from mjframes.body.soft_body import SoftBody
from mjframes.dm import lifting
from mjframes.dm.lifting import Layout
from mjframes.dm.registry import FEATURES, TASKS, VISION
from mjframes.dm.soft_entity import SoftEntity
from mjframes.scene.contact import Contact
from mjframes.scene.scaling import scale
from mjframes.scene.taxels import TaxelGrid

FRAMES = 3
DAMPING = (0.0, 0.005)  # Rayleigh's α [1/s] and β [s]: meat does not ring
# Of wet meat on plastic or wood. With priority, as those of the hand and of the block are MuJoCo's 1.
CONTACT = Contact(friction=(0.7, 0.005, 0.0001), condim=4, priority=1)
TAXELS = {  # on the strip loin, where the hand takes hold: 7 mm wide
    side: TaxelGrid((0.072, 0, 0), (0, 0, up), (0.056, 0.084), (8, 12), along=(1, 0, 0))
    for side, up in (("above", 1), ("below", -1))
}
CAMERA = {"name": "beside", "pos": (0.85, 0.15, 0.62), "xyaxes": (0, 1, 0, -0.3, 0, 1), "fovy": 53}
PIXELS = 84  # height and width of pictures, as in dm_control.manipulation


@cache
def steak() -> SoftBody:
    """Return the steak of models/steak.npz with three frames."""
    return build(Path(__file__).with_name("steak.npz"), FRAMES, damping=DAMPING)


@dataclass(frozen=True, eq=False)
class Scene:
    """The entities of the task."""

    arena: composer.Arena
    arm: kinova.JacoArm
    hand: kinova.JacoHand
    steak: SoftEntity

    def layout(self, model: mujoco.MjModel) -> Layout:
        """Return where the arrays of a model compiled from the arena have what matters."""
        arm, hand = ([joint.full_identifier for joint in some.joints] for some in (self.arm, self.hand))
        torque = [sensor.full_identifier for sensor in self.arm.joint_torque_sensors]
        pinch = self.hand.pinch_site.full_identifier
        touch = [sensor.full_identifier for sensor in self.steak.taxels]
        return lifting.layout(model, arm, hand, torque, pinch, self.steak.full_name, self.steak.body, touch)


def scene(touch: bool = False) -> Scene:
    """Return the arena with a block, the arm with its hand, and the steak; touch: with taxels on that."""
    arena = composer.Arena()
    root = arena.mjcf_model
    root.option.noslip_iterations = 0  # it does not see the step's elasticity
    del root.compiler.boundmass, root.compiler.boundinertia  # masses of soft bodies are as they are
    root.option.timestep = lifting.PHYSICS_TIMESTEP
    flat = {"type": "2d", "builtin": "checker", "width": 300, "height": 300}
    checks = root.asset.add("texture", name="checks", rgb1=(0.75, 0.76, 0.78), rgb2=(0.68, 0.69, 0.71), **flat)
    tiles = root.asset.add("material", name="tiles", texture=checks, texrepeat=(5, 5), texuniform=True)
    root.asset.add(
        "texture", name="sky", type="skybox", builtin="gradient", rgb1=(0.9, 0.93, 0.96), rgb2=(0.5, 0.6, 0.7),
        width=64, height=64,
    )  # fmt: skip
    root.worldbody.add("light", pos=(0.5, -0.5, 2), dir=(-0.2, 0.3, -1), diffuse=(0.5, 0.5, 0.5))
    root.worldbody.add("geom", name="ground", type="plane", size=(1.5, 1.5, 0.1), material=tiles)
    top = np.array([0, 0, lifting.BLOCK[2]])
    root.worldbody.add("geom", name="block", type="box", size=lifting.BLOCK, pos=top, rgba=(0.72, 0.55, 0.36, 1))
    root.worldbody.add("camera", **CAMERA)
    arm, hand = kinova.JacoArm(), kinova.JacoHand(use_pinch_site_as_tcp=True)
    arm.attach(hand)
    arena.attach(arm).pos = (0, lifting.REACH, 0)
    meat = SoftEntity(steak(), "steak", contact=CONTACT, taxels=TAXELS if touch else None)
    arena.attach(meat)
    return Scene(arena, arm, hand, meat)


class Lift(composer.Task):
    """The task; `vision` has pictures in place of what is known of the steak."""

    def __init__(self, vision: bool) -> None:
        self._scene = scene()
        self._layout: Layout | None = None
        self.control_timestep = lifting.CONTROL_TIMESTEP
        self._observables: OrderedDict[str, observable.Observable] = OrderedDict()
        for name, feature in (lifting.PROPRIOCEPTION if vision else lifting.FEATURES).items():
            self._observables[name] = observable.Generic(self._reading(feature))
        if vision:
            camera = self._scene.arena.mjcf_model.find("camera", CAMERA["name"])
            self._observables["camera"] = observable.MJCFCamera(camera, height=PIXELS, width=PIXELS)
        for each in self._observables.values():
            each.enabled = True

    def _reading(self, feature: Callable[[Layout, Any], NDArray[np.float64]]) -> Callable[[mjcf.Physics], Any]:
        return lambda physics: feature(self.layout(physics), physics.data)

    @property
    def root_entity(self) -> composer.Arena:
        """Return the arena."""
        return self._scene.arena

    @property
    def steak(self) -> SoftEntity:
        """Return the steak."""
        return self._scene.steak

    @property
    def task_observables(self) -> OrderedDict[str, observable.Observable]:
        """Return the features of `lifting`."""
        return self._observables

    def layout(self, physics: mjcf.Physics) -> Layout:
        """Return where the arrays of a physics have what matters."""
        if self._layout is None:
            self._layout = self._scene.layout(physics.model.ptr)
        return self._layout

    def initialize_episode(self, physics: mjcf.Physics, random_state: np.random.RandomState) -> None:
        """Draw and set how the episode starts."""
        start = lifting.starting(physics.model.ptr, self.layout(physics), random_state)
        physics.data.qpos[:] = start.qpos
        scale(physics.model.ptr, self.steak.full_name, start.stiffness)

    def get_reward(self, physics: mjcf.Physics) -> float:
        """Return how far the steak is lifted [-]."""
        return float(lifting.reward(self.layout(physics), physics.data))


def _environment(seed: int | None, vision: bool) -> composer.Environment:
    return composer.Environment(
        Lift(vision),
        lifting.TIME_LIMIT,
        seed,
        recompile_mjcf_every_episode=False,  # nothing of the MJCF changes
        strip_singleton_obs_buffer_dim=True,
    )


@TASKS.add(FEATURES)
def lift_steak_features(seed: int | None = None) -> composer.Environment:
    """Return the task with proprioception and the steak's frames."""
    return _environment(seed, vision=False)


@TASKS.add(VISION)
def lift_steak_vision(seed: int | None = None) -> composer.Environment:
    """Return the task with proprioception and pictures."""
    return _environment(seed, vision=True)
