"""A soft sleeve around the two links of an elbow, which a position actuator bends.

The bones are rigid pieces of the volume and move with the links; two free affine frames, where the build places them,
carry the flesh between them.
Run `python examples/elbow.py --out out`; it needs matplotlib (`pip install "mjframes[plot]"`).
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

import mjframes as mf

LENGTH, RADIUS, BONE, GAP, VOXEL = 0.4, 0.05, 0.015, 0.03, 0.01  # [m]; the bones end GAP before the elbow
FLESH, UPPER, LOWER = 1, 2, 3  # labels
POISSON, DENSITY = 0.45, 1000.0  # [-], [kg/m³]
FRAMES = 2  # free ones
DAMPING = (0.0, 0.02)  # [1/s], [s]: flesh sways no longer than a second
TARGET, RAMP, DURATION = np.pi / 2, 0.5, 1.5  # [rad], [s]: the actuator's set point grows, then stays
STIFFNESS = 50.0  # [N m/rad] of the actuator

LINKS = f"""<mujoco>
<option timestep="0.005"/>
<visual><headlight ambient=".4 .4 .4"/><global offwidth="560" offheight="480"/></visual>
<worldbody>
  <body name="upper">
    <geom type="capsule" fromto="-.22 0 0 -.02 0 0" size=".011" mass=".3"/>
    <body name="lower">
      <joint name="elbow" axis="0 0 1" damping=".05" armature=".001"/>
      <geom type="capsule" fromto=".02 0 0 .22 0 0" size=".011" mass=".3"/>
    </body>
  </body>
</worldbody>
<contact><exclude body1="upper" body2="lower"/></contact>
<actuator><position name="biceps" joint="elbow" kp="{STIFFNESS}" kv="2"/></actuator>
</mujoco>"""


@dataclass(frozen=True, eq=False)
class Elbow:
    """The sleeve and what MuJoCo makes of it."""

    sleeve: mf.SoftBody
    model: mujoco.MjModel
    data: mujoco.MjData

    @property
    def view(self) -> mf.Soft:
        """Of the sleeve."""
        return mf.soft(self.model, self.data, "sleeve")

    @property
    def angle(self) -> float:
        """Of the elbow [degrees]."""
        return float(np.degrees(self.data.joint("elbow").qpos[0]))

    @property
    def torque(self) -> float:
        """Of the actuator [N m]."""
        return float(self.data.actuator("biceps").force[0])

    @property
    def swelling(self) -> float:
        """Relative change of the volume: the mean of det F − 1 over the voxels [-]."""
        voxels = self.sleeve.fields.volume.centers
        return float(np.linalg.det(self.view.deformation_gradients(voxels)).mean() - 1)


def elbow(young: float = 2e4, law: str = "corotational") -> Elbow:
    """A straight arm along x, 0.4 m long and 0.1 m thick."""
    count = np.round([LENGTH / VOXEL, 2 * RADIUS / VOXEL, 2 * RADIUS / VOXEL]).astype(int)
    x, y, z = ((np.arange(n) + 0.5 - n / 2) * VOXEL for n in count)
    x, depth = np.broadcast_arrays(x[:, None, None], np.hypot(y[:, None], z)[None])
    labels = np.where(depth < RADIUS, FLESH, 0)
    labels[(depth < BONE) & (x < -GAP)] = UPPER
    labels[(depth < BONE) & (x > GAP)] = LOWER
    bone = mf.Material.rigid(density=1800)
    materials = {FLESH: mf.Material(young, POISSON, DENSITY), UPPER: bone, LOWER: bone}
    volume = mf.Volume.from_labels(labels, VOXEL, materials, origin=(-LENGTH / 2, -RADIUS, -RADIUS))
    bones = [mf.Attached("upper", labels == UPPER), mf.Attached("lower", labels == LOWER)]
    sleeve = mf.build(volume, FRAMES, law=law, supports=bones, damping=DAMPING)
    spec = mujoco.MjSpec.from_string(LINKS)
    sky, flat = mujoco.mjtTexture.mjTEXTURE_SKYBOX, mujoco.mjtBuiltin.mjBUILTIN_FLAT
    spec.add_texture(name="sky", type=sky, builtin=flat, rgb1=[1, 1, 1], rgb2=[1, 1, 1], width=8, height=48)
    mf.attach(spec, sleeve, "sleeve", "lower", contact=False)
    model = spec.compile()
    return Elbow(sleeve, model, mujoco.MjData(model))


def bend(arm: Elbow, duration: float = DURATION) -> None:
    """Move the set point to TARGET within RAMP seconds, and hold it until `duration`."""
    while arm.data.time < duration:
        arm.data.ctrl[0] = TARGET * min(1.0, arm.data.time / RAMP)
        mujoco.mj_step(arm.model, arm.data)
    mujoco.mj_forward(arm.model, arm.data)


def run(out: Path) -> Elbow:
    """Write elbow.png to `out`: straight, and bent."""
    from matplotlib.figure import Figure

    out.mkdir(parents=True, exist_ok=True)
    arm, camera = elbow(), mf.look_from((0, 0.05, 0), 0.65, 90, -70)
    figure = Figure(figsize=(11.2, 5.3), layout="constrained")
    for axes, until in zip(figure.subplots(1, 2), (0.0, DURATION), strict=True):
        bend(arm, until)
        axes.imshow(mf.still(arm.model, arm.data, camera, (560, 480)))
        axes.set_title(f"{arm.angle:.0f}°, {arm.torque:.1f} N m, volume {100 * arm.swelling:+.1f} %")
        axes.set_axis_off()
    figure.savefig(out / "elbow.png", dpi=100)
    return arm


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder to write to (default: out)")
    bent = run(parser.parse_args().out)
    print(f"{bent.angle:.1f}° by {bent.torque:.2f} N m; the volume changes by {100 * bent.swelling:.1f} %.")
