"""A scene with all that it names, to take along: its XML, meshes, textures, height fields, skins.

MuJoCo writes six digits of a number into XML. Where pictures are to be the same to the pixel, the model's own numbers
go along as well.
"""

from __future__ import annotations

import functools
import io
import os
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np

from mjframes.base.archive import DAMAGED, Arrays
from mjframes.base.errors import MjframesError, reason
from mjframes.scene.load import mujoco_warnings, sentence

SCENE = "scene.xml"  # name of the scene among its files
NUMBERS = "numbers.npz"  # of the model, those that its XML does not give
UNUSED = "numeric_data"  # whose numbers MuJoCo does not look at: they may be infinite, and MuJoCo 4 writes these as 0
FOLDERS = ("meshdir", "texturedir", "assetdir")  # of a compiler: where files are looked for
SHOWN = 40  # letters of a name that is none
# In place of these MuJoCo saves what they make
WRITTEN_OUT = ("attach", "composite", "flexcomp", "include", "model", "replicate")
MOST_CELLS = 2**26  # pixels of all textures or heights of all fields, a few hundred megabytes
PNG = b"\x89PNG\r\n\x1a\n"
NEAR = 1e-7  # MuJoCo ends the process where znear × extent is below mjMINVAL, 1e-15
POSITIVE = {  # numbers without which nothing is drawn, and how large they are at least
    "opt.timestep": 1e-12,
    "stat.extent": NEAR,
    "vis.global_.fovy": NEAR,
    "vis.map.zfar": NEAR,
    "vis.map.znear": NEAR,
}
PARTS = (
    "",
    "opt",
    "stat",
    "vis.global_",
    "vis.headlight",
    "vis.map",
    "vis.rgba",
    "vis.scale",
)  # of a model, with numbers


def pack(spec: mujoco.MjSpec, model: mujoco.MjModel | None = None) -> dict[str, bytes]:
    """Return a compiled spec's files by name: SCENE, and those that it names, which it finds beside itself.

    model: what the spec was compiled to, as it is now; its numbers go along as NUMBERS.
    Raise MjframesError for a file that is not there any more.
    """
    try:
        root = ElementTree.fromstring(spec.to_xml())
        files = _take_along(root, spec)
    except (OSError, ValueError) as error:
        raise MjframesError(f"the scene cannot be packed ({reason(error)}).") from error
    files = {SCENE: ElementTree.tostring(root), **files}
    return files if model is None else {**files, NUMBERS: _differing(model, unpack(files, "the scene"))}


def unpack(files: Mapping[str, bytes], where: str) -> mujoco.MjModel:
    """Return the model of a packed scene.  where: what sentences call it.

    Raise MjframesError where there is none, and with MuJoCo's reason where it cannot be loaded.
    """
    if SCENE not in files:
        raise MjframesError(f"{where}: there is no scene in it; record with scene=…, which takes the MjSpec.")
    others = {name: content for name, content in files.items() if name not in (SCENE, NUMBERS)}
    with mujoco_warnings() as warnings:
        try:
            model = mujoco.MjSpec.from_string(_checked(files[SCENE], others), assets=others).compile()
        except (ValueError, mujoco.FatalError) as error:
            raise MjframesError(f"{where}: MuJoCo cannot load its scene ({sentence(error, warnings)}).") from error
    if NUMBERS in files:
        try:
            _set_numbers(model, files[NUMBERS])
        except DAMAGED as error:
            raise MjframesError(f"{where}: the numbers of its scene are damaged ({error}).") from error
    for path, least in POSITIVE.items():
        if not least <= (number := float(_part(model, path))) < np.inf:
            raise MjframesError(
                f"{where}: {path} of its scene is {number:g}; it must be finite and at least {least:g}."
            )
    return model


def _checked(scene: bytes, files: Mapping[str, bytes]) -> str:
    """Return a scene as MuJoCo is to read it: what was looked at, without all else that a parser may see in XML.

    Raise ValueError where it is none that `pack` wrote.
    """
    try:
        root = ElementTree.fromstring(scene)
    except ElementTree.ParseError as error:
        raise ValueError(f"it is no XML, {error}") from error
    _require_own_files(root, files)
    _require_possible(root, files)
    return ElementTree.tostring(root, encoding="unicode")


