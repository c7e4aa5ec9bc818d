"""A soft fingertip with taxels rolls a pen, then slides over it: what it feels.

A rolling pen moves half as fast as the finger. So the pressure wanders back along the fingertip, nearly half as far as
the finger goes. When the pen meets a stop, the finger drags the skin until friction gives way. The shear then stays at
about μ times the pressure. Run `python examples/taxels.py --out out`; it needs `pip install "mjframes[video]"`.
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

Array = NDArray[np.float64]

MODEL = Path(__file__).parent.parent / "models" / "fingertip.npz"
PLATE = 3  # label of the fingertip's back
FRAMES, FRICTION, FORCE = 4, 0.6, 3.0  # [N]
RADIUS, START = 0.006, -0.007  # of the pen [m]; where it touches the fingertip at first [m]
SHAPE, SIZE, TOP = (20, 12), (0.025, 0.015), 0.01  # taxels; [m]
PRESSING, ROLLED, STOPPED, END = 0.3, 1.2, 1.6, 2.0  # [s]: the finger goes until `STOPPED`
SPEED = 0.02  # of the finger [m/s]
SCENE = f"""<mujoco>
<option timestep="0.002" cone="elliptic" impratio="10"/>
<statistic center="0 .01 .02" extent=".09"/>
<visual>
  <headlight ambient=".45 .45 .45" diffuse=".35 .35 .35" specular=".1 .1 .1"/>
  <quality shadowsize="4096"/><global offwidth="1280" offheight="720"/>
</visual>
<default><geom solref=".004 1"/></default>
<asset>
  <texture name="sky" type="skybox" builtin="flat" rgb1=".93 .94 .96" rgb2=".93 .94 .96" width="8" height="48"/>
</asset>
<worldbody>
  <light pos="-.15 -.2 .4" dir=".3 .5 -.8" type="spot" cutoff="60" diffuse=".7 .7 .7"/>
  <camera name="side" pos=".095 .008 .034" xyaxes="0 1 0 -.2 0 1"/>
  <geom name="table" type="plane" size=".3 .3 .1" friction="2" rgba=".72 .75 .78 1"/>
  <geom name="stop" type="box" pos="0 {SPEED * (ROLLED - PRESSING) / 2 + 2 * RADIUS:g} .003" size=".06 {RADIUS:g} .003"
        friction="2" rgba=".4 .42 .46 1"/>
  <body name="pen" pos="0 0 {RADIUS:g}">
    <freejoint/>
    <geom type="cylinder" size="{RADIUS:g} .05" euler="0 90 0" mass=".02" rgba=".1 .25 .6 1"/>
    <geom type="box" size=".001 .0005 .0045" pos=".0505 0 0" mass="1e-4" rgba="1 1 1 1" contype="0" conaffinity="0"/>
  </body>
  <body name="hand" gravcomp="1" pos="0 {START:g} {2 * RADIUS + TOP + 0.0005:g}">
    <joint name="down" type="slide" axis="0 0 -1" damping="5"/>
    <joint name="along" type="slide" axis="0 1 0"/>
    <geom type="box" pos="0 0 .009" size=".011 .017 .006" mass=".1" rgba=".3 .32 .36 1" contype="0" conaffinity="0"/>
  </body>
</worldbody>
<actuator>
  <motor name="press" joint="down"/>
  <position name="move" joint="along" kp="2000" dampratio="1"/>
