"""The scenes in which steps are timed: soft bodies, and the same MuJoCo bodies without the plugin.

A scene is timed from a state shortly after first contact on, for the same time in every run. "Bare" are the same
MuJoCo bodies, of the same masses on the same slides, from whose model the plugin was taken out, which is what any such
tree of bodies costs in MuJoCo, with as many contacts, between spheres and the floor.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import mujoco
import numpy as np

from benchmarks.contenders.side_by_side import integration_state, mean_contacts, processor_seconds
from mjframes.body.soft_body import SoftBody
from mjframes.scene.attach import attach
from mjframes.scene.solver import choose_solver

SCENES = {
    "free": "it falls freely",
    "contact": "it falls on the edge of a box",
    "stack": "three of it fall on the floor and on each other",
    "grasp": "it lies on a finger, and another presses it there with twice its weight",
}
OURS, BARE = "mjframes", "bodies alone"

TIMESTEP = 2e-3  # [s]
FALL = 60  # steps before the measured ones: from here on bodies lie on what is below them
GAP = 2e-3  # [-] of the body's length between it and what is below it at the start
PRESS = 2.0  # [-] of the body's weight
FINGER_MASS = 0.1  # [-] of the body's


class Steps(Protocol):
    """Steps that can be repeated, each time from the same state on.

    body: what it is called.  frames: of a soft body.  contender: what steps, see `OURS`.
    """

    @property
    def body(self) -> str: ...
    @property
    def frames(self) -> int: ...
    @property
    def scene(self) -> str: ...
    @property
    def contender(self) -> str: ...
    @property
    def dofs(self) -> int: ...

    def step(self, steps: int) -> float:
        """Return the processor time of so many steps [s]: on a busy machine wall time tells what else it does."""
        ...

    def contacts(self, steps: int) -> tuple[float, float]:
        """Return the mean numbers of contacts and of the solver's iterations over the steps."""
        ...


@dataclass(frozen=True, eq=False)
class Run:
    """Steps of a model of this process: `state` is where they start."""

    body: str
    frames: int
    scene: str
    contender: str
    model: mujoco.MjModel
    data: mujoco.MjData
    state: np.ndarray

    @property
    def dofs(self) -> int:
        return self.model.nv

    def step(self, steps: int) -> float:
        return processor_seconds(self.model, self.data, self.state, steps)

    def contacts(self, steps: int) -> tuple[float, float]:
        return mean_contacts(self.model, self.data, self.state, steps)


@dataclass(frozen=True)
class Extent:
    """The box around a body, in its own coordinates [m], and its mass [kg]."""

    lower: tuple[float, float, float]
    upper: tuple[float, float, float]
    mass: float

    @property
    def size(self) -> np.ndarray:
        return np.subtract(self.upper, self.lower)

    @property
    def gap(self) -> float:
        return GAP * float(self.size.max())


def extent(body: SoftBody) -> Extent:
    """Return that of a soft body."""
    low, high = (end(body.skin.vertices, axis=0).tolist() for end in (np.min, np.max))
    return Extent(tuple(low), tuple(high), float(body.control.mass.sum()))


def surroundings(scene: str, around: Extent) -> mujoco.MjSpec:
    """Return the rigid part of a scene around bodies of that extent."""
    spec = mujoco.MjSpec()
    spec.option.timestep = TIMESTEP
    length, width, height = around.size
    box, world = mujoco.mjtGeom.mjGEOM_BOX, spec.worldbody
    if scene != "free":
        world.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1])
    if scene == "contact":
        half = [length / 2, width, max(length, width) / 12]
        world.add_geom(name="box", type=box, size=half, pos=[half[0] - length / 8, 0, half[2]])
    if scene == "grasp":
        half = [length / 8, width / 8, height / 2]
        world.add_geom(name="finger", type=box, size=half, pos=[0, 0, _top(scene, around) - half[2]])
        above = _top(scene, around) + height + 2 * around.gap + half[2]
        finger = world.add_body(name="above", pos=[0, 0, above], gravcomp=1)
        finger.add_geom(type=box, size=half, mass=FINGER_MASS * around.mass)
        force, far = PRESS * 9.81 * around.mass, 20 * height  # from so far away a spring's force is even
        joint = finger.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0, 0, 1], springref=-far)
        joint.stiffness[0] = force / far
        joint.damping[0] = force / (2 * height)  # it closes by twice the height in a second
    return spec


def places(scene: str, around: Extent) -> list[list[float]]:
    """Return where the scene's bodies go, `pos` of `attach`."""
    middle = np.add(around.lower, around.upper) / 2
    first = np.array([-middle[0], -middle[1], _top(scene, around) + around.gap - around.lower[2]])
    rise = np.array([0, 0, around.size[2] + around.gap])
    return [(first + k * rise).tolist() for k in range(3 if scene == "stack" else 1)]


def soft_run(name: str, body: SoftBody, scene: str) -> Run:
    """Return the steps of a soft body in a scene."""
    return _start(name, len(body.types), scene, OURS, _with_bodies(body, scene, contact=scene != "free"))


def bare_run(name: str, body: SoftBody, scene: str, contacts: float) -> Run:
    """Return the steps of its MuJoCo bodies alone with so many contacts."""
    spec = _with_bodies(body, scene, contact=False)
    for some in spec.bodies:
        some.plugin.active = False
    for instance in list(spec.plugins):
        spec.delete(instance)
    for rigid in ("box", "finger"):
        if (geom := spec.geom(rigid)) is not None:
            spec.delete(geom)
    if (finger := spec.body("above")) is not None:
        spec.delete(finger)
    _add_spheres(spec, round(contacts), float(extent(body).size.max()))
    return _start(name, len(body.types), scene, BARE, spec)


def _with_bodies(body: SoftBody, scene: str, contact: bool) -> mujoco.MjSpec:
    around = extent(body)
    spec = surroundings(scene, around)
    for number, pos in enumerate(places(scene, around)):
        attach(spec, body, f"body{number}", pos=pos, contact=contact)
    choose_solver(spec)
    return spec


def _add_spheres(spec: mujoco.MjSpec, count: int, size: float) -> None:
    """`count` spheres that touch the floor, evenly over the bodies; a body without one falls."""
    data = mujoco.MjData(spec.compile())
    mujoco.mj_kinematics(data.model, data)
    moving = [body for body in spec.bodies if body.joints]
    radius = size / 100
    for number in range(count):
        body = moving[number % len(moving)]
        aside = 3 * radius * (number // len(moving))
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=[radius, 0, 0],
            pos=[aside, 0, radius - data.body(body.name).xpos[2]],
            mass=0,
            contype=1,
            conaffinity=0,
        )


def _start(name: str, frames: int, scene: str, contender: str, spec: mujoco.MjSpec) -> Run:
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=FALL)
    return Run(name, frames, scene, contender, model, data, integration_state(model, data))


def _top(scene: str, around: Extent) -> float:
    """Of what is below the first body [m]."""
    length, width, height = around.size
    return {"contact": max(length, width) / 6, "grasp": 2 * height}.get(scene, 0.0)
