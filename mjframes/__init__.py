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

import warnings
from importlib import metadata

import lazy_loader
import mujoco  # noqa: F401  (first: MuJoCo 4 imports this package in turn, for its plugin)

from mjframes.base.errors import MjframesError
from mjframes.scene import plugin

# MuJoCo 4 imports this package whenever it is imported itself: what is public is loaded when it is used.
_attribute, _, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> object:
    return metadata.version("mjframes") if name == "__version__" else _attribute(name)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]


try:
    plugin.load()
except MjframesError as error:  # tools like `mjframes doctor` must still start; attach() raises it
    warnings.warn(str(error), RuntimeWarning, stacklevel=2)
