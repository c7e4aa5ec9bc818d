"""A small scene around one soft body: a floor below it, a light, a camera in front."""

from __future__ import annotations

import itertools

import mujoco
import numpy as np

from mjframes.body import SoftBody
from mjframes.mjcf import attach
from mjframes.volume import Volume

DROP = 0.25  # [-] of the body's size: how far above the floor it starts
DISTANCE = 1.4  # [-] of the body's size: from the camera to the body
BACK = np.array([0.0, -0.8, 0.6])  # unit vector from the body to the camera


def standalone_scene(body: SoftBody, volume: Volume, name: str = "soft", contact: bool = True) -> mujoco.MjSpec:
    """A spec in which `body`, made from `volume`, falls on a floor from a quarter of its size."""
    lower, upper = _bounds(volume)
    size = float((upper - lower).max())
    spec = mujoco.MjSpec()
    spec.modelname = name
    spec.option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE  # twice as fast as sparse for so few degrees of freedom
    center = np.array([0.0, 0.0, (upper - lower)[2] / 2])
    spec.stat.center, spec.stat.extent = center, 2 * size
    spec.visual.headlight.ambient = [0.35, 0.35, 0.35]
    spec.visual.headlight.diffuse = [0.3, 0.3, 0.3]
    spec.visual.headlight.specular = [0.1, 0.1, 0.1]
    _add_floor(spec)
    world = spec.worldbody
    world.add_light(
        type=mujoco.mjtLightType.mjLIGHT_SPOT,
        pos=[-0.8 * size, -0.8 * size, 3 * size],
        dir=[0.8, 0.8, -3],
        cutoff=60,
        diffuse=[0.6, 0.6, 0.6],
        castshadow=True,
    )
    camera = world.add_camera(name="front", pos=center + (size * DISTANCE) * BACK)
    camera.alt.type = mujoco.mjtOrientation.mjORIENTATION_XYAXES
    camera.alt.xyaxes = [1, 0, 0, *np.cross(BACK, [1, 0, 0])]
    middle = (lower + upper) / 2
    attach(world, body, name=name, pos=(-middle[0], -middle[1], DROP * size - lower[2]), contact=contact)
    return spec


def _add_floor(spec: mujoco.MjSpec) -> None:
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.75, 0.82, 0.9],
        rgb2=[1, 1, 1],
        width=64,
        height=384,
    )
    spec.add_texture(
        name="floor",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        rgb1=[0.52, 0.54, 0.57],
        rgb2=[0.6, 0.62, 0.65],
        width=256,
        height=256,
    )
    material = spec.add_material(name="floor", texrepeat=[8, 8], texuniform=True)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "floor"
    spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 0.1], material="floor")


def _bounds(volume: Volume) -> tuple[np.ndarray, np.ndarray]:
    """(lower, upper) corners of the box around the inside, volume coordinates [m]."""
    index = np.argwhere(volume.labels > 0)
    ends = np.stack([index.min(axis=0), index.max(axis=0) + 1])
    corners = np.array([ends[list(c), range(3)] for c in itertools.product((0, 1), repeat=3)])
    points = volume.origin + (corners * volume.spacing) @ volume.axes.T
    return points.min(axis=0), points.max(axis=0)