def _require_own_files(root: ElementTree.Element, files: Collection[str]) -> None:
    """Raise ValueError where a scene names a file that is not packed with it: MuJoCo would look for it on the disk."""
    for element in root.iter():
        for key, name in element.items():
            if key.startswith("file") and name not in files:
                raise ValueError(f"it names the file {name!r}, which is not packed with it")
            if key in FOLDERS:
                raise ValueError(f"it looks for files in {name!r}, and those of a packed scene are with it")


def _require_possible(root: ElementTree.Element, files: Mapping[str, bytes]) -> None:
    """Raise ValueError where MuJoCo would make of a short scene more than there is memory or time for."""
    for element in root.iter():
        if element.tag in WRITTEN_OUT or (element.tag == "mesh" and "builtin" in element.attrib):
            raise ValueError(f"it has a <{element.tag}> that MuJoCo writes out when it saves a scene")
    pixels = sum(_pixels(one) for one in root.iter("texture")) + sum(map(_pixels_of_png, files.values()))
    heights = sum(_number(one, "nrow") * _number(one, "ncol") for one in root.iter("hfield"))
    for what, count in (("textures", pixels), ("height fields", heights)):
        if not count <= MOST_CELLS:
            raise ValueError(f"its {what} have {count:.3g} points, and {MOST_CELLS:.2g} are the most that is read")


def _pixels(texture: ElementTree.Element) -> float:
    """How many MuJoCo makes: of a cube, which is the default, six sides as wide as the first."""
    width, height = (_number(texture, key) for key in ("width", "height"))
    return width * (height if texture.get("type") == "2d" else max(height, 6 * width))


def _pixels_of_png(content: bytes) -> int:
    """How many a file has by its header, 0 where it is no PNG."""
    width, height = (int.from_bytes(content[at : at + 4], "big") for at in (16, 20))
    return width * height if content.startswith(PNG) else 0


def _number(element: ElementTree.Element, key: str) -> float:
    """An attribute of an element, 0 where it has none.  Raise ValueError for what is no size."""
    if (number := float(element.get(key, "0"))) >= 0:
        return number
    raise ValueError(f"its <{element.tag}> has {key}={element.get(key)!r}")


def _differing(model: mujoco.MjModel, other: mujoco.MjModel) -> bytes:
    """Return the numbers of a model in which another of its size differs, as .npz."""
    theirs, stream = dict(numbers_of(other)), io.BytesIO()
    # arrays of other sizes are what MuJoCo prepares, as octrees
    mine = {name: value for name, value in numbers_of(model) if theirs[name].shape == value.shape}
    found: dict[str, Any] = {name: value for name, value in mine.items() if not np.array_equal(value, theirs[name])}
    np.savez(stream, **found)
    return stream.getvalue()


def numbers_of(model: mujoco.MjModel) -> Iterator[tuple[str, np.ndarray]]:
    """Yield each number and array of floats of a model, by its path."""
    for part in PARTS:
        owner = _part(model, part)
        for name in dir(owner):
            value = None if name.startswith("_") else getattr(owner, name)
            if isinstance(value, float) or (isinstance(value, np.ndarray) and value.dtype.kind == "f"):
                yield ".".join(filter(None, [part, name])), np.asarray(value)


def _set_numbers(model: mujoco.MjModel, content: bytes) -> None:
    """Set those that `_differing` wrote.  Raise one of DAMAGED where it did not."""
    known = dict(numbers_of(model))
    with Arrays(io.BytesIO(content)) as file:
        for path, value in file.items():
            if path not in known or value.shape != known[path].shape or value.dtype.kind != "f":
                raise ValueError(f"{path[:SHOWN]!r} is no number of its model")
            # a scene's own limits may be infinite
            if path != UNUSED and not (np.isfinite(value) | ~np.isfinite(known[path])).all():
                raise ValueError(f"{path} is not finite")
            part, _, name = path.rpartition(".")
            if value.ndim:
                getattr(_part(model, part), name)[...] = value
            else:
                setattr(_part(model, part), name, float(value))


def _part(model: mujoco.MjModel, path: str) -> Any:
    """What belongs to a model, by its path."""
    return functools.reduce(getattr, path.split("."), model) if path else model


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
        for key in FOLDERS:
            compiler.attrib.pop(key, None)
    return files


def _content(spec: mujoco.MjSpec, folder: str, name: str) -> bytes:
    """Return a file that a spec names."""
    for known in (name, os.path.join(folder, name), Path(name).name):
        if known in spec.assets:
            return bytes(spec.assets[known])
    return Path(spec.modelfiledir, folder, name).read_bytes()
