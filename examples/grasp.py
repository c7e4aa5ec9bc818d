"""A gripper lifts what it holds and keeps it: a soft block between rigid fingers, a rigid block between soft pads.

Run `python examples/grasp.py --out out`. The gripper is two fingers on slides unless `--gripper` names another: an MJCF
file such as MuJoCo Menagerie's robotiq_2f85/2f85.xml, of whose names this one uses the same.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

import mjframes as mf

BLOCK, MASS, VOXEL = 0.04, 0.08, 0.0025  # [m], [kg], [m]
FLESH, CORE, RUBBER = mf.Material(1e5, 0.45, 1000), mf.Material(6e5, 0.4, 2000), mf.Material(5e5, 0.45, 1100)
PAD, BACKING, FACE = (0.0225, 0.006, 0.036), 0.002, -0.0066  # [m] size, its glued part; y of the finger's face
PINCH, PEDESTAL = 0.152, 0.05  # [m] below the mount, of the block's middle; height of what the block stands on
CLOSED, LIFTED, END, HEIGHT = 1.0, 2.5, 12.5, 0.1  # [s], [m]: it closes, lifts by HEIGHT, holds until END
SIDES = ("gripper_right_pad", "gripper_left_pad")
GRIP = 150.0  # the set point of closed fingers, of 255: the pads of a 2F-85 tilt when more presses on a soft block

SCENE = f"""<mujoco>
<option cone="elliptic" impratio="100"/>
<visual><headlight ambient=".4 .4 .4"/><global offwidth="1280" offheight="720"/></visual>
<asset><texture name="sky" type="skybox" builtin="flat" rgb1=".95 .95 .95" rgb2=".95 .95 .95" width="8" height="48"/>
</asset>
<worldbody>
  <light pos=".3 -.5 .8" dir="-.3 .5 -.8"/>
  <camera name="front" pos=".1 -.34 .2" xyaxes="1 .28 0 -.03 .1 1"/>
  <geom name="floor" type="plane" size=".5 .5 .1" rgba=".8 .82 .85 1"/>
  <geom name="pedestal" type="box" size=".012 .012 {PEDESTAL / 2}" pos="0 0 {PEDESTAL / 2}" rgba=".6 .6 .6 1"/>
  <body name="hand" pos="0 0 {PEDESTAL + BLOCK / 2 + PINCH}" quat="0 1 0 0">
    <joint name="lift" type="slide" axis="0 0 -1"/>
    <inertial pos="0 0 0" mass="1" diaginertia=".01 .01 .01"/>
  </body>
</worldbody>
<actuator><position name="lift" joint="lift" kp="20000" dampratio="1"/></actuator>
</mujoco>"""

_FINGER = """<body name="{side}_pad" pos="0 {y} .1325" quat="{quat}">
      <joint name="{side}" type="slide" axis="0 -1 0" range="0 .04" damping="60" armature=".05"/>
      <geom type="capsule" fromto="0 .004 -.09 0 .004 .02" size=".006" mass=".05"/>
      <geom name="{side}_pad" type="box" pos="0 -.0026 .01875" size=".011 .004 .01875" mass=".02" friction=".7"
        solimp=".95 .99 .001" solref=".004 1" priority="1" rgba=".3 .3 .3 1"/>
    </body>"""
GRIPPER = f"""<mujoco>
<worldbody>
  <body name="base" quat="1 0 0 -1">
    <geom type="box" pos="0 0 .035" size=".02 .06 .012" mass=".3" rgba=".5 .5 .55 1"/>
    {_FINGER.format(side="right", y=".045", quat="1 0 0 0")}
    {_FINGER.format(side="left", y="-.045", quat="0 0 0 1")}
  </body>
</worldbody>
<tendon><fixed name="split"><joint joint="right" coef=".5"/><joint joint="left" coef=".5"/></fixed></tendon>
<equality><joint joint1="right" joint2="left" solref=".005 1"/></equality>
<actuator><motor name="fingers_actuator" tendon="split" gear=".12" ctrlrange="0 255"/></actuator>
</mujoco>"""


@dataclass(frozen=True, eq=False)
class Grasp:
    """A scene in which a gripper holds a block.

    built: what the soft bodies are.  touching: material points (n, 3) of each soft body that are to stay where they are
    in a body of the scene, in volume coordinates [m], and that body.  normal: its axis across the contact.  held: name
    of the block's body, where it is rigid.
    """

    model: mujoco.MjModel
    data: mujoco.MjData
    built: mf.SoftBody
    touching: tuple[tuple[str, str, NDArray[np.float64]], ...]
    normal: int
    held: str = ""

    @property
    def height(self) -> float:
        """Of the block's middle [m]."""
        if self.held:
            return float(self.data.body(self.held).xpos[2])
        (name, _, points), *_ = self.touching
        return float(mf.soft(self.model, self.data, name, self.built).positions(np.zeros_like(points[:1]))[0, 2])

    def places(self) -> NDArray[np.float64]:
        """(n, 3) of the touching points, in the bodies that they touch [m]."""
        places = []
        for name, body, points in self.touching:
            x = mf.soft(self.model, self.data, name, self.built).positions(points)
            other = self.data.body(body)
            places.append((x - other.xpos) @ other.xmat.reshape(3, 3))
        return np.concatenate(places)


