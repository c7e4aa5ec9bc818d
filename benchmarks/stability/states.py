"""States of a soft body from where its control points shall be, whatever its frames: Gauss–Newton on x(qpos)."""

from __future__ import annotations

import mujoco
import numpy as np

from mjframes.elasticity.corotational import closest_rotation
from mjframes.scene.view import Soft

ITERATIONS = 20  # bodies on slides alone need one
LONGEST_TURN = 0.5  # [rad] of an iteration
CLOSE = 1e-9  # [m] or [rad], of the last change


def move_points(view: Soft, target: np.ndarray) -> None:
    """Set qpos so that the control points come as near to `target` (k, 3) [m] as the frames can."""
    model, data = view.model, view.data
    turning = model.jnt_type[model.dof_jntid] != mujoco.mjtJoint.mjJNT_SLIDE
    for _ in range(ITERATIONS):
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        change = np.linalg.lstsq(jacobian(view), (target - view.control_positions).ravel(), rcond=CLOSE)[0]
        change *= min(1.0, LONGEST_TURN / max(np.abs(change[turning]).max(initial=0), LONGEST_TURN))
        mujoco.mj_integratePos(model, data.qpos, change, 1.0)
        if np.abs(change).max() < CLOSE:
            break


def move_with(view: Soft, velocity: np.ndarray) -> None:
    """Set qvel so that all control points have this velocity (3,) [m/s]; needs mj_forward."""
    velocities = np.tile(velocity, len(view.bodies))
    view.data.qvel[:] = np.linalg.lstsq(jacobian(view), velocities, rcond=None)[0]


def misfit(points: np.ndarray, rest: np.ndarray) -> float:
    """Return the largest distance of points (n, 3) from where they rest, rigidly moved to fit [m]."""
    a, b = points - points.mean(axis=0), rest - rest.mean(axis=0)
    return float(np.linalg.norm(a - b @ closest_rotation(a.T @ b).T, axis=1).max())


def jacobian(view: Soft) -> np.ndarray:
    """Return ∂x/∂q (3k, nv) of the control points."""
    found = np.zeros((len(view.bodies), 3, view.model.nv))
    for rows, body, x in zip(found, view.bodies, view.control_positions, strict=True):
        mujoco.mj_jac(view.model, view.data, rows, None, x, int(body))
    return found.reshape(-1, view.model.nv)
