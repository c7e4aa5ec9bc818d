"""Where a free soft body is put, undeformed, and how it is thrown: its joint coordinates, read from a model alone.

    x_c = R r_c + t        every body that carries control points, R of those that turn
    v_c = v + ω × (x_c − x̄)        x̄ the centre of mass

Its bodies are nested, so that a slide holds what its body moves by against the one it hangs on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjframes.base.errors import MjframesError
from mjframes.base.numbers import is_number
from mjframes.scene.links import Pose, compose, inverse, pose, quaternion, require_pose
from mjframes.scene.load import require_state
from mjframes.scene.view import instance_of

Array = NDArray[np.float64]
Vector = Sequence[float] | Array


@dataclass(frozen=True, eq=False)
class Placing:
    """The c bodies of a free soft body, in the model's order.

    holder: pose in the world of the volume's coordinate system, where all coordinates are zero.
    rest: (c, 3) places at rest, in volume coordinates [m].
    above: (c,) the one that each hangs on, −1 for the holder.
    turns: (c,) whether it has a ball joint.
    mass: (c,) [kg].
    qpos, qvel: addresses of the coordinates and velocities, body by body.
    """

    holder: Pose
    rest: Array
    above: NDArray[np.int64]
    turns: NDArray[np.bool_]
    mass: Array
    qpos: NDArray[np.int64]
    qvel: NDArray[np.int64]

    def coordinates(self, pos: Vector, quat: Vector) -> Array:
        """Return what `qpos` has where the volume's coordinate system is at pos [m], quat in the world, undeformed.

        Raise MjframesError for what is no pose.
        """
        require_pose(pos, quat)
        turn, shift = compose(inverse(self.holder), pose(pos, quat))
        at = self.rest @ turn.T + shift
        found: list[Array] = []
        axes: list[Array] = []  # of each body, in the holder
        for c, above in enumerate(self.above):
            outer = axes[above] if above >= 0 else np.eye(3)
            away = at[c] - (at[above] if above >= 0 else 0.0)
            offset = self.rest[c] - (self.rest[above] if above >= 0 else 0.0)
            found.append(away @ outer - offset)
            if self.turns[c]:
                found.append(quaternion(outer.T @ turn))
            axes.append(turn if self.turns[c] else outer)
        return np.concatenate(found)

    def rates(self, quat: Vector, velocity: Vector, spin: Vector) -> Array:
        """Return what `qvel` has there, undeformed, for a velocity of the centre of mass [m/s] and a spin [rad/s].

        Raise MjframesError for what are not three numbers each.
        """
        for name, value, unit in (("velocity", velocity, "metres"), ("spin", spin, "radians")):
            if np.shape(value) != (3,) or not all(map(is_number, value)):
                raise MjframesError(f"{name} is {value!r}; give three {unit} a second, in the world.")
        held = self.holder[0]
        turn, omega = held.T @ pose((0, 0, 0), quat)[0], held.T @ np.asarray(spin, float)
        arm = (self.rest - self.mass @ self.rest / self.mass.sum()) @ turn.T
        moves = held.T @ np.asarray(velocity, float) + np.cross(omega, arm)
        found: list[Array] = []
        turning: list[bool] = []  # whether what hangs on it turns with it
        for c, above in enumerate(self.above):
            turned = above >= 0 and turning[above]
            relative = moves[c] - (moves[above] if above >= 0 else 0.0)
            found.append(np.zeros(3) if turned else relative)
            if self.turns[c]:
                found.append(np.zeros(3) if turned else turn.T @ omega)
            turning.append(bool(self.turns[c]) or turned)
        return np.concatenate(found)


def placing(model: mujoco.MjModel, name: str) -> Placing:
    """Return how soft body `name` of a model is placed.

    Raise MjframesError where the model has no such soft body, and where it is held or hangs on what moves.
    """
    bodies = np.flatnonzero(model.body_plugin == instance_of(model, name))
    if (model.body_jntnum[bodies] == 0).any():
        raise MjframesError(f"{name!r} is held by the scene; only free soft bodies can be placed.")
    holder = int(model.body_parentid[bodies[0]])
    number = {int(body): c for c, body in enumerate(bodies)}
    above = np.array([number.get(int(outer), -1) for outer in model.body_parentid[bodies]])
    rest = np.zeros((len(bodies), 3))
    for c, body in enumerate(bodies):
        rest[c] = model.body_pos[body] + (rest[above[c]] if above[c] >= 0 else 0.0)
    joints = [
        range(start, start + count)
        for start, count in zip(model.body_jntadr[bodies], model.body_jntnum[bodies], strict=True)
    ]
    ball = mujoco.mjtJoint.mjJNT_BALL
    qpos, qvel = [], []
    for joint in (j for some in joints for j in some):
        is_ball = model.jnt_type[joint] == ball
        qpos += range(model.jnt_qposadr[joint], model.jnt_qposadr[joint] + (4 if is_ball else 1))
        qvel += range(model.jnt_dofadr[joint], model.jnt_dofadr[joint] + (3 if is_ball else 1))
    turns = np.array([any(model.jnt_type[j] == ball for j in some) for some in joints])
    mass = model.body_mass[bodies]
    return Placing(_static_pose(model, holder, name), rest, above, turns, mass, np.array(qpos), np.array(qvel))


def place(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    name: str,
    pos: Vector,
    quat: Vector = (1, 0, 0, 0),
    velocity: Vector = (0, 0, 0),
    spin: Vector = (0, 0, 0),
) -> None:
    """Put a free soft body somewhere, undeformed, at rest or thrown.

    Call `mj_forward` afterwards, as after any change of `qpos`.

    Parameters
    ----------
    model, data
        The compiled model and the state to change.
    name
        Name of the soft body.
    pos, quat
        Position [m] and quaternion (w, x, y, z) of the volume's coordinate system in the world.
    velocity, spin
        Velocity of its centre of mass [m/s] and how fast it turns about that [rad/s], in the world.

    Raises
    ------
    MjframesError
        If the model has no such soft body, if something holds it, and for numbers that are no pose or no velocity.
    """
    require_state(model, data)
    found = placing(model, name)
    data.qpos[found.qpos] = found.coordinates(pos, quat)
    data.qvel[found.qvel] = found.rates(quat, velocity, spin)


def _static_pose(model: mujoco.MjModel, body: int, name: str) -> Pose:
    """The pose of a body in the world. Raise MjframesError where it moves."""
    found: Pose = (np.eye(3), np.zeros(3))
    while body:
        if model.body_jntnum[body] or model.body_mocapid[body] >= 0:
            raise MjframesError(f"{name!r} hangs on a body that moves; only those below the world can be placed.")
        found = compose(pose(model.body_pos[body], model.body_quat[body]), found)
        body = int(model.body_parentid[body])
    return found
