"""A small scene around one soft body: a floor below it, a light, a camera in front."""

from __future__ import annotations

import itertools
import os
import re
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np

from mjframes.base.errors import MjframesError
from mjframes.body.soft_body import SoftBody
from mjframes.scene.attach import attach
from mjframes.scene.contact import Contact
from mjframes.scene.links import find_body
from mjframes.scene.load import load_scene
from mjframes.scene.plugin_text import SEPARATOR
from mjframes.scene.skins import WEIGHT_UNITS
from mjframes.scene.solver import choose_solver
from mjframes.volume.volume import Volume

DROP = 0.25  # [-] of the body's size: how far above the floor it starts
FIELD = 45.0  # [degrees] of view, from top to bottom
ROOM = 1.15  # [-] of the ball around the body that the camera has in view: what is soft spreads
BACK = np.array([0.0, -0.8, 0.6])  # unit vector from the body to the camera


def standalone_scene(
    body: SoftBody, volume: Volume, name: str = "soft", contact: bool | Contact = True
) -> mujoco.MjSpec:
    """Return a spec in which `body`, made from `volume`, falls on a floor from a quarter of its size."""
    lower, upper = bounds(volume)
    size = float((upper - lower).max())
    spec = mujoco.MjSpec()
    spec.modelname = name
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
    middle = (lower + upper) / 2
    place = np.array([-middle[0], -middle[1], DROP * size - lower[2]])
    attach(spec, body, name, pos=place.tolist(), contact=contact)
    choose_solver(spec)
    # it keeps its distance from the body's centre of mass: what rolls away stays in view
    radius = float(np.linalg.norm(upper - lower)) / 2
    distance = ROOM * radius / np.sin(np.radians(FIELD / 2))
    camera = spec.body(name).add_camera(name="front", fovy=FIELD, pos=middle + distance * BACK)
    camera.mode = mujoco.mjtCamLight.mjCAMLIGHT_TRACKCOM
    camera.alt.type = mujoco.mjtOrientation.mjORIENTATION_XYAXES
    camera.alt.xyaxes = [1, 0, 0, *np.cross(BACK, [1, 0, 0])]
    return spec


def fragment(body: SoftBody, name: str = "soft", contact: bool | Contact = True) -> mujoco.MjSpec:
    """Return a spec of `body` alone, for MJCF's <attach>: `<attach model="steak" body="soft" prefix="left_"/>`."""
    spec = mujoco.MjSpec()
    spec.modelname = name
    attach(spec, body, name, contact=contact)
    return spec


def scene_with(
    body: SoftBody,
    scene: str | os.PathLike[str],
    name: str,
    parent: str,
    pos: Sequence[float],
    quat: Sequence[float] = (1.0, 0.0, 0.0, 0.0),
    contact: bool | Contact = True,
) -> mujoco.MjSpec:
    """Return the spec of a scene (.xml) with `body` in it, at `pos` [m], `quat` of the scene's body `parent`.

    What is new stands at rest in the scene's keyframes.
    Raise MjframesError for a scene that cannot be loaded, and for a name or a parent that it does not allow.
    """
    spec = load_scene(scene)[1]
    find_body(spec, parent, "--parent is", scene)
    if any(name == other.name for other in (*spec.bodies, *spec.plugins)):
        raise MjframesError(f"--name is {name!r}, which {scene} has already; give another one.")
    kept = [(key, np.array(key.qpos), np.array(key.qvel)) for key in spec.keys]
    for key, _, _ in kept:
        key.qpos, key.qvel = [], []
    attach(spec, body, name, parent, pos=pos, quat=quat, contact=contact)
    after = spec.compile()
    of_scene = [not after.joint(j).name.startswith(name + SEPARATOR) for j in range(after.njnt)]
    for key, qpos, qvel in kept:
        key.qpos = _filled(after.qpos0, _places(after.jnt_qposadr, after.nq, of_scene), qpos)
        key.qvel = _filled(np.zeros(after.nv), _places(after.jnt_dofadr, after.nv, of_scene), qvel)
    return spec


def write_scene(spec: mujoco.MjSpec, path: Path) -> None:
    """Write a compiled spec as MJCF, in which files that it names are found from where it is written.

    Raise MjframesError where MuJoCo cannot load what is written.
    """
    root = ElementTree.fromstring(spec.to_xml())
    if spec.modelfiledir:  # the spec itself is tied to where it was
        compiler = root.find("compiler")
        compiler = ElementTree.SubElement(root, "compiler") if compiler is None else compiler
        for kind, folder in (("meshdir", spec.meshdir), ("texturedir", spec.texturedir)):
            compiler.set(kind, os.path.relpath(os.path.join(spec.modelfiledir, folder), path.parent))
    for skin in root.iter("skin"):
        _shorten(skin)
    path.write_text(ElementTree.tostring(root, encoding="unicode") + "\n", encoding="utf-8")
    load_scene(path)


def _shorten(skin: ElementTree.Element) -> None:
    """Write a skin's numbers, most of a scene's, in fewer letters: .5 for 0.5, and whole units for rounded weights.

    MuJoCo takes the weights of a vertex relative to their sum. Weights of few letters stay as they are.
    """
    for key in ("vertex", "texcoord"):
        if key in skin.attrib:
            skin.set(key, re.sub(r"(?<![0-9.])0\.", ".", skin.attrib[key]))
    bones = skin.findall("bone")
    units = [WEIGHT_UNITS * np.array(bone.attrib["vertweight"].split(), float) for bone in bones]
    if all(np.allclose(some, np.round(some), rtol=0, atol=1e-6 * WEIGHT_UNITS) for some in units):
        whole = [" ".join(map(str, np.round(some).astype(int).tolist())) for some in units]
        if sum(map(len, whole)) < sum(len(bone.attrib["vertweight"]) for bone in bones):
            for bone, weights in zip(bones, whole, strict=True):
                bone.set("vertweight", weights)


def _places(address: np.ndarray, size: int, chosen: Sequence[bool]) -> np.ndarray:
    """(size,) whether a coordinate belongs to one of the chosen joints, whose coordinates begin at `address` (n,)."""
    return np.repeat(chosen, np.diff([*address.tolist(), size])).astype(bool)


def _filled(whole: np.ndarray, places: np.ndarray, values: np.ndarray) -> list[float]:
    """`whole` with `values` at the places; nothing where there are none, which is MuJoCo's default."""
    if not len(values):
        return []
    filled = whole.copy()
    filled[places] = values
    return filled.tolist()


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


def bounds(volume: Volume) -> tuple[np.ndarray, np.ndarray]:
    """Return the (lower, upper) corners of the box around the inside, volume coordinates [m]."""
    index = np.argwhere(volume.labels > 0)
    ends = np.stack([index.min(axis=0), index.max(axis=0) + 1])
    corners = np.array([ends[list(c), range(3)] for c in itertools.product((0, 1), repeat=3)])
    points = volume.origin + (corners * volume.spacing) @ volume.axes.T
    return points.min(axis=0), points.max(axis=0)
