"""Figure 11 of the paper: the soft tissues of a rat follow its skeleton, here of dm_control's rodent, whose motors run.

The skin of the rodent becomes a volume of flesh; the voxels inside the geoms of its links move with those, as bones do,
and free frames carry what is between them: the guts, which hang on spine, ribs and pelvis, sway, the tail swings.
Run `python examples/rat.py --out out`; it needs dm_control and the extras of films and meshes
(`pip install "mjframes[dm,meshes,video]"`).
"""

from __future__ import annotations

import argparse
import time
import warnings
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

import mjframes as mf

Array = NDArray[np.float64]

VOXELS, FREE = 60_000, 11
FUR = (0.75, 0.66, 0.6, 1)
# relaxed muscle and fat have 2 to 3 kPa in vivo, and what fills a belly, of which most is fluid, is slacker
FLESH = mf.Material(young=2.5e3, poisson=0.45, density=1000, name="flesh", rgba=FUR)
GUTS = mf.Material(young=7e2, poisson=0.45, density=1000, name="guts", rgba=FUR)
GUTS_MIDDLE, GUTS_SIZE = (-0.006, 0.0, 0.044), (0.034, 0.032, 0.026)  # [m] between ribs and pelvis, under the spine
BONES = {  # link of the rodent: its bones' size, of that of its geoms, which reach to the skin in most places
    "torso": 0.8, "vertebra_2": 0.8, "vertebra_5": 0.8, "pelvis": 0.7, "skull": 0.9, "jaw": 0.8,
    "vertebra_C2": 1.0, "vertebra_C5": 1.2, "vertebra_C11": 1.3,
    "vertebra_C19": 1.6, "vertebra_C24": 1.8, "vertebra_C29": 1.8,
    "upper_leg_L": 0.6, "upper_leg_R": 0.6, "lower_leg_L": 0.7, "lower_leg_R": 0.7, "foot_L": 1.0, "foot_R": 1.0,
    "toe_L": 1.0, "toe_R": 1.0, "hand_L": 1.0, "hand_R": 1.0,
    "upper_arm_L": 0.6, "upper_arm_R": 0.6, "lower_arm_L": 1.0, "lower_arm_R": 1.0,
}  # fmt: skip
SOLID = ("foot_L", "foot_R", "toe_L", "toe_R", "hand_L", "hand_R")  # where the skin is thinner than two voxels
FOLDED = ("foot_L", "foot_R")  # on these lies the shin where the rat crouches
SLIT = 2  # [voxels] between them, which a smoothed surface does not bridge
FOLD_FROM, FOLD_WITHIN = 0.01, 1.5  # [m] from the joint, nearer to which they are one; [-] of the size of geoms
WALL = 2  # [voxels] of flesh between guts and outside
GROUND = -0.045  # [m] height of the floor, to look at: the slide carries the rat
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


def rodent() -> mujoco.MjSpec:
    """dm_control's walker, held by a slide that shakes its torso."""
    spec = mujoco.MjSpec.from_file(str(files("dm_control") / "locomotion/walkers/assets/rodent.xml"))
    spec.body("torso").add_joint(name="shake", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0, 0, 1], range=[-1, 1])
    motor = spec.add_actuator(name="shake", target="shake", trntype=mujoco.mjtTrn.mjTRN_JOINT)
    motor.set_to_position(kp=3e3, kv=60)
    sky, flat = mujoco.mjtTexture.mjTEXTURE_SKYBOX, mujoco.mjtBuiltin.mjBUILTIN_FLAT
    spec.add_texture(name="sky", type=sky, builtin=flat, rgb1=[1, 1, 1], rgb2=[1, 1, 1], width=8, height=48)
    for geom in spec.geoms:
        geom.group, geom.density = 3, geom.density / 2  # out of sight; half of the mass is flesh
    ground = spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=(1, 1, 0.1), pos=(0, 0, GROUND))
    ground.rgba, ground.contype, ground.conaffinity = (0.8, 0.81, 0.82, 1), 0, 0
    return spec


