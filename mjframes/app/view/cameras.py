"""Where one may look at a scene from: MuJoCo's free camera, and the scene's own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

FREE = "free"


@dataclass(frozen=True, eq=False)
class View:
    """A camera.

    position, target: where it is and what it looks at, in the world (3,) [m].  angle: of view, vertically [rad].
    """

    position: np.ndarray
    target: np.ndarray
    angle: float


def views(model: mujoco.MjModel, data: mujoco.MjData) -> dict[str, View]:
    """Return the cameras by name as they are now: the scene's, of which those without a name are numbered, and the free
    one.
    """
    found = {model.camera(k).name or f"camera {k}": _fixed(model, data, k) for k in range(model.ncam)}
    return {**found, FREE: _free(model)}


def aim(camera: Any, view: View) -> None:
    """Let a camera of viser, or its initial one, look as `view` does."""
    camera.position, camera.look_at, camera.fov = view.position, view.target, view.angle


def _free(model: mujoco.MjModel) -> View:
    """Return where MuJoCo's viewer starts."""
    azimuth, elevation = np.radians([model.vis.global_.azimuth, model.vis.global_.elevation])
    ahead = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    center = np.array(model.stat.center)
    return View(center - 1.5 * model.stat.extent * ahead, center, float(np.radians(model.vis.global_.fovy)))


def _fixed(model: mujoco.MjModel, data: mujoco.MjData, camera: int) -> View:
    """Return a camera of the scene, which looks at the point on its axis that is nearest to the scene's centre."""
    position, ahead = data.cam_xpos[camera].copy(), -data.cam_xmat[camera].reshape(3, 3)[:, 2]
    away = max(float((model.stat.center - position) @ ahead), 0.1 * model.stat.extent)
    return View(position, position + away * ahead, float(np.radians(model.cam_fovy[camera])))
