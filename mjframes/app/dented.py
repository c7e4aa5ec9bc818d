"""Skins that show dents: MuJoCo moves the skin of a soft body with its frames, and these make no dents.

The plugin knows how far its contacts dent the flesh (plugin/dented_skin.cc). This moves the skins of a scene that
MuJoCo is about to draw.
"""

from __future__ import annotations

import ctypes
import functools
import os
from collections.abc import Callable

import mujoco
import numpy as np

from mjframes.app.drawn import skin_faces
from mjframes.scene.plugin import library_path


def draw_dents(model: mujoco.MjModel, data: mujoco.MjData, scene: mujoco.MjvScene) -> None:
    """Let the skins of soft bodies in a scene show the dents of their contacts.

    Call it between `update_scene` and `render` of a `mujoco.Renderer`. Films, stills, logs and the viewer of mjframes
    call it themselves. It does nothing for contacts with `dents=False`, and where no contact has been computed.

    Parameters
    ----------
    model, data
        The compiled model and its state.
    scene
        The scene that shows this state, after `mujoco.mjv_updateScene`. Its skins are changed.
    """
    dent_skin = _function()
    if not (model.nskin and data.nefc and dent_skin):
        return
    vertices, normals = scene.skinvert.reshape(-1, 3), scene.skinnormal.reshape(-1, 3)
    for skin in range(model.nskin):
        bones = model.skin_bonebodyid[model.skin_boneadr[skin] :][: model.skin_bonenum[skin]]
        of = set(model.body_plugin[bones].tolist()) - {-1}
        own = slice(model.skin_vertadr[skin], model.skin_vertadr[skin] + model.skin_vertnum[skin])
        moved = np.ascontiguousarray(vertices[own], np.float32)
        place = moved.ctypes.data_as(ctypes.POINTER(ctypes.c_float))
        if any(dent_skin(model._address, data._address, instance, place, len(moved)) for instance in of):
            vertices[own] = moved
            normals[own] = _normals(moved, skin_faces(model, skin))


def skin_vertices(model: mujoco.MjModel, data: mujoco.MjData, scene: mujoco.MjvScene) -> list[np.ndarray]:
    """Return the vertices (n, 3) of each skin as it is deformed and dented, in the world [m].

    scene: of MuJoCo's visualization, for the model; it keeps the vertices until the next call.
    """
    if not model.nskin:
        return []
    # of no category of geoms: skins and flexes alone; what updates skins alone is deprecated
    mujoco.mjv_updateScene(model, data, mujoco.MjvOption(), None, mujoco.MjvCamera(), 0, scene)
    draw_dents(model, data, scene)
    return np.split(np.reshape(scene.skinvert, (-1, 3)), model.skin_vertadr[1:])


def _normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(n, 3) of vertices, of length 1, as MuJoCo has them: the sum of the triangles'."""
    a, b, c = vertices[faces].transpose(1, 0, 2)
    normals = np.zeros_like(vertices)
    np.add.at(normals, faces.ravel(), np.repeat(np.cross(b - a, c - a), 3, axis=0))
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)


@functools.cache
def _function() -> Callable[..., int] | None:
    """The plugin's, None where MuJoCo has loaded another library of the plugin than mjframes would."""
    try:
        library = ctypes.CDLL(str(library_path()), mode=os.RTLD_NOLOAD | os.RTLD_NOW)
    except OSError:
        return None
    function = library.MjframesDentSkin
    function.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int, ctypes.POINTER(ctypes.c_float), ctypes.c_int]
    function.restype = ctypes.c_int
    return function
