"""A soft ball between two plates against Hertz: F = 4/3 E* √R δ^1.5, E* = E / (1 − ν²), δ the approach to one plate.

The ball as a whole is as stiff as its finite elements, but frames cannot make the dent under a contact area of radius
a = √(R δ) that is smaller than their distance: at δ = 8 mm the force is 1.2 to 1.7 times Hertz's with
`mf.Contact(dents=False)`. By default the contact makes the dent, and the force is 0.8 to 1.2 times Hertz's.
Run `python examples/hertz.py --out out`; it needs matplotlib (`pip install "mjframes[plot]"`).
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

import mjframes as mf

Array = NDArray[np.float64]

RADIUS, YOUNG, POISSON, ACROSS = 0.05, 1e5, 0.3, 24  # [m], [Pa], [-], [voxels]
APPROACH = np.array([0.004, 0.006, 0.008])  # [m]
FRAMES = (5, 10, 20)
COLORS = ("tab:blue", "tab:orange", "tab:green")
SCENE = f"""<mujoco><option gravity="0 0 0" timestep="0.005"/><worldbody>
<body name="below" mocap="true" pos="0 0 -{RADIUS + 0.01}"><geom type="box" size=".1 .1 .01"/></body>
<body name="above" mocap="true" pos="0 0 {RADIUS + 0.01}"><geom name="above" type="box" size=".1 .1 .01"/></body>
</worldbody></mujoco>"""


@dataclass(frozen=True, eq=False)
class Pressed:
    """ratio: (2, frames, approaches) of the force to Hertz's, without and with dents.

    exponent: (2, frames) of force over approach.
    """

    ratio: Array
    exponent: Array


def hertz(approach: Array) -> Array:
    """[N]"""
    return 4 / 3 * YOUNG / (1 - POISSON**2) * np.sqrt(RADIUS) * approach**1.5


def forces(frames: int, dents: bool) -> Array:
    """On one plate, at each approach [N]."""
    center = (np.arange(ACROSS) + 0.5) * 2 * RADIUS / ACROSS - RADIUS
    x, y, z = np.meshgrid(center, center, center, indexing="ij")
    ball = (x**2 + y**2 + z**2 < RADIUS**2).astype(np.uint8)
    rubber = mf.Material(YOUNG, POISSON, 1000)
    volume = mf.Volume.from_labels(ball, 2 * RADIUS / ACROSS, {1: rubber}, origin=(-RADIUS,) * 3)
    body = mf.build(volume, frames, damping=(0.0, 0.1))
    spec = mujoco.MjSpec.from_string(SCENE)
    contact = mf.Contact(condim=1, solref=(0.01, 1), solimp=(0.99, 0.99), priority=1, dents=dents)
    mf.attach(spec, body, "ball", contact=contact)
    mf.choose_solver(spec)
    model = spec.compile()
    data = mujoco.MjData(model)
    start, before, found = data.mocap_pos.copy(), 0.0, []
    for approach in APPROACH:
        for share in np.minimum(np.arange(1, 61) / 20, 1):
            data.mocap_pos[:] = start * (1 - (before + share * (approach - before)) / start[1, 2])
            mujoco.mj_step(model, data)
        before = approach
        mujoco.mj_forward(model, data)
        found.append(_force_on(model, data, model.geom("above").id))
    return np.array(found)


def _force_on(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> float:
    """[N] along the contacts' normals."""
    total, force = 0.0, np.zeros(6)
    for number, touch in enumerate(data.contact):
        if geom in touch.geom:
            mujoco.mj_contactForce(model, data, number, force)
            total += force[0]
    return total


def press() -> Pressed:
    force = np.array([[forces(frames, dents) for frames in FRAMES] for dents in (False, True)])
    exponent = np.polyfit(np.log(APPROACH), np.log(force).reshape(-1, len(APPROACH)).T, 1)[0]
    return Pressed(force / hertz(APPROACH), exponent.reshape(2, -1))


def run(out: Path) -> Pressed:
    """Write hertz.png to `out`."""
    from matplotlib.figure import Figure

    out.mkdir(parents=True, exist_ok=True)
    pressed = press()
    figure = Figure(figsize=(10, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    fine = np.linspace(0, 1.1 * APPROACH[-1], 100)
    left.plot(1e3 * fine, hertz(fine), "k", label="Hertz")
    for color, frames, without, with_dents in zip(COLORS, FRAMES, *pressed.ratio, strict=True):
        left.plot(1e3 * APPROACH, without * hertz(APPROACH), "o:", color=color, label=f"{frames} frames")
        left.plot(1e3 * APPROACH, with_dents * hertz(APPROACH), "o-", color=color, label=f"{frames} frames, dents")
    left.set(xlabel="approach to one plate [mm]", ylabel="force [N]")
    left.legend()
    for color, approach, without, with_dents in zip(COLORS, APPROACH, *pressed.ratio.transpose(0, 2, 1), strict=True):
        right.semilogx(FRAMES, without, "o:", color=color, label=f"{1e3 * approach:g} mm")
        right.semilogx(FRAMES, with_dents, "o-", color=color, label=f"{1e3 * approach:g} mm, dents")
    right.axhline(1, color="k", linewidth=0.8)
    right.set(xlabel="frames", ylabel="force / Hertz's", ylim=(0, None))
    right.set_xticks(FRAMES, map(str, FRAMES))
    right.minorticks_off()
    right.legend(title="approach", loc="lower center", ncols=2)
    figure.savefig(out / "hertz.png", dpi=110)
    return pressed


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder of hertz.png")
    result = run(parser.parse_args().out)
    for name, ratios, exponents in zip(("without dents", "with dents"), result.ratio, result.exponent, strict=True):
        for frames, power, row in zip(FRAMES, exponents, ratios, strict=True):
            times = ", ".join(f"{ratio:.2f}" for ratio in row)
            print(f"{name}, {frames} frames: {times} times Hertz's force, which grows with δ^{power:.2f}")
