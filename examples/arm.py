"""A soft arm with three cables hangs down and moves its tip to targets.

Each cable runs beside the middle from the base to the tip, so that its tension bends the arm to its side. The arm
measures once how far a little tension in each cable moves its tip. Then it adds, a hundred times a second, as much
tension as would take away a part of what is left to the target. Motors on the cables' lengths make it.
Run `python examples/arm.py --out out`; it needs matplotlib (`pip install "mjframes[video]"`).
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

import mjframes as mf

EDGE = 0.003  # [m] of a voxel
LENGTH, RADIUS = 60, 5  # [voxels]
ASIDE = 3.5 * EDGE  # [m] of the cables from the middle
SIDES = np.array([(np.cos(a), np.sin(a)) for a in np.radians((90, 210, 330))])
STOPS = 12  # places where a cable is held
FRAMES = 6
MOST = 10.0  # [N]
TRIAL = 0.2  # [N] with which each cable's effect is measured
PERIOD = 0.01  # [s] between changes of tension
GAIN = 2.0  # [1/s] at which the error is taken away; with 5 the arm swings
STAY = 3.0  # [s] for each target
FPS = 25
TARGETS = 0.06 * np.array([(np.cos(a), np.sin(a)) for a in np.radians((30, 100, 170, 240, 310))])  # (t, 2) x, y [m]
SCENE = """<mujoco>
<visual><headlight ambient=".5 .5 .5"/><global offwidth="1280" offheight="720"/></visual>
<asset><texture type="skybox" builtin="flat" rgb1=".93 .94 .96" rgb2=".93 .94 .96" width="8" height="48"/></asset>
<worldbody>{targets}<camera name="side" pos=".22 .22 -.04" xyaxes="-.707 .707 0 -.1 -.1 .99"/>
<geom type="cylinder" pos="0 0 .006" size=".02 .006" rgba=".4 .4 .45 1"/></worldbody>
<actuator><motor name="a" tendon="a"/><motor name="b" tendon="b"/><motor name="c" tendon="c"/></actuator>
</mujoco>"""
TARGET = '<geom type="cylinder" pos="{} {} -.1" size=".0015 .07" contype="0" conaffinity="0" rgba=".1 .6 .2 .6"/>'


@dataclass(frozen=True)
class Reached:
    """What happened.

    time: (n,) [s].
    tips: (n, 2) x and y of the tip [m].
    tensions: (n, 3) [N].
    errors: (t,) how far the tip is from each target at the end of its time [m].
    """

    time: np.ndarray
    tips: np.ndarray
    tensions: np.ndarray
    errors: np.ndarray


def arm() -> tuple[mujoco.MjModel, mf.SoftBody]:
    """The scene, and the arm in it: its top is held, its axis is z."""
    cells = np.arange(2 * RADIUS) + 0.5 - RADIUS
    disc = (np.hypot(*np.meshgrid(cells, cells)) < RADIUS).astype(np.uint8)
    labels = np.repeat(disc[..., None], LENGTH, axis=2)
    rubber = mf.Material(young=2e5, poisson=0.4, density=1000, rgba=(0.9, 0.55, 0.35, 0.6))
    corner = (-RADIUS * EDGE, -RADIUS * EDGE, -LENGTH * EDGE)
    volume = mf.Volume.from_labels(labels, EDGE, {1: rubber}, origin=corner)
    body = mf.build(volume, FRAMES, supports=mf.Fixed(volume.side("z")), damping=(0.0, 0.02))
    heights = -EDGE * np.linspace(0.5, LENGTH - 0.5, STOPS)
    cables = {
        name: mf.Fibre([(*(ASIDE * side), height) for height in heights])
        for name, side in zip("abc", SIDES, strict=True)
    }
    spec = mujoco.MjSpec.from_string(SCENE.format(targets="".join(TARGET.format(*target) for target in TARGETS)))
    mf.attach(spec, body, "arm", contact=False, tendons=cables)
    return spec.compile(), body


def tip(view: mf.Soft) -> np.ndarray:
    """Where the middle of the arm's end is (2,) in x and y [m]."""
    return view.positions([(0.0, 0.0, (0.5 - LENGTH) * EDGE)])[0, :2]


def effect(model: mujoco.MjModel, body: mf.SoftBody) -> np.ndarray:
    """How far the tip moves for each tension (2, 3) [m/N], measured one cable after the other."""
    columns = []
    for cable in range(3):
        data = mujoco.MjData(model)
        view = mf.soft(model, data, "arm", body)
        ends = []
        for tension in (0.0, TRIAL):
            data.ctrl[cable] = -tension
            mujoco.mj_step(model, data, nstep=round(STAY / model.opt.timestep))
            ends.append(tip(view))
        columns.append((ends[1] - ends[0]) / TRIAL)
    return np.transpose(columns)


def reach(
    model: mujoco.MjModel, body: mf.SoftBody, watch: Callable[[mujoco.MjData], None] = lambda data: None
) -> tuple[Reached, mujoco.MjData]:
    """Move to each target in turn; return what happened, and the last state.  watch: called every PERIOD."""
    turn = np.linalg.pinv(effect(model, body))
    data = mujoco.MjData(model)
    view = mf.soft(model, data, "arm", body)
    times, tips, tensions, errors = [], [], [], []
    for target in TARGETS:
        for _ in range(round(STAY / PERIOD)):
            wanted = GAIN * PERIOD * turn @ (target - tip(view)) - data.ctrl
            data.ctrl = -np.clip(wanted - wanted.min(), 0.0, MOST)  # what all three have in common only presses
            mujoco.mj_step(model, data, nstep=round(PERIOD / model.opt.timestep))
            times.append(data.time)
            tips.append(tip(view))
            tensions.append(-data.ctrl)
            watch(data)
        errors.append(float(np.linalg.norm(target - tips[-1])))
    return Reached(np.array(times), np.array(tips), np.array(tensions), np.array(errors)), data


def plot(found: Reached, path: Path) -> None:
    """Write the tip's way and the tensions to a picture."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    left.plot(*(1e3 * found.tips.T), lw=1, label="tip")
    left.plot(*(1e3 * TARGETS.T), "g^", label="targets")
    left.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal")
    left.legend()
    right.plot(found.time, found.tensions, label=["cable a", "cable b", "cable c"])
    right.set(xlabel="time [s]", ylabel="tension [N]")
    right.legend()
    figure.savefig(path, dpi=110)


def run(out: Path) -> Reached:
    """Write `arm.mp4` and `arm.png`."""
    out.mkdir(parents=True, exist_ok=True)
    model, body = arm()
    with mf.film(model, out / "arm.mp4", camera="side", fps=FPS, size=(640, 360)) as draw:

        def watch(data: mujoco.MjData) -> None:
            if round(data.time / PERIOD) % round(1 / PERIOD / FPS) == 0:
                draw(data)

        found, _ = reach(model, body, watch)
    plot(found, out / "arm.png")
    return found


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder to write to (default: out)")
    ends = run(parser.parse_args().out).errors
    print("from the tip to each target [mm]:", ", ".join(f"{1e3 * error:.2f}" for error in ends))