def skin_volume(model: mujoco.MjModel, data: mujoco.MjData) -> mf.Volume:
    """What the skin encloses in the pose of `data`, and the links of SOLID; the guts have a material of their own."""
    import trimesh

    scene = mujoco.MjvScene(model, 1000)
    everything = mujoco.mjtCatBit.mjCAT_ALL.value
    mujoco.mjv_updateScene(model, data, mujoco.MjvOption(), None, mujoco.MjvCamera(), everything, scene)
    skin = trimesh.Trimesh(np.reshape(scene.skinvert, (-1, 3)), model.skin_face, process=False)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", mf.MeshWarning)  # toes and the tip of the tail are thinner than a voxel
        volume = mf.Volume.from_meshes([(skin, FLESH)], voxels=VOXELS)
    everywhere = volume.origin + (np.moveaxis(np.indices(volume.labels.shape), 0, -1) + 0.5) * volume.spacing
    inside = volume.labels > 0
    for link in SOLID:
        inside |= _inside(model, data, link, 1.0, everywhere)
    for link in FOLDED:
        inside &= ~_fold(model, data, link, everywhere, inside)
    guts = np.linalg.norm((everywhere - GUTS_MIDDLE) / GUTS_SIZE, axis=-1) < 1
    guts &= ndimage.binary_erosion(inside, iterations=WALL)
    labels = np.where(inside, np.where(guts, 2, 1), 0)
    return mf.Volume.from_labels(labels, volume.spacing, {1: FLESH, 2: GUTS}, origin=volume.origin).largest_component()


def bones(model: mujoco.MjModel, data: mujoco.MjData, volume: mf.Volume) -> list[mf.Attached]:
    """The voxels in the geoms of each link, but for guts."""
    voxels, centers = np.argwhere(volume.labels > 0), volume.centers
    taken, found = volume.labels == 2, []
    for link, size in BONES.items():
        mask = np.zeros_like(taken)
        mask[tuple(voxels[_inside(model, data, link, size, centers)].T)] = True
        found.append(mf.Attached(link, mask & ~taken))
        taken |= mask
    return found


def _inside(model: mujoco.MjModel, data: mujoco.MjData, link: str, size: float, points: Array) -> NDArray[np.bool_]:
    """Whether points (…, 3) are in the geoms of a link, each made `size` times as large."""
    return _depths(model, data, link, points) < size


def _fold(
    model: mujoco.MjModel, data: mujoco.MjData, link: str, points: Array, inside: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """The voxels of the link that another hangs on, next to that one's and away from their joint; points (…, 3)."""
    parent = model.body(model.body(link).parentid[0]).name
    below, above = (_depths(model, data, name, points) for name in (link, parent))
    touching = np.asarray(ndimage.binary_dilation(inside & (below <= above), np.ones((3, 3, 3), bool), SLIT), bool)
    away = np.linalg.norm(points - data.body(link).xpos, axis=-1) > FOLD_FROM
    return touching & inside & (above < below) & (above < FOLD_WITHIN) & away


def _depths(model: mujoco.MjModel, data: mujoco.MjData, link: str, points: Array) -> Array:
    """The least `_depth` (…) of points (…, 3) in the geoms of a link."""
    depths = []
    for geom in np.flatnonzero(model.geom_bodyid == model.body(link).id):
        local = (points - data.geom_xpos[geom]) @ data.geom_xmat[geom].reshape(3, 3)
        depths.append(_depth(model.geom_type[geom], model.geom_size[geom], local))
    return np.min(depths, axis=0)


def _depth(kind: int, size: Array, p: Array) -> Array:
    """0 in the middle of a sphere, capsule or ellipsoid, 1 on its surface [-]."""
    if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        return np.linalg.norm(p / size, axis=-1)
    half = size[1] if kind == mujoco.mjtGeom.mjGEOM_CAPSULE else 0.0
    along = p[..., 2] - np.clip(p[..., 2], -half, half)
    return np.sqrt(p[..., 0] ** 2 + p[..., 1] ** 2 + along**2) / size[0]


def rat() -> tuple[mf.SoftBody, mujoco.MjModel]:
    spec = rodent()
    bare = spec.compile()
    data = mujoco.MjData(bare)
    mujoco.mj_forward(bare, data)
    volume = skin_volume(bare, data)
    body = mf.build(volume, FREE, supports=bones(bare, data, volume), damping=(0.0, 0.005))
    spec.delete(spec.skins[0])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", mf.BranchWarning)  # legs and spine are different branches
        mf.attach(spec, body, "flesh", contact=False)
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
