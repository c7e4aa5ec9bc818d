"""Starting poses: what floats free is moved and turned as a whole, in `qpos`, so that states tell where it is.

A point x of it goes to c + R (x − c) + t, c its centre of mass. Its bodies are those of a soft body, on three slides,
which a rigid frame turns below by a ball, or one on a free joint. Nothing of a soft body is strained by that.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from mjframes.base.errors import MjframesError
from mjframes.scene.view import soft, soft_names

SLIDE, BALL, FREE = (int(getattr(mujoco.mjtJoint, f"mjJNT_{name}")) for name in ("SLIDE", "BALL", "FREE"))


@dataclass(frozen=True, eq=False)
class Movable:
    """What can be moved as a whole.

    bodies: of the model, those above before those below.
    positions, orientations: (nbody, 3) [m] and (nbody, 4) of all bodies of the model at `qpos`.
    qpos: (nq,) where it starts unless it is moved.
    centre: (3,) of its mass [m].
    """

    model: mujoco.MjModel
    bodies: tuple[int, ...]
    positions: np.ndarray
    orientations: np.ndarray
    qpos: np.ndarray
    centre: np.ndarray

    def move(self, qpos: np.ndarray, shift: np.ndarray, turn: np.ndarray) -> None:
        """Set what is moved by `shift` (3,) [m], and turned about its centre by the quaternion `turn`, in `qpos`."""
        model, place, facing = self.model, self.positions.copy(), self.orientations.copy()
        for body in self.bodies:
            above = int(model.body_parentid[body])
            place[body] = self.centre + shift + _turned(turn, self.positions[body] - self.centre)
            frame = _product(facing[above], model.body_quat[body])
            arm = place[body] - place[above] - _turned(facing[above], model.body_pos[body])
            facing[body] = frame
            first = int(model.body_jntadr[body])
            for joint in range(first, first + int(model.body_jntnum[body])):
                at, kind = int(model.jnt_qposadr[joint]), int(model.jnt_type[joint])
                if kind == SLIDE:
                    qpos[at] = model.qpos0[at] + arm @ _turned(frame, model.jnt_axis[joint])
                elif kind == BALL:
                    facing[body] = _product(turn, self.orientations[body])
                    qpos[at : at + 4] = _product(frame * (1, -1, -1, -1), facing[body])
                else:
                    facing[body] = _product(turn, self.orientations[body])
                    qpos[at : at + 3], qpos[at + 3 : at + 7] = place[body], facing[body]


def movable(model: mujoco.MjModel, data: mujoco.MjData, name: str) -> Movable:
    """Return the soft body `name`, or the body `name` on a free joint, from where it is in `data` after `mj_forward`.

    Raise MjframesError where the model has neither, and for a soft body that something holds.
    """
    if name in soft_names(model):
        view = soft(model, data, name)
        bodies = np.unique(view.bodies)
        if not model.body_jntnum[bodies].all():
            raise MjframesError(f"{name!r} is held by other bodies: it starts where they are, and cannot be moved.")
    else:
        bodies = np.array([_free_body(model, name)])
    mass = model.body_mass[bodies]
    centre = mass @ data.xipos[bodies] / mass.sum()
    found = tuple(bodies.tolist())
    return Movable(model, found, data.xpos.copy(), data.xquat.copy(), data.qpos.copy(), centre)


def _free_body(model: mujoco.MjModel, name: str) -> int:
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)
    if body < 0 or model.body_jntnum[body] != 1 or model.jnt_type[model.body_jntadr[body]] != FREE:
        free = [model.body(int(b)).name for b in model.jnt_bodyid[model.jnt_type == FREE]]
        known = ", ".join(map(repr, [*soft_names(model), *filter(None, free)])) or "none"
        raise MjframesError(f"{name!r} is no soft body and no body on a free joint; those of the scene are: {known}.")
    return body


def _product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    found = np.empty(4)
    mujoco.mju_mulQuat(found, np.asarray(a, float), np.asarray(b, float))
    return found


def _turned(quat: np.ndarray, vector: np.ndarray) -> np.ndarray:
    found = np.empty(3)
    mujoco.mju_rotVecQuat(found, np.asarray(vector, float), np.asarray(quat, float))
    return found
