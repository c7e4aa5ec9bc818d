"""Two soft fingertips pick up a peach and hold it: soft things of several materials that touch each other.

Run `python examples/fingertips.py --out out`; it needs the extra of films (`pip install "mjframes[video]"`).
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

import mjframes as mf

MODELS = Path(__file__).parent.parent / "models"
PLATE = 3  # label of the fingertip's back
FINGERTIP_FRAMES, PEACH_FRAMES = 3, 5
REST = 0.0305  # [m] height of the peach's middle where it lies on its side
OPEN, CLOSING, LIFTING, END, HEIGHT, FORCE = 0.048, 0.5, 1.3, 2.0, 0.08, 8.0  # [m], [s], [s], [s], [m], [N] a finger

_FINGER = """<body name="{side}" pos="0 {y} {rest}">
        <joint name="{side}" type="slide" axis="0 {inwards} 0" range="0 .04" damping="20" armature=".05"/>
        <geom type="box" pos="0 {back} .02" size=".012 .005 .04" mass=".05" rgba=".3 .32 .36 1"/>
      </body>"""
SCENE = f"""<mujoco>
<option cone="elliptic" impratio="10"/>
<statistic center="0 0 .06" extent=".3"/>
<visual>
  <headlight ambient=".45 .45 .45" diffuse=".35 .35 .35" specular=".1 .1 .1"/>
  <quality shadowsize="4096"/><global offwidth="1280" offheight="720"/>
</visual>
<asset>
  <texture name="sky" type="skybox" builtin="flat" rgb1=".93 .94 .96" rgb2=".93 .94 .96" width="8" height="48"/>
</asset>
<worldbody>
  <light pos="-.25 -.4 .7" dir=".3 .5 -.8" type="spot" cutoff="60" diffuse=".7 .7 .7"/>
  <camera name="front" pos=".28 -.1 .15" xyaxes=".34 .94 0 -.27 .1 .96"/>
  <geom name="table" type="plane" size=".5 .5 .1" rgba=".72 .75 .78 1"/>
  <body name="hand">
    <joint name="lift" type="slide" axis="0 0 1" damping="20"/>
    <geom type="box" pos="0 0 .1" size=".015 .065 .008" mass=".3" rgba=".5 .52 .56 1"/>
      {_FINGER.format(side="left", y=OPEN, inwards=-1, back=0.008, rest=REST)}
      {_FINGER.format(side="right", y=-OPEN, inwards=1, back=-0.008, rest=REST)}
  </body>
</worldbody>
<contact><exclude body1="left" body2="right"/></contact>
<equality><joint joint1="left" joint2="right" solref=".005 1"/></equality>
<actuator>
  <position name="lift" joint="lift" kp="5000" dampratio="1"/>
  <motor name="left" joint="left"/><motor name="right" joint="right"/>
</actuator>
</mujoco>"""
# the pad points inwards, its y down along the finger
INWARDS = {"left": (0.0, 0.0, 1.0, -1.0), "right": (1.0, -1.0, 0.0, 0.0)}
AROUND_STONE = np.array([(0.0, 0.0, 0.0), (0.01, 0.0, 0.0), (0.0, 0.0, 0.01)])  # [m] material points of the peach


@dataclass(frozen=True, eq=False)
class Grip:
    """A hand that holds a peach.

    rise: of the peach's stone [m].  slip: how far the stone has moved along the fingers since they lift [m].
    squeeze: how much nearer the fingertips' plates are than where the pads first touched the peach [m].
    """

    model: mujoco.MjModel
    data: mujoco.MjData
    rise: float
    slip: float
    squeeze: float


def hand_and_peach() -> tuple[mujoco.MjModel, mf.SoftBody]:
    """The scene and the peach in it: a hand over a table, its fingers on either side of the peach, which lies there."""
    spec = mujoco.MjSpec.from_string(SCENE)
    volume = mf.Volume.load(MODELS / "fingertip.npz")
    tip = mf.build(volume, FINGERTIP_FRAMES, supports=mf.Fixed(volume.labels == PLATE), damping=(0.0, 0.003))
    peach = mf.build(MODELS / "peach.npz", PEACH_FRAMES, damping=(0.0, 0.003))
    contact = mf.Contact(friction=(0.8,), solref=(0.006, 1.0))
    for side, quat in INWARDS.items():
        mf.attach(spec, tip, f"{side}_tip", side, quat=quat, contact=contact)
    mf.attach(spec, peach, "peach", pos=(0, 0, REST + 0.0005), quat=(1, 0, 1, 0), contact=contact)
    return spec.compile(), peach


def grip(model: mujoco.MjModel, built: mf.SoftBody, watch: Callable[[mujoco.MjData], None] = lambda data: None) -> Grip:
    """Close, lift, hold; `watch` is called before every step."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    peach = mf.soft(model, data, "peach", built)
    start, touched, lifted = peach.positions(AROUND_STONE), 0.0, None
    while data.time < END:
        rising = np.clip((data.time - CLOSING) / (LIFTING - CLOSING), 0, 1)
        data.actuator("lift").ctrl = HEIGHT * rising**2 * (3 - 2 * rising)
        for side in INWARDS:
            data.actuator(side).ctrl = FORCE * min(1.0, 2 * data.time / CLOSING)
        watch(data)
        mujoco.mj_step(model, data)
        if not touched and any(_between(model, contact.geom) for contact in data.contact):
            touched = float(data.joint("left").qpos[0])
        if lifted is None and data.time >= CLOSING:
            lifted = _in_hand(data, peach)
    mujoco.mj_forward(model, data)
    assert lifted is not None
    rise = (peach.positions(AROUND_STONE) - start)[0, 2]
    slip = np.linalg.norm((_in_hand(data, peach) - lifted)[:, [0, 2]], axis=1).max()
    return Grip(model, data, float(rise), float(slip), float(data.joint("left").qpos[0] - touched))


def _between(model: mujoco.MjModel, geoms: np.ndarray) -> bool:
    """Whether two geoms that touch are the peach's and a fingertip's."""
    owners = {model.body(model.geom_bodyid[geom]).name.partition(":")[0] for geom in geoms}
    return "peach" in owners and len(owners) == 2 and "world" not in owners


def _in_hand(data: mujoco.MjData, peach: mf.Soft) -> np.ndarray:
    """Where the material points are, seen from the hand [m]."""
    return peach.positions(AROUND_STONE) - data.body("hand").xpos


def run(out: Path) -> Grip:
    """Write fingertips.mp4 to `out`."""
    out.mkdir(parents=True, exist_ok=True)
    model, peach = hand_and_peach()
    with mf.film(model, out / "fingertips.mp4", camera="front") as draw:

        def watch(data: mujoco.MjData) -> None:
            if int(30 * data.time) > int(30 * (data.time - model.opt.timestep)):
                draw(data)

        return grip(model, peach, watch)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder of fingertips.mp4")
    found = run(parser.parse_args().out)
    print(f"The peach rises by {1e3 * found.rise:.1f} mm and slips by {1e3 * found.slip:.2f} mm;")
    print(f"each fingertip is pressed {1e3 * found.squeeze:.1f} mm in.")
