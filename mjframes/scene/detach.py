"""Taking a soft body out of a scene: `MjSpec.delete` takes its bodies alone, and skins that name them cannot compile.

MuJoCo cannot delete a default class; the empty one of the soft body stays.
"""

from __future__ import annotations

import mujoco

from mjframes.base.errors import MjframesError
from mjframes.scene import plugin
from mjframes.scene.plugin_text import SEPARATOR, soft_name

ASSETS = ("skins", "excludes", "numerics", "texts", "meshes", "materials", "textures")
PLACED = ("bodies", "joints", "geoms", "sites", "cameras", "lights", "frames")  # what a frame may hold


def detach(spec: mujoco.MjSpec, name: str) -> None:
    """Take a soft body out of a spec: its bodies, also those that hang on others, skins, patches and sensors.

    Its name is free then. What is left of a soft body whose body was deleted by `spec.delete` goes as well.

    Parameters
    ----------
    spec
        The scene to change.
    name
        Name of the soft body.

    Raises
    ------
    MjframesError
        If the spec has no soft body of that name.
    """
    if not isinstance(spec, mujoco.MjSpec):
        raise MjframesError(f"spec is a {type(spec).__name__}; give the scene as an MjSpec.")
    own = f"{name}{SEPARATOR}"
    left = [one for kind in ASSETS for one in getattr(spec, kind) if one.name.startswith(own)]
    if not any(one.name == f"{own}stiffness" for one in spec.numerics):
        known = ", ".join(repr(soft_name(one.name)) for one in spec.plugins if one.plugin_name == plugin.NAME)
        raise MjframesError(f"name is {name!r} but the spec's soft bodies are: {known or 'none'}.")
    for one in left:
        spec.delete(one)
    if holder := spec.body(name):
        _delete(spec, holder)
    while on_links := [body for body in spec.bodies if body.name.startswith(own)]:
        spec.delete(on_links[0])


def _delete(spec: mujoco.MjSpec, holder: mujoco.MjsBody) -> None:
    """Delete a body, with the frame that places it, if that holds nothing else."""
    frame = holder.frame
    holds = [one for kind in PLACED for one in getattr(spec, kind) if frame is not None and one.frame == frame]
    spec.delete(frame if len(holds) == 1 else holder)
