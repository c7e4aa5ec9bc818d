"""A point that bodies carry: x = Σ_b w_b (x_b + R_b l_b), so a force on it acts on each of them with its weight.

A vertex of a skin is one, carried by the skin's bones. No voxels are needed, so a scene from a file will do.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from mjframes.scene.links import pose


@dataclass(frozen=True, eq=False)
class Carried:
    """A point.

    bodies, weights: (n,) that carry it, and how much each.  arms: (n, 3) where it is in the axes of each [m].
    """

    bodies: np.ndarray
    weights: np.ndarray
    arms: np.ndarray

    def position(self, data: mujoco.MjData) -> np.ndarray:
        """Return where the point is, in the world (3,) [m]."""
        return self.weights @ self.seen(data)

    def seen(self, data: mujoco.MjData) -> np.ndarray:
        """Return where each body alone would have the point (n, 3) [m]."""
        return data.xpos[self.bodies] + np.einsum("nij,nj->ni", data.xmat[self.bodies].reshape(-1, 3, 3), self.arms)


def on_skin(model: mujoco.MjModel, skin: int, vertex: int) -> Carried:
    """Return a vertex of a skin, by its number there."""
    rest = np.array(model.skin_vert[model.skin_vertadr[skin] + vertex], float)
    bodies, weights, arms = [], [], []
    for bone in range(model.skin_boneadr[skin], model.skin_boneadr[skin] + model.skin_bonenum[skin]):
        entries = slice(model.skin_bonevertadr[bone], model.skin_bonevertadr[bone] + model.skin_bonevertnum[bone])
        for weight in model.skin_bonevertweight[entries][model.skin_bonevertid[entries] == vertex].tolist():
            bodies.append(int(model.skin_bonebodyid[bone]))
            weights.append(weight)
            rotation, position = pose(model.skin_bonebindpos[bone], model.skin_bonebindquat[bone])
            arms.append((rest - position) @ rotation)
    return Carried(np.array(bodies), np.array(weights), np.array(arms))


def on_body(body: int, arm: np.ndarray) -> Carried:
    """Return a point of a rigid body, at `arm` (3,) in its axes [m]."""
    return Carried(np.array([body]), np.ones(1), arm[None])
