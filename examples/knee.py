"""Figure 10 of the paper: pulling the quadriceps extends the knee, in which nothing is a joint.

The femur stands still; the tendon of the quadriceps is pulled along the thigh, by less than a squat takes.
Run `python examples/knee.py --out out`; it needs matplotlib (`pip install "mjframes[plot]"`).
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import mjframes as mf

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MODELS = Path(__file__).parent.parent / "models"
FEMUR, TIBIA, TENDON = 1, 2, 5  # labels of the volume
PULL = 600.0 * np.array([-0.93, 0.0, 0.37])  # [N] along the thigh
RAMP, DURATION = 0.8, 2.0  # [s]
FRAMES = 0.01 * np.array([  # [m] nine, beside the fixed femur
    (0, 0, -8), (4.5, 0, 1.2), (-3.5, 0, 4.6), (-8, 0, 5.1), (-8, 0, -0.8),  # tibia, patella, tendon, muscles
    (-4, 0, -2.5), (-3.4, 0, -9), (2.8, 0, -10), (0.3, 4.2, -2.5),  # flesh behind the knee, of the shank, at the side
])  # fmt: skip


@dataclass(frozen=True, eq=False)
class Knee:
    """The body, what MuJoCo makes of it, and which frame moves the tibia and which the tendon."""

    body: mf.SoftBody
    model: mujoco.MjModel
    data: mujoco.MjData
    tibia: int
    tendon: int

    def bodies(self, frame: int) -> NDArray[np.int64]:
        """MuJoCo's bodies that carry the control points of a frame."""
        return np.array([self.model.body(f"knee:{j}").id for j in np.flatnonzero(self.body.control.frame == frame)])

    @property
    def extension(self) -> float:
        """By how much the tibia has turned forward [degrees]."""
        rest = self.body.control.rest[self.body.control.frame == self.tibia]
        x = self.data.xpos[self.bodies(self.tibia)]
        turn = Rotation.align_vectors(x - x.mean(axis=0), rest - rest.mean(axis=0))[0].as_matrix()
        return float(np.degrees(np.arctan2(-turn[0, 2], turn[2, 2])))


def knee_at_rest() -> Knee:
    """Someone sitting: the femur is part of the world."""
    volume = mf.Volume.load(MODELS / "knee.npz")
    femur = mf.Fixed(volume.labels == FEMUR)
    body = mf.build(
        volume, at=FRAMES, method=mf.Paper(200), weights=mf.Voronoi(2), supports=[femur], damping=(3.0, 0.02)
    )
    spec = mujoco.MjSpec()
    spec.option.timestep = 0.005
    spec.visual.headlight.ambient = [0.5, 0.5, 0.5]
    sky, flat = mujoco.mjtTexture.mjTEXTURE_SKYBOX, mujoco.mjtBuiltin.mjBUILTIN_FLAT
    spec.add_texture(name="sky", type=sky, builtin=flat, rgb1=[1, 1, 1], width=8, height=48)
    mf.attach(spec, body, "knee", contact=False)
    model = spec.compile()
    inside = volume.labels[volume.labels > 0]
    labels = [int(inside[seeds[0]]) for seeds in body.fields.seeds]
    return Knee(body, model, mujoco.MjData(model), labels.index(TIBIA), labels.index(TENDON))


def pull(knee: Knee, duration: float = DURATION) -> None:
    """Pull the tendon ever harder for RAMP seconds, then hold it until `duration`."""
    bodies = knee.bodies(knee.tendon)
    while knee.data.time < duration:
        knee.data.xfrc_applied[bodies, :3] = min(1.0, knee.data.time / RAMP) * PULL / len(bodies)
        mujoco.mj_step(knee.model, knee.data)


def run(out: Path) -> Knee:
    """Write knee.png to `out`: the leg and its section through the middle, before and after."""
    from matplotlib.figure import Figure

    out.mkdir(parents=True, exist_ok=True)
    knee, camera = knee_at_rest(), mf.look_from((-0.01, 0, -0.02), 0.42, 110, -10)
    figure = Figure(figsize=(10, 9.8), layout="constrained")
    panels = figure.subplots(2, 2)
    for column in panels.T:
        mujoco.mj_forward(knee.model, knee.data)
        column[0].imshow(mf.still(knee.model, knee.data, camera, (560, 480)))
        _draw_section(knee, column[1])
        column[0].set_title(f"{knee.data.time:.1f} s: tibia turned by {abs(knee.extension):.1f}°")
        for axes in column:
            axes.set_axis_off()
        pull(knee)
    figure.savefig(out / "knee.png", dpi=100)
    return knee


def _draw_section(knee: Knee, axes: Axes) -> None:
    """The voxels of the sagittal plane, each where its material point is now."""
    volume = knee.body.fields.volume
    voxels = np.argwhere(volume.labels > 0)
    cut = voxels[:, 1] == volume.labels.shape[1] // 2
    x = 100 * mf.soft(knee.model, knee.data, "knee").positions(volume.centers[cut])
    colors = np.array([volume.materials[int(label)].rgba for label in volume.labels[tuple(voxels[cut].T)]])
    axes.scatter(x[:, 0], x[:, 2], s=14, c=colors, marker="s")
    axes.set_aspect("equal")
    axes.set_xlim(-13, 13)
    axes.set_ylim(-14, 9)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder to write to (default: out)")
    print(f"The tibia turned by {run(parser.parse_args().out).extension:.1f} degrees.")
