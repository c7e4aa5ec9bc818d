"""A scene with all that it names, to take along: its XML, meshes, textures, height fields, skins."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree

import mujoco

from mjframes.base.errors import MjframesError
from mjframes.scene.load import mujoco_warnings, sentence

SCENE = "scene.xml"  # name of the scene among its files


def pack(spec: mujoco.MjSpec) -> dict[str, bytes]:
    """Return a compiled spec's files by name: SCENE, and those that it names, which it finds beside itself.

    Raise MjframesError for a file that is not there any more.
    """
    try:
        root = ElementTree.fromstring(spec.to_xml())
        files = _take_along(root, spec)
    except (OSError, ValueError) as error:
        raise MjframesError(f"the scene cannot be packed ({' '.join(str(error).split())}).") from error
    return {SCENE: ElementTree.tostring(root), **files}


def unpack(files: Mapping[str, bytes], where: str) -> mujoco.MjModel:
    """Return the model of a packed scene.  where: what sentences call it.

    Raise MjframesError where there is none, and with MuJoCo's reason where it cannot be loaded.
    """
    if SCENE not in files:
        raise MjframesError(f"{where}: there is no scene in it; record with scene=…, which takes the MjSpec.")
    others = {name: content for name, content in files.items() if name != SCENE}
    with mujoco_warnings() as warnings:
        try:
            return mujoco.MjSpec.from_string(files[SCENE].decode(), assets=others).compile()
        except (ValueError, mujoco.FatalError) as error:
            raise MjframesError(f"{where}: MuJoCo cannot load its scene ({sentence(error, warnings)}).") from error


def _take_along(root: ElementTree.Element, spec: mujoco.MjSpec) -> dict[str, bytes]:
    """Return the files that a spec's XML names, by the names that they get in it."""
    files: dict[str, bytes] = {}
    for element in root.iterfind("asset/*"):
        folder = spec.texturedir if element.tag == "texture" else spec.meshdir
        for key in [key for key in element.keys() if key.startswith("file")]:  # noqa: SIM118  (an element is no dict)
            name = element.get(key, "")
            new = f"{len(files)}_{Path(name).name}"  # folders go, and two may have files of one name
            files[new] = _content(spec, folder, name)
            element.set(key, new)
    for compiler in root.iterfind("compiler"):
        for key in ("meshdir", "texturedir", "assetdir"):
            compiler.attrib.pop(key, None)
    return files


def _content(spec: mujoco.MjSpec, folder: str, name: str) -> bytes:
    """Return a file that a spec names."""
    for known in (name, os.path.join(folder, name), Path(name).name):
        if known in spec.assets:
            return bytes(spec.assets[known])
    return Path(spec.modelfiledir, folder, name).read_bytes()
