"""Which voxels are near the geoms of a body: what is glued to it."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjframes.base.errors import MjframesError, reason
from mjframes.base.numbers import is_number
from mjframes.scene import links
from mjframes.volume.volume import Volume

PROBE = 1e-6  # [m] radius of the sphere whose distance is asked for: MuJoCo has no points
ROUNDING = 1e-3  # [voxels] so that voxels whose faces touch a geom are near it
UNMEASURED = (mujoco.mjtGeom.mjGEOM_HFIELD, mujoco.mjtGeom.mjGEOM_SDF)  # MuJoCo has no distance to these


def near(
    spec: mujoco.MjSpec,
    parent: str,
    volume: Volume,
    distance: float,
    *,
    pos: Sequence[float] = (0.0, 0.0, 0.0),
    quat: Sequence[float] = (1.0, 0.0, 0.0, 0.0),
) -> NDArray[np.bool_]:
    """Return a mask of the voxels that are near the geoms of a body, for `mjframes.Fixed`.

    Parameters
    ----------
    spec
        The scene.
    parent
        Name of the body. Its geoms that collide count, or all of them if none does. A mesh counts as its convex hull.
    volume
        The volume.
    distance
        Largest distance between the surface of a geom and that of a voxel [m]. Voxels inside a geom are near it.
    pos, quat
        Position [m] and quaternion (w, x, y, z) that you will give to `attach`.

    Returns
    -------
    array
        Mask (nx, ny, nz) of the volume's shape.

    Raises
    ------
    MjframesError
        For a body that is not there or has no geoms, and if no voxel is near them.
    """
    if not (is_number(distance) and 0 <= distance < np.inf):
        raise MjframesError(f"distance is {distance!r}; it must be a length in metres, 0 or more.")
    links.find_body(spec, parent)
    links.require_pose(pos, quat)
    model, data, probe = _probed(spec)
    axes, place = links.compose(_pose(data, model.body(parent).id), links.pose(pos, quat))
    centers = volume.centers @ axes.T + place
    reach = distance + (0.5 + ROUNDING) * float(volume.spacing.min())
    gap = np.full(len(centers), np.inf)
    for geom in _geoms(model, parent):
        gap = np.minimum(gap, _distances(model, data, geom, probe, centers, reach))
    mask = np.asarray(volume.labels > 0)
    mask[mask] = gap <= reach
    if not mask.any():
        raise MjframesError(
            f"no voxel is within {distance:g} m of the geoms of {parent!r}; give a larger distance, or another pos."
        )
    return mask


def _probed(spec: mujoco.MjSpec) -> tuple[mujoco.MjModel, mujoco.MjData, int]:
    """A copy of the scene at its reference configuration, and the number of a tiny sphere in it."""
    probed = spec.copy()
    probed.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[PROBE, 0, 0])
    try:
        model = probed.compile()
    except (ValueError, mujoco.FatalError) as error:
        raise MjframesError(f"MuJoCo cannot compile the scene ({reason(error)}).") from error
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return model, data, int(model.body_geomadr[0] + model.body_geomnum[0] - 1)


def _geoms(model: mujoco.MjModel, parent: str) -> list[int]:
    """Those of a body that collide, or all. Raise MjframesError where it has none."""
    body = model.body(parent)
    own = [int(body.geomadr[0]) + n for n in range(int(body.geomnum[0]))]
    own = [geom for geom in own if model.geom_type[geom] not in UNMEASURED]
    own = own[:-1] if body.id == 0 else own  # the probe
    colliding = [geom for geom in own if model.geom_contype[geom] or model.geom_conaffinity[geom]]
    if not own:
        raise MjframesError(f"parent is {parent!r}, which has no geoms to be near; give a body that has some.")
    return colliding or own


def _distances(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    geom: int,
    probe: int,
    points: NDArray[np.float64],
    most: float,
) -> NDArray[np.float64]:
    """Signed distances (n,) from a geom to points (n, 3) in the world [m]; infinite where above `most`."""
    found = np.full(len(points), np.inf)
    bound = float(model.geom_rbound[geom])  # 0 of a plane
    away = np.linalg.norm(points - data.geom_xpos[geom], axis=1)
    for n in np.flatnonzero((away <= bound + most) | (bound == 0)).tolist():
        data.geom_xpos[probe] = points[n]
        found[n] = PROBE + mujoco.mj_geomDistance(model, data, geom, probe, 2 * most, None)
    return found


def _pose(data: mujoco.MjData, body: int) -> links.Pose:
    return data.xmat[body].reshape(3, 3).copy(), data.xpos[body].copy()
