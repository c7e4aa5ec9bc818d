"""Starting poses: what floats free is moved and turned as a whole, in `qpos`, so that states tell where it is.

A point x of it goes to c + R (x − c) + t, c its centre of mass.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from mjframes.base.errors import MjframesError
from mjframes.scene.links import Pose, compose, pose, quaternion
from mjframes.scene.placing import Placing, placing
from mjframes.scene.view import soft, soft_names


@dataclass(frozen=True, eq=False)
class Movable:
    """What can be moved as a whole.

    start: its pose in the world where it starts, of a soft body that of its volume's coordinate system.
    centre: (3,) of its mass there [m].
    qpos: addresses of its coordinates.
    placing: of a soft body.
    """

    start: Pose
    centre: np.ndarray
    qpos: np.ndarray
    placing: Placing | None

    def move(self, qpos: np.ndarray, shift: np.ndarray, turn: np.ndarray) -> None:
        """Set what is moved by `shift` (3,) [m], and turned about its centre by the quaternion `turn`, in `qpos`."""
        about, _ = pose(np.zeros(3), turn)
        axes, place = compose((about, self.centre + shift - about @ self.centre), self.start)
        facing = quaternion(axes)
        qpos[self.qpos] = self.placing.coordinates(place, facing) if self.placing else [*place, *facing]


def movable(model: mujoco.MjModel, data: mujoco.MjData, name: str) -> Movable:
    """Return the soft body `name`, or the body `name` on a free joint, from where it is in `data` after `mj_forward`.

    Raise MjframesError where the model has neither, and for a soft body that is held or hangs on what moves.
    """
    if name in soft_names(model):
        found = placing(model, name)
        bodies = np.unique(soft(model, data, name).bodies)
        mass = model.body_mass[bodies]
        return Movable(found.holder, mass @ data.xipos[bodies] / mass.sum(), found.qpos, found)
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)
    free = mujoco.mjtJoint.mjJNT_FREE
    if body < 0 or model.body_jntnum[body] != 1 or model.jnt_type[model.body_jntadr[body]] != free:
        others = [model.body(int(b)).name for b in model.jnt_bodyid[model.jnt_type == free]]
        known = ", ".join(map(repr, [*soft_names(model), *filter(None, others)])) or "none"
        raise MjframesError(f"{name!r} is no soft body and no body on a free joint; those of the scene are: {known}.")
    address = int(model.jnt_qposadr[model.body_jntadr[body]])
    start = pose(data.xpos[body], data.xquat[body])
    return Movable(start, data.xipos[body].copy(), np.arange(address, address + 7), None)
