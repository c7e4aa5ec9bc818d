"""The rodent of dm_control's locomotion with soft flesh around its skeleton (Figure 11 of the paper).

The skin becomes a volume; its voxels inside the geoms of the links move with those, as bones do, and free frames carry
what is between them: the guts, which hang on spine, ribs and pelvis, sway, the tail swings.
"""

from __future__ import annotations

import warnings
from importlib.resources import files

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from mjframes.body.build import build
from mjframes.body.soft_body import SoftBody
from mjframes.frames.supports import Attached
from mjframes.scene.attach import BranchWarning, attach
from mjframes.volume.material import Material
from mjframes.volume.meshes import MeshWarning
from mjframes.volume.volume import Volume

Array = NDArray[np.float64]

VOXELS, FREE = 60_000, 11
FUR = (0.75, 0.66, 0.6, 1)
# relaxed muscle and fat have 2 to 3 kPa by magnetic resonance elastography; guts, of which much is fluid, are slacker
FLESH = Material(young=2.5e3, poisson=0.45, density=1000, name="flesh", rgba=FUR)
GUTS = Material(young=7e2, poisson=0.45, density=1000, name="guts", rgba=FUR)
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
DAMPING = (0.0, 0.005)  # Rayleigh's α [1/s] and β [s]


def clothe(spec: mujoco.MjSpec) -> SoftBody:
    """Give the rodent of a spec flesh called "flesh" in place of its skin; return the flesh.

    Its geoms go out of sight, into group 3, and keep half of their mass. They touch the ground; the flesh does not.
    """
    for geom in spec.geoms:
        geom.group, geom.density = 3, geom.density / 2
    bare = spec.compile()
    data = mujoco.MjData(bare)
    mujoco.mj_forward(bare, data)
    volume = skin_volume(bare, data)
    body = build(volume, FREE, supports=bones(bare, data, volume), damping=DAMPING)
    spec.delete(spec.skins[0])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BranchWarning)  # legs and spine are different branches
        attach(spec, body, "flesh", contact=False)
    return body


def skin_volume(model: mujoco.MjModel, data: mujoco.MjData) -> Volume:
    """What the skin encloses in the pose of `data`, and the links of SOLID; the guts have a material of their own."""
    from mjframes.base.trimeshes import trimesh

    scene = mujoco.MjvScene(model, 1000)
    everything = mujoco.mjtCatBit.mjCAT_ALL.value
    mujoco.mjv_updateScene(model, data, mujoco.MjvOption(), None, mujoco.MjvCamera(), everything, scene)
    skin = trimesh.Trimesh(np.reshape(scene.skinvert, (-1, 3)), model.skin_face, process=False)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MeshWarning)  # toes and the tip of the tail are thinner than a voxel
        volume = Volume.from_meshes([(skin, FLESH)], voxels=VOXELS)
    everywhere = volume.origin + (np.moveaxis(np.indices(volume.labels.shape), 0, -1) + 0.5) * volume.spacing
    inside = volume.labels > 0
    thin = inside & ~np.asarray(ndimage.binary_opening(inside, np.ones((2, 2, 2), bool)), bool)
    inside |= np.asarray(ndimage.binary_dilation(thin), bool)  # a surface around single voxels has holes: the ears
    for link in SOLID:
        inside |= _inside(model, data, link, 1.0, everywhere)
    for link in FOLDED:
        inside &= ~_fold(model, data, link, everywhere, inside)
    guts = np.linalg.norm((everywhere - GUTS_MIDDLE) / GUTS_SIZE, axis=-1) < 1
    guts &= ndimage.binary_erosion(inside, iterations=WALL)
    labels = np.where(inside, np.where(guts, 2, 1), 0)
    return Volume.from_labels(labels, volume.spacing, {1: FLESH, 2: GUTS}, origin=volume.origin).largest_component()


def bones(model: mujoco.MjModel, data: mujoco.MjData, volume: Volume) -> list[Attached]:
    """The voxels in the geoms of each link, but for guts."""
    voxels, centers = np.argwhere(volume.labels > 0), volume.centers
    taken, found = volume.labels == 2, []
    for link, size in BONES.items():
        mask = np.zeros_like(taken)
        mask[tuple(voxels[_inside(model, data, link, size, centers)].T)] = True
        found.append(Attached(link, mask & ~taken))
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


def rodent() -> mujoco.MjSpec:
    """Return dm_control's rodent as it comes."""
    return mujoco.MjSpec.from_file(str(files("dm_control") / "locomotion/walkers/assets/rodent.xml"))
