"""Figure 11 of the paper: the soft tissues of a rat follow its skeleton, here of dm_control's rodent, whose motors run.

The skin of the rodent becomes a volume of flesh; the voxels inside the geoms of its links move with those, as bones do,
and free frames carry what is between them: the guts, which hang on spine, ribs and pelvis, sway, the tail swings.
Run `python examples/rat.py --out out`; it needs dm_control and the extras of films and meshes
(`pip install "mjframes[dm,meshes,video]"`).
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

import mjframes as mf
from mjframes.dm.rodent import clothe, rodent

Array = NDArray[np.float64]

GROUND = -0.095  # [m] height of the floor, to look at: the slide carries the rat, and its tail hangs
BELLY = (-0.01, 0.0, 0.024)  # [m] a material point halfway between ribs and pelvis, near the skin
DURATION, BEAT, SHAKE = 3.0, 4.0, 0.008  # [s], [Hz], [m] by which the torso goes up and down
GAIT = {"hip_L_extend": 0.5, "hip_R_extend": -0.5, "shoulder_L": -0.5, "shoulder_R": 0.5, "lumbar_bend": 0.15}


@dataclass(frozen=True, eq=False)
class Rat:
    """The rat and its run.

    belly: (steps, 3) places of BELLY, as the torso's axes see it [m].
    stretch: (e,) the longest that each edge of the skin has been, of what it is at rest [-].
    rate: steps a second, without drawing.
    """

    body: mf.SoftBody
    model: mujoco.MjModel
    data: mujoco.MjData
    belly: Array
    stretch: Array
    rate: float


def shaken() -> mujoco.MjSpec:
    """dm_control's walker, held by a slide that shakes its torso."""
    spec = rodent()
    spec.body("torso").add_joint(name="shake", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0, 0, 1], range=[-1, 1])
    motor = spec.add_actuator(name="shake", target="shake", trntype=mujoco.mjtTrn.mjTRN_JOINT)
    motor.set_to_position(kp=3e3, kv=60)
    sky, flat = mujoco.mjtTexture.mjTEXTURE_SKYBOX, mujoco.mjtBuiltin.mjBUILTIN_FLAT
    spec.add_texture(name="sky", type=sky, builtin=flat, rgb1=[1, 1, 1], rgb2=[1, 1, 1], width=8, height=48)
    return spec


def rat() -> tuple[mf.SoftBody, mujoco.MjModel]:
    spec = shaken()
    body = clothe(spec)
    ground = spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=(1, 1, 0.1), pos=(0, 0, GROUND))
    ground.rgba, ground.contype, ground.conaffinity = (0.8, 0.81, 0.82, 1), 0, 0
    spec.worldbody.add_camera(name="beside", pos=[-0.03, -0.33, 0.08], xyaxes=[1, 0, 0, 0, 0.15, 1])
    return body, spec.compile()


def run(out: Path, duration: float = DURATION) -> Rat:
    """Write rat.mp4 to `out`."""
    out.mkdir(parents=True, exist_ok=True)
    body, model = rat()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    view = mf.soft(model, data, "flesh")
    edges = mesh_edges(body.skin.faces)
    length, stretch = _lengths(body.skin.vertices, edges), np.ones(len(edges))
    belly, spent = [], 0.0
    with mf.film(model, out / "rat.mp4", camera="beside", size=(960, 540)) as draw:
        while data.time < duration:
            beat = np.sin(2 * np.pi * BEAT * data.time)
            data.actuator("shake").ctrl = SHAKE * beat
            for motor, swing in GAIT.items():
                data.actuator(motor).ctrl = swing * beat
            start = time.perf_counter()
            mujoco.mj_step(model, data)
            spent += time.perf_counter() - start
            mujoco.mj_kinematics(model, data)
            torso = data.body("torso")
            belly.append((view.positions(np.array([BELLY]))[0] - torso.xpos) @ torso.xmat.reshape(3, 3))
            if int(30 * data.time) > int(30 * (data.time - model.opt.timestep)):
                draw(data)
                skin = body.skin.weights @ view.control_positions
                stretch = np.maximum(stretch, _lengths(skin, edges) / length)
    return Rat(body, model, data, np.array(belly), stretch, len(belly) / spent)


def mesh_edges(faces: NDArray[np.integer]) -> NDArray[np.integer]:
    """Return the edges (e, 2) of triangles (t, 3), each once."""
    sides = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    return np.unique(np.sort(sides, axis=1), axis=0)


def _lengths(points: Array, edges: NDArray[np.integer]) -> Array:
    return np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder of rat.mp4")
    found = run(parser.parse_args().out)
    sway = 1e3 * np.ptp(found.belly[len(found.belly) // 3 :], axis=0)
    print(f"{len(found.body.types)} frames, {found.model.nv} degrees of freedom, {found.rate:.0f} steps a second")
    print(f"The belly sways by {sway[0]:.1f}, {sway[1]:.1f}, {sway[2]:.1f} mm against the ribs;")
    print(f"an edge of the skin is {found.stretch.max():.1f} times as long as at rest at most.")
