"""What is measured at an instant of a run.

Energies at the start of a step, when positions, velocities and contacts of MjData belong together:
kinetic ½ Σ_b (m_b |v_b|² + ω_bᵀ I_b ω_b) + ½ Σ_d armature_d q̇_d² over bodies b and degrees of freedom d, potential as
MuJoCo has it (gravity and springs), elastic as the soft bodies have it. MuJoCo's own kinetic energy is not used: during
a step its mass matrix is that of equation (7), M + hC + h²K.
"""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np

from mjframes.app.recording import STATE, Instant, State
from mjframes.scene.view import Soft


def state_of(data: mujoco.MjData) -> State:
    """Return a copy of the present state."""
    return State(data.time, *(getattr(data, name).copy() for name in STATE))


def measure(
    model: mujoco.MjModel, data: mujoco.MjData, bodies: Mapping[str, Soft], state: State, depth: float
) -> Instant:
    """Return the instant at which a step started.

    data: after `mj_step`, which leaves all but the state as it was at the start.  bodies: the soft ones, by name.
    state: at the start.  depth: the instant's `penetration` [m].
    """
    forces = contact_forces(model, data)
    soft = {name: np.isin(data.contact.geom, body.patches).any(axis=1) for name, body in bodies.items()}
    return Instant(
        time=state.time,
        kinetic=kinetic_energy(model, data, state.qvel)
        + sum(float(body.kinetic_difference) for body in bodies.values()),
        potential=float(data.energy[0]),
        elastic={name: float(body.elastic_energy) for name, body in bodies.items()},
        soft_kinetic={name: float(body.kinetic_energy) for name, body in bodies.items()},
        contacts=data.ncon,
        penetration=float(depth),
        normal_force=float(forces.sum()),
        soft_force={name: float(forces[its].sum()) for name, its in soft.items()},
        rigid_force=float(forces[~np.any([np.zeros(len(forces), bool), *soft.values()], axis=0)].sum()),
        speed=float(np.linalg.norm(_center_velocities(model, data), axis=1).max()),
    )


def weight_of(model: mujoco.MjModel) -> float:
    """Return the weight of all that moves [N]."""
    return float(model.body_mass[model.body_weldid != 0].sum() * np.linalg.norm(model.opt.gravity))


def penetration(data: mujoco.MjData) -> float:
    """The deepest penetration of the contacts that act [m], 0 where nothing touches; current after `mj_step`."""
    acting = data.contact.dist[data.contact.exclude == 0]
    return max(0.0, -float(acting.min())) if len(acting) else 0.0


def contact_forces(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Return the normal force (ncon,) of each contact [N]."""
    found, force = np.zeros(data.ncon), np.zeros(6)
    for contact in range(data.ncon):
        mujoco.mj_contactForce(model, data, contact, force)
        found[contact] = force[0]
    return found


def kinetic_energy(model: mujoco.MjModel, data: mujoco.MjData, qvel: np.ndarray) -> float:
    """Of all bodies and armatures, as MuJoCo knows their masses [J].  qvel: (nv,), that of data's `cvel`."""
    velocity = _center_velocities(model, data)
    spin = np.einsum("bji,bj->bi", data.ximat.reshape(-1, 3, 3), data.cvel[:, :3])
    linear = model.body_mass @ (velocity**2).sum(axis=1)
    angular = (model.body_inertia * spin**2).sum()
    return 0.5 * float(linear + angular + model.dof_armature @ qvel**2)


def _center_velocities(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """(nbody, 3) velocities of the bodies' centres of mass [m/s]; `cvel` is about the centre of the whole tree."""
    arm = data.xipos - data.subtree_com[model.body_rootid]
    return data.cvel[:, 3:] + np.cross(data.cvel[:, :3], arm)
