"""What the task of lifting a steak observes, rewards and draws at random: functions of a model and its arrays.

    reward = min(1, max(0, z − z₀) / LIFT)      z: height of the steak's centre of mass

`DataArrays` are those of an `mjData` or of a `mujoco.batch.Batch`, whose leading axis is that of its worlds; a world
gives the same bits alone and among others. dm_control's task and Gymnasium's environments are made of these functions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjframes.body.soft_body import SoftBody
from mjframes.scene.placing import Placing, placing
from mjframes.scene.readings import Readings, readings
from mjframes.scene.view import soft

Array = NDArray[np.float64]

TIME_LIMIT = 10.0  # [s] of an episode, as in dm_control.manipulation
CONTROL_TIMESTEP, PHYSICS_TIMESTEP = 0.04, 0.002  # [s]
STEPS = round(CONTROL_TIMESTEP / PHYSICS_TIMESTEP)  # of physics in one of control
LIFT = 0.15  # [m] by which the centre of mass is to rise for the whole reward
BLOCK = (0.05, 0.05, 0.1)  # [m] half sizes of the block: the steak juts out over it, so that a hand gets hold of it
THICKNESS = 0.0145  # [m] from the steak's middle to its lower side, and a little air
REACH = 0.8  # [m] from the block to the arm's base, along y
OPEN = 0.15  # [rad] of the fingers
HOME = (1.3152, 2.1269, 5.3417, 3.5540, 4.2690, 5.3630)  # [rad] of the arm: level, two fingers below the steak's height
SPREAD = {"place": 0.01, "yaw": 0.2, "joint": 0.02}  # [m], [rad], [rad]: half widths of what is drawn evenly
SOFTEST, STIFFEST = 0.5, 2.0  # [-] factors of the moduli, drawn evenly in their logarithm


class DataArrays(Protocol):
    """Of `mjData`, or of many worlds."""

    qpos: Any
    qvel: Any
    sensordata: Any
    site_xpos: Any
    site_xmat: Any


class Uniform(Protocol):
    """NumPy's generators of random numbers, old and new."""

    def uniform(self, low: float, high: float, size: int | None = None) -> Any:
        """Return numbers drawn evenly."""
        ...


@dataclass(frozen=True, eq=False)
class Layout:
    """Where the arrays of a scene have what matters.

    arm, hand: (6,), (3,) addresses in qpos; arm_dof, hand_dof in qvel.
    torque: (6, 3) addresses in sensordata of the arm's torques; axis: (6, 3) of its joints.
    pinch: site between the fingertips.
    steak, placing: of the steak; name: of it.
    touch: (n,) addresses in sensordata of the pressures on its taxels, none without.
    """

    arm: NDArray[np.int64]
    hand: NDArray[np.int64]
    arm_dof: NDArray[np.int64]
    hand_dof: NDArray[np.int64]
    torque: NDArray[np.int64]
    axis: Array
    pinch: int
    steak: Readings
    placing: Placing
    name: str
    touch: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Start:
    """How an episode starts: qpos (nq,), and the factor of the steak's moduli [-]."""

    qpos: Array
    stiffness: float


def layout(
    model: mujoco.MjModel,
    arm: list[str],
    hand: list[str],
    torque: list[str],
    pinch: str,
    steak: str,
    body: SoftBody,
    touch: list[str],
) -> Layout:
    """Return the layout of a compiled scene: names of joints, torque sensors and the site; the steak and its name.

    touch: names of the sensors of its taxels.
    """
    joints = [[model.joint(name) for name in names] for names in (arm, hand)]
    arm_at, hand_at = (np.array([joint.qposadr[0] for joint in some], np.int64) for some in joints)
    arm_dof, hand_dof = (np.array([joint.dofadr[0] for joint in some], np.int64) for some in joints)
    sensors = np.array([model.sensor(name).adr[0] + np.arange(3) for name in torque])
    axis = np.array([joint.axis for joint in joints[0]])
    at = readings(soft(model, mujoco.MjData(model), steak), body)
    taxels = [some.adr[0] + np.arange(some.dim[0]) for some in map(model.sensor, touch)]
    felt = np.concatenate([np.zeros(0, np.int64), *taxels])
    return Layout(
        arm_at, hand_at, arm_dof, hand_dof, sensors, axis, model.site(pinch).id, at, placing(model, steak), steak, felt
    )


