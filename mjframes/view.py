"""Soft bodies of a compiled model, as they are now: read from the model and data alone."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np

from mjframes.errors import MjframesError
from mjframes.mechanics import region_energy, region_response
from mjframes.mjcf import ATTRIBUTES, decode


@dataclass(frozen=True, eq=False)
class Soft:
    """A view of one soft body; current after `mj_forward` or `mj_step`. k control points, r regions.

    bodies: (k,) MuJoCo body of each control point.  dofs: (k, 3) its degrees of freedom.
    """

    model: mujoco.MjModel
    data: mujoco.MjData
    name: str
    bodies: np.ndarray
    dofs: np.ndarray
    configuration: dict[str, str]

    @cached_property
    def rest(self) -> np.ndarray:
        """x̄ (k, 3) in volume coordinates [m]."""
        return decode(self.configuration["point_rest"]).reshape(-1, 3)

    @cached_property
    def regions(self) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Of each region its control points (m,), ḡ (m, 3) [1/m] and K_e (3m, 3m) [N/m]."""
        size = decode(self.configuration["region_size"]).astype(int)
        ends = np.cumsum(size)[:-1]
        points = np.split(decode(self.configuration["region_point"]), ends)
        gradients = np.split(decode(self.configuration["region_gradient"]).reshape(-1, 3), ends)
        lower = np.split(decode(self.configuration["region_stiffness"]), np.cumsum(3 * size * (3 * size + 1) // 2)[:-1])
        matrices = []
        for m, values in zip(size, lower, strict=True):
            matrix = np.zeros((3 * m, 3 * m))
            matrix[np.tril_indices(3 * m)] = values
            matrices.append(matrix + np.tril(matrix, -1).T)
        return list(zip(points, gradients, matrices, strict=True))

    @property
    def control_positions(self) -> np.ndarray:
        """x (k, 3) in the world [m]."""
        return self.data.xpos[self.bodies].copy()

    @property
    def elastic_energy(self) -> float:
        """[J]"""
        x = self.control_positions
        return sum(region_energy(x[p], self.rest[p], g, K) for p, g, K in self.regions)

    @property
    def kinetic_energy(self) -> float:
        """Of the control points' masses [J]."""
        velocity = np.zeros(6)
        energy = 0.0
        for body in self.bodies:
            mujoco.mj_objectVelocity(self.model, self.data, mujoco.mjtObj.mjOBJ_BODY, int(body), velocity, 0)
            energy += 0.5 * self.model.body_mass[body] * float(velocity[3:] @ velocity[3:])
        return energy

    @property
    def elastic_forces(self) -> np.ndarray:
        """(k, 3) on the control points, in the world [N]."""
        x, forces = self.control_positions, np.zeros((len(self.bodies), 3))
        for points, gradient, matrix in self.regions:
            forces[points] += region_response(x[points], self.rest[points], gradient, matrix)[0]
        return forces


def soft(model: mujoco.MjModel, data: mujoco.MjData, name: str) -> Soft:
    """The view of the soft body `name`. Raises MjframesError where the model has none of that name."""
    instances = _instances(model)
    if name not in instances:
        known = ", ".join(map(repr, instances)) or "none"
        raise MjframesError(f"name is {name!r} but the model's soft bodies are: {known}.")
    instance = instances[name]
    bodies = np.flatnonzero(model.body_plugin == instance)
    first = model.jnt_dofadr[model.body_jntadr[bodies]]
    return Soft(model, data, name, bodies, first[:, None] + np.arange(3), _configuration(model, instance))


def soft_names(model: mujoco.MjModel) -> list[str]:
    """The names of the model's soft bodies."""
    return list(_instances(model))


def _instances(model: mujoco.MjModel) -> dict[str, int]:
    """Plugin instances that carry control points, by name."""
    found = {}
    for instance in np.unique(model.body_plugin[model.body_plugin >= 0]):
        if "point_rest" in _configuration(model, int(instance)):
            start = model.name_pluginadr[instance]
            found[model.names[start:].split(b"\0", 1)[0].decode()] = int(instance)
    return found


def _configuration(model: mujoco.MjModel, instance: int) -> dict[str, str]:
    """The attributes of a plugin instance, by key: "value\\0" for each of the plugin's attributes, in their order."""
    start = model.plugin_attradr[instance]
    following = model.plugin_attradr[model.plugin_attradr > start]
    end = following.min() if len(following) else len(model.plugin_attr)
    values = bytes(model.plugin_attr[start:end]).split(b"\0")
    return {key: value.decode() for key, value in zip(ATTRIBUTES, values, strict=False) if value}
