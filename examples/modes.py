"""Figure 4 of the paper: with two affine frames and one sample a bar stretches, shears, bends and twists.

Run `python examples/modes.py --out out`; it needs matplotlib (`pip install "mjframes[plot]"`).
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import mjframes as mf
from mjframes.kinematics.control import control_weights
from mjframes.volume.grid import voxel_grid

LENGTH, WIDTH, VOXEL = 0.4, 0.1, 0.0125  # [m]
YOUNG, POISSON = 1e5, 0.3  # [Pa], [-]
PULL, SLIDE, BEND, TWIST = 0.12, 0.12, np.radians(80), np.radians(120)
# how the left frame moves, about the middle of its end face: rotation vector [rad] and translation [m];
# the right one moves the other way
MOTIONS = {
    "rest": ((0, 0, 0), (0, 0, 0)),
    "twist": ((-TWIST / 2, 0, 0), (0, 0, 0)),
    "stretch": ((0, 0, 0), (-PULL / 2, 0, 0)),
    "compression": ((0, 0, 0), (PULL / 2, 0, 0)),
    "shear": ((0, 0, 0), (0, 0, -SLIDE / 2)),
    "bending": ((0, -BEND / 2, 0), (0, 0, 0)),
}


@dataclass(frozen=True, eq=False)
class Bar:
    """The body and what MuJoCo makes of it."""

    body: mf.SoftBody
    model: mujoco.MjModel
    data: mujoco.MjData

    def move(self, mode: str, share: float = 1.0) -> None:
        """Move the frames by a share of the mode's motion."""
        turn, shift = share * np.array(MOTIONS[mode])
        rest, data = self.body.control.rest, self.data
        moved = np.zeros_like(rest)
        for number in (0, 1):
            points = self.body.control.frame == number
            right = rest[points, 0].mean() > LENGTH / 2
            arm = rest[points] - [LENGTH if right else 0, WIDTH / 2, WIDTH / 2]
            sign = -1 if right else 1
            moved[points] = Rotation.from_rotvec(sign * turn).apply(arm) - arm + sign * shift
        moved -= self._unseen(moved)
        bodies = mf.soft(self.model, data, "bar").bodies
        place = {int(body): j for j, body in enumerate(bodies)}
        for j, body in enumerate(bodies):
            above = place.get(int(self.model.body_parentid[body]))
            start = self.model.jnt_qposadr[self.model.body_jntadr[body]]
            data.qpos[start : start + 3] = moved[j] - (0 if above is None else moved[above])
        mujoco.mj_forward(self.model, data)

    def _unseen(self, moved: NDArray[np.float64]) -> NDArray[np.float64]:
        """What moves control points (k, 3) but no material, Σ_j W_j z_j = 0: springs hold it, as nothing else would."""
        control, fields = self.body.control, self.body.fields
        shapes = control_weights(fields.weights, control, voxel_grid(fields.volume).centers)
        z = np.linalg.svd(shapes.toarray(), full_matrices=False)[2][-1]
        linear = np.column_stack([np.ones(len(z)), control.rest])
        q = z - linear @ np.linalg.lstsq(linear, z)[0]
        return np.outer(z, q @ moved) / (q @ z)

    @property
    def energy(self) -> float:
        """[J]"""
        return mf.soft(self.model, self.data, "bar").elastic_energy


def bar(law: str = "corotational") -> Bar:
    """0.4 m × 0.1 m × 0.1 m; a frame at each end."""
    shape = np.round([LENGTH / VOXEL, WIDTH / VOXEL, WIDTH / VOXEL]).astype(int)
    volume = mf.Volume.from_labels(np.ones(shape, int), VOXEL, {1: mf.Material(YOUNG, POISSON, 1000)})
    ends = [(x, WIDTH / 2, WIDTH / 2) for x in (VOXEL / 2, LENGTH - VOXEL / 2)]
    body = mf.build(volume, at=ends, weights="linear", law=law)
    spec = mujoco.MjSpec()
    spec.option.gravity = [0, 0, 0]
    spec.visual.headlight.ambient = [0.4, 0.4, 0.4]
    sky, flat = mujoco.mjtTexture.mjTEXTURE_SKYBOX, mujoco.mjtBuiltin.mjBUILTIN_FLAT
    spec.add_texture(name="sky", type=sky, builtin=flat, rgb1=[1, 1, 1], width=8, height=48)
    mf.attach(spec, body, "bar", contact=False)
    model = spec.compile()
    return Bar(body, model, mujoco.MjData(model))


def run(out: Path) -> dict[str, float]:
    """Write modes.png to `out`; the elastic energy [J] of each mode."""
    from matplotlib.figure import Figure

    out.mkdir(parents=True, exist_ok=True)
    made, energies = bar(), {}
    camera = mf.look_from((LENGTH / 2, WIDTH / 2, WIDTH / 2), 0.6, 105, -12)
    figure = Figure(figsize=(12, 7.5), layout="constrained")
    for axes, mode in zip(np.ravel(figure.subplots(2, 3)), MOTIONS, strict=True):
        made.move(mode)
        energies[mode] = made.energy
        axes.imshow(mf.still(made.model, made.data, camera, (520, 400)))
        axes.set_title(f"{mode}: {energies[mode]:.3f} J")
        axes.set_axis_off()
    figure.savefig(out / "modes.png", dpi=100)
    return energies


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder to write to (default: out)")
    for mode, energy in run(parser.parse_args().out).items():
        print(f"{mode}: {energy:.3f} J")