def starting(model: mujoco.MjModel, at: Layout, random: Uniform) -> Start:
    """Draw how an episode starts: the steak's place and yaw on the block, the arm's joints, the steak's stiffness."""
    x, y = random.uniform(-SPREAD["place"], SPREAD["place"], 2)
    yaw = 0.5 * np.pi + random.uniform(-SPREAD["yaw"], SPREAD["yaw"])  # the strip loin to the arm
    qpos = model.qpos0.copy()
    qpos[at.arm] = np.add(HOME, random.uniform(-SPREAD["joint"], SPREAD["joint"], len(HOME)))
    qpos[at.hand] = OPEN
    height = 2 * BLOCK[2] + THICKNESS
    qpos[at.placing.qpos] = at.placing.coordinates((x, y, height), (np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)))
    return Start(qpos, float(np.exp(random.uniform(np.log(SOFTEST), np.log(STIFFEST)))))


def reward(at: Layout, data: DataArrays) -> Array:
    """Return how far the steak is lifted (…): 0 where it lay, 1 from LIFT on; linear in between."""
    height = at.steak.centre_of_mass(data.sensordata)[..., 2]
    return np.clip((height - 2 * BLOCK[2] - THICKNESS) / LIFT, 0.0, 1.0)


def _arm_angles(at: Layout, data: DataArrays) -> Array:
    angles = data.qpos[..., at.arm]
    return np.concatenate([np.sin(angles), np.cos(angles)], axis=-1)  # most joints may turn round and round


def _arm_torques(at: Layout, data: DataArrays) -> Array:
    torque = (data.sensordata[..., at.torque] * at.axis).sum(axis=-1)
    return np.sign(torque) * np.log1p(np.abs(torque))


PROPRIOCEPTION: dict[str, Callable[[Layout, DataArrays], Array]] = {
    "arm_angles": _arm_angles,  # 12: sines, cosines
    "arm_velocities": lambda at, data: data.qvel[..., at.arm_dof],  # 6 [rad/s]
    "arm_torques": _arm_torques,  # 6: sign(τ) log(1 + |τ|), τ in N m
    "fingers": lambda at, data: data.qpos[..., at.hand],  # 3 [rad]
    "finger_velocities": lambda at, data: data.qvel[..., at.hand_dof],  # 3 [rad/s]
    "pinch_position": lambda at, data: data.site_xpos[..., at.pinch, :],  # 3 [m]
    "pinch_axes": lambda at, data: data.site_xmat[..., at.pinch, :],  # 9
}
STEAK: dict[str, Callable[[Layout, DataArrays], Array]] = {
    "steak_frames": lambda at, data: at.steak.frame_positions(data.sensordata),  # f × 3 [m]
    "steak_velocities": lambda at, data: at.steak.frame_velocities(data.sensordata),  # f × 3 [m/s]
    "steak_contact": lambda at, data: at.steak.contact_force(data.sensordata),  # 3 [N]
}
FEATURES = PROPRIOCEPTION | STEAK


def features(at: Layout, data: DataArrays) -> Array:
    """Return all features (…, n), in the order of `FEATURES`, and behind them the pressures on taxels [kPa]."""
    leading = data.qpos.shape[:-1]
    found = [feature(at, data).reshape(*leading, -1) for feature in FEATURES.values()]
    return np.concatenate([*found, data.sensordata[..., at.touch] / 1000], axis=-1)
