"""Soft bodies of several materials inside MuJoCo scenes, made of a few moving frames.

    import mujoco
    import mjframes as mf

    volume = mf.Volume.from_labels("models/steak.npz")
    body = mf.build(volume, frames=3, samples=10)
    spec = mujoco.MjSpec.from_file("scene.xml")
    mf.attach(spec.worldbody, body, name="steak", pos=(0, 0, 0.3))
    model = spec.compile()

Importing the package makes the engine plugins `mjframes.soft` and `mjframes.sensor` known to MuJoCo.
"""

from __future__ import annotations

import importlib
import warnings
from typing import TYPE_CHECKING

import mujoco  # noqa: F401  (first: MuJoCo 4 imports this package in turn, for its plugin)

from mjframes import plugin
from mjframes.errors import MjframesError

if TYPE_CHECKING:
    from mjframes.body import SoftBody, build
    from mjframes.contact import Contact
    from mjframes.inertia import mass_matrix, rigid_inertia
    from mjframes.material import Material
    from mjframes.mjcf import attach
    from mjframes.sensors import add_sensor
    from mjframes.supports import Attached, Fixed
    from mjframes.view import soft
    from mjframes.volume import Volume

__all__ = [
    "Attached",
    "Contact",
    "Fixed",
    "Material",
    "MjframesError",
    "SoftBody",
    "Volume",
    "add_sensor",
    "attach",
    "build",
    "mass_matrix",
    "rigid_inertia",
    "soft",
]

# MuJoCo 4 imports this package whenever it is imported itself: the rest is loaded when it is used.
_HOMES = {
    "Attached": "supports",
    "Contact": "contact",
    "Fixed": "supports",
    "Material": "material",
    "SoftBody": "body",
    "Volume": "volume",
    "add_sensor": "sensors",
    "attach": "mjcf",
    "build": "body",
    "mass_matrix": "inertia",
    "rigid_inertia": "inertia",
    "soft": "view",
}


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module 'mjframes' has no attribute {name!r}")
    return getattr(importlib.import_module(f"mjframes.{_HOMES[name]}"), name)


try:
    plugin.load()
except MjframesError as error:  # tools like `mjframes doctor` must still start; attach() raises it
    warnings.warn(str(error), RuntimeWarning, stacklevel=2)
