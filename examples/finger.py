"""A soft finger with a chamber of air: a motor on the chamber's volume is a pressure, and bends the finger.

The finger is 10 cm long and held at one end. Its chamber lies above the middle, so that pressure bends it down. Beside
it stand tips of geometrically non-linear finite elements, which `python -m benchmarks.accuracy.actuation` has written.
Run `python examples/finger.py --out out`; it needs matplotlib (`pip install "mjframes[video]"`).
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np

import mjframes as mf

LENGTH, ACROSS = 0.1, 8  # [m], [voxels]
EDGE = LENGTH / (5 * ACROSS)  # [m] of a voxel
PRESSURES = (100.0, 2500.0, 5000.0, 7500.0, 10000.0)  # [Pa]
CHAMBER = mf.Chamber((LENGTH / 2, 4 * EDGE, 5 * EDGE))
TABLE = Path(__file__).parents[1] / "benchmarks" / "accuracy" / "actuation.csv"
SCENE = """<mujoco>
<option gravity="0 0 0"/><visual><headlight ambient=".5 .5 .5"/><global offwidth="1280" offheight="720"/></visual>
<asset><texture type="skybox" builtin="flat" rgb1=".93 .94 .96" rgb2=".93 .94 .96" width="8" height="48"/></asset>
<worldbody/>
<actuator><motor name="pump" tendon="air"/></actuator>
</mujoco>"""


def volume() -> mf.Volume:
    """The finger; its first layer of voxels, before x = 0, is held."""
    labels = np.ones((5 * ACROSS + 1, ACROSS, ACROSS), np.uint8)
    labels[3:-2, 2:-2, ACROSS // 2 : -1] = 0
    rubber = mf.Material(young=2e5, poisson=0.4, density=1000, rgba=(0.9, 0.55, 0.35, 0.6))
    return mf.Volume.from_labels(labels, EDGE, {1: rubber}, origin=(-EDGE, 0, 0))


def finger(frames: int) -> tuple[mujoco.MjModel, mf.SoftBody]:
    """The scene, and the finger in it."""
    whole = volume()
    held = np.zeros(whole.labels.shape, bool)
    held[0] = True
    body = mf.build(whole, frames, supports=mf.Fixed(held))
    spec = mujoco.MjSpec.from_string(SCENE)
    mf.attach(spec, body, "finger", contact=False, tendons={"air": CHAMBER})
    return spec.compile(), body


def reference() -> dict[float, float]:
    """How far the tip moves up in finite elements [m] under pressures [Pa], from the table of the benchmark."""
    with TABLE.open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["body"] == "finger"]
    return {float(row["force"]): float(row["reference"]) for row in rows}


def tips(model: mujoco.MjModel, body: mf.SoftBody, pressures: Sequence[float]) -> tuple[np.ndarray, mujoco.MjData]:
    """How far the mean of the end face has moved at rest under each pressure (p, 3) [m], and the last state."""
    data = mujoco.MjData(model)
    across = EDGE * (np.arange(ACROSS) + 0.5)
    end = np.array([(LENGTH - EDGE / 2, y, z) for y in across for z in across])
    view = mf.soft(model, data, "finger", body)
    mujoco.mj_forward(model, data)
    start, found = view.positions(end), []
    for pressure in pressures:
        data.ctrl[0] = pressure
        mujoco.mj_step(model, data, nstep=3000)
        mujoco.mj_forward(model, data)
        found.append((view.positions(end) - start).mean(axis=0))
    return np.array(found), data


def run(out: Path) -> None:
    """Write the picture `finger.png`."""
    from matplotlib.figure import Figure

    out.mkdir(parents=True, exist_ok=True)
    figure = Figure(figsize=(11, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.2, 1))
    camera = mf.look_from((0.05, 0.01, 0.008), 0.14, 110, -10)
    for frames in (5, 10):
        model, body = finger(frames)
        found, data = tips(model, body, PRESSURES)
        right.plot(np.array(PRESSURES) / 1e3, -1e3 * found[:, 2], "o-", label=f"{frames} frames")
        left.imshow(mf.still(model, data, camera, (960, 720)))
    left.set_axis_off()
    left.set_title("10 kPa in the chamber")
    exact = reference()
    right.plot(np.array(list(exact)) / 1e3, -1e3 * np.array(list(exact.values())), "k^", label="finite elements")
    right.set(xlabel="pressure [kPa]", ylabel="tip down [mm]")
    right.legend()
    figure.savefig(out / "finger.png", dpi=110)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder to write to (default: out)")
    run(parser.parse_args().out)