def soft_block(gripper: str | None = None) -> Grasp:
    """A block of soft flesh with a firmer core between rigid fingers."""
    spec = _scene(gripper)
    count = round(BLOCK / VOXEL)
    labels = np.ones((count, count, count), int)
    labels[4:-4, 4:-4, 4:-4] = 2
    volume = mf.Volume.from_labels(labels, VOXEL, {1: FLESH, 2: CORE}, origin=(-BLOCK / 2,) * 3)
    block = mf.build(volume, frames=4, damping=(0.0, 0.005))
    mf.attach(spec, block, "block", pos=(0, 0, PEDESTAL + BLOCK / 2))
    y, z = np.meshgrid((-0.005, 0.0, 0.005), (-0.008, 0.0, 0.008))
    points = [np.stack([np.full(9, x), y.ravel(), z.ravel()], axis=1) for x in (BLOCK / 2, -BLOCK / 2)]
    return _grasp(spec, block, tuple(("block", side, at) for side, at in zip(SIDES, points, strict=True)), normal=1)


def soft_pads(gripper: str | None = None) -> Grasp:
    """A rigid block between fingers with pads of rubber."""
    spec = _scene(gripper)
    block = spec.worldbody.add_body(name="block", pos=(0, 0, PEDESTAL + BLOCK / 2))
    block.add_freejoint()
    half = (BLOCK / 2,) * 3
    block.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=half, mass=MASS, rgba=(0.75, 0.45, 0.3, 1))
    shape = [round(PAD[0] / 0.0025), round(PAD[1] / 0.002), round(PAD[2] / 0.003)]
    labels = np.ones(shape, int)
    back = np.zeros(shape, bool)
    back[:, -round(BACKING / 0.002) :] = True
    origin = (-PAD[0] / 2, FACE - PAD[1], 0.0)
    volume = mf.Volume.from_labels(labels, (0.0025, 0.002, 0.003), {1: RUBBER}, origin=origin)
    pad = mf.build(volume, frames=4, damping=(0.0, 0.002), supports=[mf.Fixed(back)])
    contact = mf.Contact(friction=(0.7,), solref=(0.004, 1.0), solimp=(0.95, 0.99, 0.001), priority=2)
    for side in SIDES:
        mf.attach(spec, pad, f"{side}_rubber", side, contact=contact)
    x, z = np.meshgrid((-0.006, 0.0, 0.006), (0.012, 0.018, 0.024))
    points = np.stack([x.ravel(), np.full(9, FACE - PAD[1]), z.ravel()], axis=1)
    return _grasp(spec, pad, tuple((f"{side}_rubber", "block", points) for side in SIDES), normal=0, held="block")


def lift(grasp: Grasp, watch: Callable[[mujoco.MjData], None] = lambda data: None) -> float:
    """Close, lift, hold; `watch` is called before every step.

    Returns the slip: how far any touching point moved along what it touches since the fingers closed [m].
    """
    model, data = grasp.model, grasp.data
    lift, fingers = (data.actuator(name) for name in ("lift", "gripper_fingers_actuator"))
    closed, slip = None, 0.0
    mujoco.mj_forward(model, data)  # places, for the first look
    for _ in range(round(END / model.opt.timestep)):
        rise = np.clip((data.time - CLOSED) / (LIFTED - CLOSED), 0, 1)
        fingers.ctrl[0] = GRIP * min(1.0, 2 * data.time / CLOSED)
        lift.ctrl[0] = HEIGHT * rise**2 * (3 - 2 * rise)
        watch(data)
        mujoco.mj_step(model, data)
        if closed is None and data.time > CLOSED - model.opt.timestep / 2:
            closed = grasp.places()
        if closed is not None and round(data.time / model.opt.timestep) % 25 == 0:
            moved = grasp.places() - closed
            moved[:, grasp.normal] = 0
            slip = max(slip, float(np.linalg.norm(moved, axis=1).max()))
    mujoco.mj_forward(model, data)
    return slip


def every(period: float, draw: Callable[[mujoco.MjData], None]) -> Callable[[mujoco.MjData], None]:
    """Something that is called in every step and calls `draw` once in a `period` [s]."""
    count = 0

    def watch(data: mujoco.MjData) -> None:
        nonlocal count
        if data.time >= count * period - 1e-9:
            count += 1
            draw(data)

    return watch


def run(out: Path, gripper: str | None = None) -> dict[str, float]:
    """Write soft_block.mp4 and soft_pads.mp4 to `out`; returns the slip in each [m]."""
    out.mkdir(parents=True, exist_ok=True)
    slips = {}
    for scene in (soft_block, soft_pads):
        grasp = scene(gripper)
        with mf.film(grasp.model, out / f"{scene.__name__}.mp4", camera="front") as draw:
            slips[scene.__name__] = lift(grasp, every(1 / 30, draw))
    return slips


def _scene(gripper: str | None) -> mujoco.MjSpec:
    spec = mujoco.MjSpec.from_string(SCENE)
    hand = mujoco.MjSpec.from_string(GRIPPER) if gripper is None else mujoco.MjSpec.from_file(gripper)
    hand.option.impratio = spec.option.impratio  # MuJoCo warns of two minds
    spec.attach(hand, frame=spec.body("hand").add_frame(), prefix="gripper_")
    return spec


def _grasp(
    spec: mujoco.MjSpec,
    built: mf.SoftBody,
    touching: tuple[tuple[str, str, NDArray[np.float64]], ...],
    normal: int,
    held: str = "",
) -> Grasp:
    mf.choose_solver(spec)
    model = spec.compile()
    return Grasp(model, mujoco.MjData(model), built, touching, normal, held)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder to write to (default: out)")
    parser.add_argument("--gripper", help="MJCF of a gripper with the names of robotiq_2f85 (default: two slides)")
    arguments = parser.parse_args()
    for scene, slip in run(arguments.out, arguments.gripper).items():
        print(f"{scene}: slips by {1e3 * slip:.3f} mm in {END - CLOSED:g} s.")
