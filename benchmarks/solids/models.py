"""The models of the paper's Table 2, or what stands for them where theirs is not to be had.

Steak and knee are those of the checkout, the ribbon is a strip bent into waves, the rat is the skin of dm_control's
rodent; the dragon has to be given. Files that are given take their place.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.solids.cases import STEAK
from mjframes.base.errors import MjframesError
from mjframes.volume.images import read_image
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

KNEE = STEAK.with_name("knee.npz")
VOXELS = {"dragon": 7_000_000, "ribbon": 60_000, "knee": 500_000, "rat": 1_500_000}  # in the paper
FLESH = Material(2e4, 0.45, 1050)  # of surfaces, which have no material, and of labels without one
MESHES = (".obj", ".stl", ".ply", ".off", ".glb")
RODENT = "locomotion/walkers/assets/rodent_walker_skin.skn"  # in the package dm_control


def volume_of(model: str, files: Mapping[str, str]) -> Volume | None:
    """Return the volume from `files` (model → label image or mesh) or from its stand-in; None where that is not there.

    Raise MjframesError for unusable files.
    """
    if model in files:
        return _from_file(files[model], model)
    if model == "ribbon":
        return _ribbon(VOXELS[model])
    if model == "rat":
        skin = _rodent_skin()
        return None if skin is None else _from_mesh(skin, model)
    stored = {"steak": STEAK, "knee": KNEE}.get(model)
    if stored is None or not stored.is_file():
        return None
    volume = Volume.load(stored)
    return volume.resample(VOXELS[model]) if model in VOXELS else volume


def _from_file(path: str, model: str) -> Volume:
    if Path(path).suffix.lower() in MESHES:
        return _from_mesh(path, model)
    image = read_image(Path(path))
    flesh = {int(label): FLESH for label in np.unique(image.labels) if label}
    return Volume.load(path, materials=image.materials or flesh).largest_component()


def _from_mesh(mesh: object, model: str) -> Volume:
    if model not in VOXELS:
        raise MjframesError(f"model {model!r} needs a label image: a mesh does not tell its materials apart.")
    return Volume.from_meshes([(mesh, FLESH)], voxels=VOXELS[model]).largest_component()  # pyright: ignore[reportArgumentType]


def _ribbon(voxels: int) -> Volume:
    """0.3 m long, 4 cm wide, 6 mm thick, in two waves."""
    length, width, thickness, height = 0.3, 0.04, 0.006, 0.03  # [m]

    def stretch(x: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.hypot(1, 4 * np.pi / length * height * np.cos(4 * np.pi * x / length))

    arc = length * float(np.mean(stretch(np.linspace(0, length, 1000))))
    step = (arc * width * thickness / voxels) ** (1 / 3)
    x, y, z = (np.arange(0.5, extent / step) * step for extent in (length, width, 2 * height + 4 * thickness))
    away = np.abs(z - z.mean() - height * np.sin(4 * np.pi * x / length)[:, None])
    inside = away < thickness / 2 * stretch(x)[:, None]
    labels = np.repeat(inside[:, None], len(y), axis=1).astype(np.uint8)
    return Volume.from_labels(labels, step, {1: FLESH})


def _rodent_skin() -> object | None:
    """A trimesh object, from MuJoCo's binary skin format: four counts, vertices, texture, faces."""
    package = importlib.util.find_spec("dm_control")
    if package is None or not package.submodule_search_locations:
        return None
    path = Path(package.submodule_search_locations[0]) / RODENT
    if not path.is_file():
        return None
    from mjframes.base.trimeshes import trimesh

    raw = path.read_bytes()
    vertices, texture, faces, _ = np.frombuffer(raw, np.int32, 4)
    points = np.frombuffer(raw, np.float32, 3 * vertices, 16).reshape(-1, 3)
    triangles: NDArray[np.int32] = np.frombuffer(raw, np.int32, 3 * faces, 16 + 12 * vertices + 8 * texture)
    return trimesh.Trimesh(points.astype(float), triangles.reshape(-1, 3), process=False)
