"""A point of a body that is held, and the spring that draws it to where the mouse is."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from mjframes.app.carried import Carried, on_body, on_skin

FREQUENCY = 0.3  # [-] greatest ω h of the spring and rate times h of its damper: both are explicit, stable below 2


@dataclass(frozen=True, eq=False)
class Grip:
    """A held point.

    point: that one.
    mass: of what is held [kg].  inertia: of the point itself against forces, the step's stiffness included [kg].
    """

    point: Carried
    mass: float
    inertia: float

    def position(self, data: mujoco.MjData) -> np.ndarray:
        """Return where the point is, in the world (3,) [m]."""
        return self.point.position(data)

    def jacobian(self, model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
        """Return ∂x/∂q (3, nv)."""
        total, one = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        held = self.point
        for body, weight, point in zip(held.bodies.tolist(), held.weights, held.seen(data), strict=True):
            mujoco.mj_jac(model, data, one, None, point, body)
            total += weight * one
        return total

    def pull(self, model: mujoco.MjModel, data: mujoco.MjData, target: np.ndarray, stiffness: float) -> np.ndarray:
        """Put the spring's force on `qfrc_applied` in place of what is there; return it (3,) [N].

        target: where it ends, in the world [m].  stiffness: [N/m]; so much of it acts as a step can bear.
        """
        limit, h = FREQUENCY, model.opt.timestep
        k = min(stiffness, limit**2 * self.inertia / h**2)
        c = min(2 * np.sqrt(k * self.mass), limit * self.inertia / h)
        jacobian = self.jacobian(model, data)
        force = k * (target - self.position(data)) - c * (jacobian @ data.qvel)
        data.qfrc_applied[:] = jacobian.T @ force
        return force


def grip_skin(model: mujoco.MjModel, data: mujoco.MjData, skin: int, vertices: np.ndarray, point: np.ndarray) -> Grip:
    """Return the grip of a skin at the vertex nearest to a point.

    vertices: (n, 3) of the skin as it is deformed.  point: (3,), both in the world [m].
    """
    vertex = int(((vertices - point) ** 2).sum(axis=1).argmin())
    return _grip(model, data, on_skin(model, skin, vertex))


def grip_body(model: mujoco.MjModel, data: mujoco.MjData, body: int, point: np.ndarray) -> Grip:
    """Return the grip of a rigid body at a point (3,) in the world [m]."""
    arm = (point - data.xpos[body]) @ data.xmat[body].reshape(3, 3)
    return _grip(model, data, on_body(body, arm))


def _grip(model: mujoco.MjModel, data: mujoco.MjData, point: Carried) -> Grip:
    tops = model.body_weldid[point.bodies]
    moving = tops[tops > 0]
    trees = np.unique(model.body_rootid[moving])
    mass = float(model.body_subtreemass[trees].sum())
    jacobian = Grip(point, mass, mass).jacobian(model, data)
    response = np.zeros_like(jacobian)
    mujoco.mj_solveM(model, data, response, jacobian)
    yielding = float((jacobian * response).sum()) / 3
    return Grip(point, mass, 1 / yielding if yielding > 0 else 0.0)
