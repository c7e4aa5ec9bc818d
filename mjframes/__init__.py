"""Soft bodies of several materials inside MuJoCo scenes, made of a few moving frames.

    import mujoco
    import mjframes as mf

    volume = mf.Volume.load("models/steak.npz")
    body = mf.build(volume, frames=3)
    spec = mujoco.MjSpec.from_file("scene.xml")
    mf.attach(spec, body, "steak", pos=(0, 0, 0.3))
    model = spec.compile()

Importing the package makes its engine plugins, `mjframes.soft` and others, known to MuJoCo.
"""

from __future__ import annotations

import importlib
import warnings
from importlib import metadata
from typing import TYPE_CHECKING

import mujoco  # noqa: F401  (first: MuJoCo 4 imports this package in turn, for its plugin)

from mjframes.base.errors import MjframesError
from mjframes.scene import plugin

if TYPE_CHECKING:
    from mjframes.app.collect.run import Collection, collect
    from mjframes.app.log.options import Log
    from mjframes.app.run import record
    from mjframes.app.video import film, look_from, still
    from mjframes.body.build import TurnWarning, build
    from mjframes.body.options import Paper
    from mjframes.body.soft_body import SoftBody
    from mjframes.frames.supports import Attached, Fixed
    from mjframes.scene.attach import Attachment, BranchWarning, FloatWarning, attach
    from mjframes.scene.contact import Contact
    from mjframes.scene.detach import detach
    from mjframes.scene.inertia import mass_matrix, rigid_inertia
    from mjframes.scene.instability import InstabilityWarning
    from mjframes.scene.load import load_scene
    from mjframes.scene.near import near
    from mjframes.scene.placing import place
    from mjframes.scene.scaling import scale
    from mjframes.scene.sensors import add_sensor
    from mjframes.scene.solver import choose_solver
    from mjframes.scene.view import Soft, soft
    from mjframes.volume.images import ImageWarning
    from mjframes.volume.material import Material
    from mjframes.volume.meshes import MeshWarning
    from mjframes.volume.pieces import load_pieces
    from mjframes.volume.volume import Volume
    from mjframes.weights.kernels import Harmonic, Linear, Voronoi
    from mjframes.whole_body.contrast import RigidWarning

__all__ = [
    "Attached",
    "Attachment",
    "BranchWarning",
    "Collection",
    "Contact",
    "Fixed",
    "FloatWarning",
    "Harmonic",
    "ImageWarning",
    "InstabilityWarning",
    "Linear",
    "Log",
    "Material",
    "MeshWarning",
    "MjframesError",
    "Paper",
    "RigidWarning",
    "Soft",
    "SoftBody",
    "TurnWarning",
    "Volume",
    "Voronoi",
    "add_sensor",
    "attach",
    "build",
    "choose_solver",
    "collect",
    "detach",
    "film",
    "load_pieces",
    "load_scene",
    "look_from",
    "mass_matrix",
    "near",
    "place",
    "record",
    "rigid_inertia",
    "scale",
    "soft",
    "still",
]

# MuJoCo 4 imports this package whenever it is imported itself: the rest is loaded when it is used.
_HOMES = {
    "app.collect.run": ("Collection", "collect"),
    "app.log.options": ("Log",),
    "app.run": ("record",),
    "app.video": ("film", "look_from", "still"),
    "body.build": ("TurnWarning", "build"),
    "body.options": ("Paper",),
    "body.soft_body": ("SoftBody",),
    "frames.supports": ("Attached", "Fixed"),
    "scene.attach": ("Attachment", "BranchWarning", "FloatWarning", "attach"),
    "scene.contact": ("Contact",),
    "scene.detach": ("detach",),
    "scene.inertia": ("mass_matrix", "rigid_inertia"),
    "scene.instability": ("InstabilityWarning",),
    "scene.load": ("load_scene",),
    "scene.near": ("near",),
    "scene.placing": ("place",),
    "scene.scaling": ("scale",),
    "scene.sensors": ("add_sensor",),
    "scene.solver": ("choose_solver",),
    "scene.view": ("Soft", "soft"),
    "volume.images": ("ImageWarning",),
    "volume.material": ("Material",),
    "volume.meshes": ("MeshWarning",),
    "volume.pieces": ("load_pieces",),
    "volume.volume": ("Volume",),
    "weights.kernels": ("Harmonic", "Linear", "Voronoi"),
    "whole_body.contrast": ("RigidWarning",),
}


def __getattr__(name: str) -> object:
    if name == "__version__":
        return metadata.version("mjframes")
    for module, names in _HOMES.items():
        if name in names:
            return getattr(importlib.import_module(f"mjframes.{module}"), name)
    raise AttributeError(f"module 'mjframes' has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*__all__, "__version__"]


try:
    plugin.load()
except MjframesError as error:  # tools like `mjframes doctor` must still start; attach() raises it
    warnings.warn(str(error), RuntimeWarning, stacklevel=2)