</actuator>
</mujoco>"""


@dataclass(frozen=True, eq=False)
class Felt:
    """What the taxels feel, over time.

    time: (t,) [s].  traction: (t, rows, columns, 3) [Pa].  force: (t, 3) on the fingertip, in the world [N].
    centre: (t,) where it is pressed, along the fingertip [m].  gone: (t,) how far the finger has gone [m].
    """

    time: Array
    traction: Array
    force: Array
    centre: Array
    gone: Array

    def at(self, time: float) -> int:
        return int(np.searchsorted(self.time, time))

    @property
    def grip(self) -> Array:
        """(t,) shear over pressure, of all taxels [-]."""
        pressure, shear = self.traction[..., 0].sum(axis=(1, 2)), self.traction[..., 1:].sum(axis=(1, 2))
        return np.linalg.norm(shear, axis=1) / np.maximum(pressure, 1)


def finger_and_pen() -> mujoco.MjModel:
    spec = mujoco.MjSpec.from_string(SCENE)
    volume = mf.Volume.load(MODEL)
    tip = mf.build(volume, FRAMES, supports=mf.Fixed(volume.labels == PLATE), damping=(0.0, 0.003))
    contact = mf.Contact(friction=(FRICTION,), solref=(0.006, 1.0), priority=1)
    mf.attach(spec, tip, "tip", "hand", quat=(0, 1, 0, 0), contact=contact)  # upside down: its y is the world's −y
    grid = mf.TaxelGrid((0, 0, TOP), (0, 0, 1), SIZE, SHAPE, along=(0, -1, 0))
    for quantity in ("traction", "resultant", "pressure_centre"):
        mf.add_taxels(spec, tip, "tip", grid, quantity)
    return spec.compile()


def roll(model: mujoco.MjModel, watch: Callable[[mujoco.MjData], None] = lambda data: None) -> Felt:
    """Press, roll, slide, wait; `watch` is called before every step."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    rows = []
    while data.time < END:
        data.actuator("press").ctrl = FORCE * min(1.0, data.time / PRESSING)
        data.actuator("move").ctrl = SPEED * np.clip(data.time - PRESSING, 0, STOPPED - PRESSING)
        watch(data)
        mujoco.mj_step(model, data)
        hand, gone = data.body("hand").xpos, data.joint("along").qpos[0]
        along = data.sensor("tip_pressure_centre").data[1] - hand[1]
        traction, force = (data.sensor(f"tip_{name}").data.copy() for name in ("traction", "resultant"))
        rows.append((data.time, traction.reshape(*SHAPE, 3), force, along, gone))
    return Felt(*map(np.array, zip(*rows, strict=True)))


def plot(felt: Felt, path: Path) -> None:
    from matplotlib.figure import Figure

    moments = {"pressed": PRESSING, "rolling": (PRESSING + ROLLED) / 2, "at the stop": ROLLED, "sliding": STOPPED}
    figure = Figure(figsize=(10, 7), layout="constrained")
    rooms = figure.add_gridspec(2, 4, height_ratios=(1.3, 1))
    maps = [figure.add_subplot(rooms[0, i]) for i in range(len(moments))]
    images = []
    height, width = (1e3 * length for length in SIZE)
    for axes, (name, time) in zip(maps, moments.items(), strict=True):
        image = axes.imshow(
            1e-3 * felt.traction[felt.at(time), ..., 0],
            vmin=0,
            vmax=1e-3 * felt.traction[felt.at(PRESSING) :, ..., 0].max(),
            extent=(-width / 2, width / 2, -height / 2, height / 2),
            origin="lower",
            cmap="magma",
        )
        images.append(image)
        axes.set(title=f"{name}, {time:g} s", xlabel="across [mm]")
    maps[0].set_ylabel("along the fingertip [mm]")
    figure.colorbar(images[0], ax=maps, label="pressure [kPa]")
    left, right = figure.add_subplot(rooms[1, :2]), figure.add_subplot(rooms[1, 2:])
    left.plot(felt.time, felt.force[:, 2], label="pressed")
    left.plot(felt.time, -felt.force[:, 1], label="dragged")
    left.plot(felt.time, FRICTION * felt.force[:, 2], "k:", label="μ × pressed")
    left.set(xlabel="time [s]", ylabel="force [N]", xlim=(0, END))
    left.legend(loc=(0.2, 0.62))  # between the curves
    right.plot(felt.time, 1e3 * felt.centre, label="centre of pressure")
    start = felt.at(PRESSING)
    right.plot(
        felt.time[start:], 1e3 * (felt.centre[start] - felt.gone[start:] / 2), "k:", label="rolling without slip"
    )
    right.set(xlabel="time [s]", ylabel="along the fingertip [mm]", xlim=(0, END))
    right.legend()
    figure.savefig(path, dpi=110)


def run(out: Path) -> Felt:
    """Write taxels.png and taxels.mp4 to `out`."""
    out.mkdir(parents=True, exist_ok=True)
    model = finger_and_pen()
    with mf.film(model, out / "taxels.mp4", camera="side") as draw:

        def watch(data: mujoco.MjData) -> None:
            if int(30 * data.time) > int(30 * (data.time - model.opt.timestep)):
                draw(data)

        felt = roll(model, watch)
    plot(felt, out / "taxels.png")
    return felt


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder of taxels.png and taxels.mp4")
    found = run(parser.parse_args().out)
    start, end = found.at(PRESSING), found.at(ROLLED)
    moved, gone = (found.centre[start] - found.centre[end], found.gone[end] - found.gone[start])
    print(f"The finger goes {1e3 * gone:.1f} mm, and the pressure wanders {1e3 * moved:.1f} mm along it;")
    print(f"it slides at {found.grip[found.at(STOPPED)]:.2f} times the force that presses; friction is {FRICTION}.")
