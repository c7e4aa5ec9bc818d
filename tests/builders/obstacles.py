"""Rigid geoms that soft bodies meet."""

from __future__ import annotations

import mujoco
import numpy as np


def lowest(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    """z of the lowest point of the obstacle [m], by bringing a plane's normal to it."""
    geom = model.geom("obstacle").id
    size, axes = model.geom_size[geom], data.geom_xmat[geom].reshape(3, 3)
    down = -axes[2]
    match int(model.geom_type[geom]):
        case mujoco.mjtGeom.mjGEOM_SPHERE:
            reach = size[0]
        case mujoco.mjtGeom.mjGEOM_CAPSULE:
            reach = size[0] + size[1] * abs(down[2])
        case mujoco.mjtGeom.mjGEOM_ELLIPSOID:
            reach = np.linalg.norm(size * down)
        case mujoco.mjtGeom.mjGEOM_CYLINDER:
            reach = size[0] * np.hypot(*down[:2]) + size[1] * abs(down[2])
        case mujoco.mjtGeom.mjGEOM_BOX:
            reach = np.abs(size * down).sum()
        case _:
            reach = (model.mesh_vert[: model.mesh_vertnum[0]] @ down).max()
    return float(data.geom_xpos[geom][2] - reach)
