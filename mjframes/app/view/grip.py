"""A point of a body that is held, and the spring that draws it to where the mouse is.

A point of a skin moves with the skin's bones, x = Σ_b w_b (x_b + R_b l_b), and a force on it acts on each of them with
its weight: no voxels are needed, so that a scene from a file can be pushed as well.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from mjframes.scene.links import pose

SLIGHT = 1e-3  # [-] smaller weights of bones are left out: a thousandth of the force
FREQUENCY = 0.3  # [-] greatest ω h of the spring and rate times h of its damper: both are explicit, stable below 2


@dataclass(frozen=True, eq=False)
class Grip:
    """A held point.

    bodies, weights: (n,) that carry it, and how much each.  arms: (n, 3) where it is in the axes of each [m].
    mass: of what is held [kg].  inertia: of the point itself against forces, the step's stiffness included [kg].
    """

    bodies: np.ndarray
    weights: np.ndarray
    arms: np.ndarray
    mass: float
    inertia: float

    def position(self, data: mujoco.MjData) -> np.ndarray:
        """Return where the point is, in the world (3,) [m]."""
        return self.weights @ self._seen(data)

    def _seen(self, data: mujoco.MjData) -> np.ndarray:
        """Where each body alone would have the point (n, 3) [m]."""
        return data.xpos[self.bodies] + np.einsum("nij,nj->ni", data.xmat[self.bodies].reshape(-1, 3, 3), self.arms)

    def jacobian(self, model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
        """Return ∂x/∂q (3, nv)."""
        total, one = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        for body, weight, point in zip(self.bodies.tolist(), self.weights, self._seen(data), strict=True):
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
    rest = np.array(model.skin_vert[model.skin_vertadr[skin] + vertex], float)
    bodies, weights, arms = [], [], []
    for bone in range(model.skin_boneadr[skin], model.skin_boneadr[skin] + model.skin_bonenum[skin]):
        entries = slice(model.skin_bonevertadr[bone], model.skin_bonevertadr[bone] + model.skin_bonevertnum[bone])
        for weight in model.skin_bonevertweight[entries][model.skin_bonevertid[entries] == vertex].tolist():
            if abs(weight) > SLIGHT:
                bodies.append(int(model.skin_bonebodyid[bone]))
                weights.append(weight)
                rotation, position = pose(model.skin_bonebindpos[bone], model.skin_bonebindquat[bone])
                arms.append((rest - position) @ rotation)
    return _grip(model, data, np.array(bodies), np.array(weights), np.array(arms))


def grip_body(model: mujoco.MjModel, data: mujoco.MjData, body: int, point: np.ndarray) -> Grip:
    """Return the grip of a rigid body at a point (3,) in the world [m]."""
    arm = (point - data.xpos[body]) @ data.xmat[body].reshape(3, 3)
    return _grip(model, data, np.array([body]), np.ones(1), arm[None])


def _grip(
    model: mujoco.MjModel, data: mujoco.MjData, bodies: np.ndarray, weights: np.ndarray, arms: np.ndarray
) -> Grip:
    tops = model.body_weldid[bodies]
    moving = tops[tops > 0]
    trees = np.unique(model.body_rootid[moving])
    mass = float(model.body_subtreemass[trees].sum())
    grip = Grip(bodies, weights, arms, mass, mass)
    jacobian = grip.jacobian(model, data)
    response = np.zeros_like(jacobian)
    mujoco.mj_solveM(model, data, response, jacobian)
    yielding = float((jacobian * response).sum()) / 3
    return Grip(bodies, weights, arms, mass, 1 / yielding if yielding > 0 else 0.0)
