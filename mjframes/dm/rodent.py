"""The rodent of dm_control's locomotion with soft flesh around its skeleton (Figure 11 of the paper).

The skin becomes a volume; its voxels inside the geoms of the links move with those, as bones do, and free frames carry
what is between them.
"""

from __future__ import annotations

import warnings
from importlib.resources import files

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjframes.base.cache import cached
from mjframes.base.packing import packed
from mjframes.body.build import build
from mjframes.body.soft_body import SoftBody, unpacked
from mjframes.frames.supports import Attached
from mjframes.scene.attach import BranchWarning, attach
from mjframes.volume.material import Material
from mjframes.volume.meshes import MeshWarning
from mjframes.volume.volume import Volume

Array = NDArray[np.float64]

VOXELS, FREE = 60_000, 11
FLESH = Material(young=5e3, poisson=0.45, density=1000, name="flesh", rgba=(0.75, 0.66, 0.6, 1))
BONES = {  # link of the rodent: its bones' size, of that of its geoms, which reach to the skin in most places
    "torso": 0.8, "pelvis": 0.7, "skull": 0.9,
    "vertebra_C2": 1.0, "vertebra_C5": 1.2, "vertebra_C11": 1.3,
    "vertebra_C19": 1.6, "vertebra_C24": 1.8, "vertebra_C29": 1.8,
    "upper_leg_L": 0.6, "upper_leg_R": 0.6, "lower_leg_L": 0.7, "lower_leg_R": 0.7, "foot_L": 1.0, "foot_R": 1.0,
    "upper_arm_L": 0.6, "upper_arm_R": 0.6, "lower_arm_L": 1.0, "lower_arm_R": 1.0,
}  # fmt: skip
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
    held = bones(bare, data, volume)
    body = unpacked(cached("flesh", (volume, FREE, held, DAMPING), lambda: packed(_flesh(volume, held))))
    spec.delete(spec.skins[0])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BranchWarning)  # legs and spine are different branches
        attach(spec, body, "flesh", contact=False)
    return body


def _flesh(volume: Volume, held: list[Attached]) -> SoftBody:
    return build(volume, FREE, supports=held, damping=DAMPING)


def skin_volume(model: mujoco.MjModel, data: mujoco.MjData) -> Volume:
    """What the skin encloses in the pose of `data`."""
    import trimesh

    scene = mujoco.MjvScene(model, 1000)
    everything = mujoco.mjtCatBit.mjCAT_ALL.value
    mujoco.mjv_updateScene(model, data, mujoco.MjvOption(), None, mujoco.MjvCamera(), everything, scene)
    skin = trimesh.Trimesh(np.reshape(scene.skinvert, (-1, 3)), model.skin_face, process=False)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MeshWarning)  # toes and the tip of the tail are thinner than a voxel
        return Volume.from_meshes([(skin, FLESH)], voxels=VOXELS).largest_component()


def bones(model: mujoco.MjModel, data: mujoco.MjData, volume: Volume) -> list[Attached]:
    """The voxels in the geoms of each link."""
    voxels, centers = np.argwhere(volume.labels > 0), volume.centers
    taken, found = np.zeros(volume.labels.shape, bool), []
    for link, size in BONES.items():
        inside = np.zeros(len(voxels), bool)
        for geom in np.flatnonzero(model.geom_bodyid == model.body(link).id):
            local = (centers - data.geom_xpos[geom]) @ data.geom_xmat[geom].reshape(3, 3)
            inside |= _depth(model.geom_type[geom], model.geom_size[geom], local) < size
        mask = np.zeros_like(taken)
        mask[tuple(voxels[inside].T)] = True
        found.append(Attached(link, mask & ~taken))
        taken |= mask
    return found


def _depth(kind: int, size: Array, p: Array) -> Array:
    """0 in the middle of a sphere, capsule or ellipsoid, 1 on its surface [-]."""
    if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        return np.linalg.norm(p / size, axis=1)
    half = size[1] if kind == mujoco.mjtGeom.mjGEOM_CAPSULE else 0.0
    along = p[:, 2] - np.clip(p[:, 2], -half, half)
    return np.linalg.norm(np.column_stack([p[:, :2], along]), axis=1) / size[0]


def rodent() -> mujoco.MjSpec:
    """Return dm_control's rodent as it comes."""
    return mujoco.MjSpec.from_file(str(files("dm_control") / "locomotion/walkers/assets/rodent.xml"))
