"""Generalized forces as forces on the frames.

The three slides of a frame's outermost body move all that hangs on it by their axes e_a, so that their generalized
forces τ_a are the net force Σ_a τ_a e_a on that subtree; what hangs on it further down is subtracted.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def forces_on_frames(
    model: mujoco.MjModel, data: mujoco.MjData, bodies: NDArray[np.int64], frame: NDArray[np.int64], generalized: Array
) -> Array:
    """Return forces (f, 3) in the world [N] from generalized ones (nv,); NaN for frames without degrees of freedom.

    bodies: (k,) that carry the control points.  frame: (k,) of each.
    """
    carriers, first = np.unique(bodies, return_index=True)
    subtree = np.full((model.nbody, 3), np.nan)
    for body in carriers:
        joint, dof = model.body_jntadr[body], model.body_dofadr[body]
        if joint >= 0:
            subtree[body] = generalized[dof : dof + 3] @ data.xaxis[joint : joint + 3]
    forces = np.zeros((frame.max() + 1, 3))
    for body, i in zip(carriers, frame[first], strict=True):
        forces[i] += subtree[body]
        above = np.flatnonzero(carriers == model.body_parentid[body])
        if len(above):
            forces[frame[first[above[0]]]] -= subtree[body]
    return forces


def wrenches(data: mujoco.MjData, bodies: NDArray[np.int64], points: Array, forces: Array) -> Array:
    """Return what forces at points are in `xfrc_applied` (nbody, 6): a point of a body not at its centre has a torque.

    data: after `mj_kinematics` and `mj_comPos`.  bodies: (k,) that the points (k, 3) [m] ride on.  forces: (k, 3) [N].
    """
    found = np.zeros_like(data.xfrc_applied)
    np.add.at(found, bodies, np.hstack([forces, np.cross(points - data.xipos[bodies], forces)]))
    return found


def contact_rows(model: mujoco.MjModel, data: mujoco.MjData, geoms: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the constraint rows of all contacts of some geoms."""
    rows = []
    for contact in data.contact:
        if contact.efc_address >= 0 and np.isin(contact.geom, geoms).any():
            pyramid = model.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL and contact.dim > 1
            rows += range(contact.efc_address, contact.efc_address + (2 * contact.dim - 2 if pyramid else contact.dim))
    return np.array(rows, int)


def constraint_force(model: mujoco.MjModel, data: mujoco.MjData, rows: NDArray[np.int64]) -> Array:
    """Return Σ_i J_iᵀ f_i (nv,) over some constraint rows."""
    total = np.zeros(model.nv)
    if not mujoco.mj_isSparse(model):
        return data.efc_force[rows] @ data.efc_J.reshape(data.nefc, model.nv)[rows]
    for i in rows:
        entries = slice(data.efc_J_rowadr[i], data.efc_J_rowadr[i] + data.efc_J_rownnz[i])
        np.add.at(total, data.efc_J_colind[entries], data.efc_force[i] * data.efc_J[entries])
    return total


def contact_force_on(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> Array:
    """Return the sum (3,) of all contact forces on a geom, in the world [N]."""
    total, force = np.zeros(3), np.zeros(6)
    for number, contact in enumerate(data.contact):
        if contact.efc_address >= 0 and geom in contact.geom:
            mujoco.mj_contactForce(model, data, number, force)  # on the second geom
            total += (1 if contact.geom[1] == geom else -1) * force[:3] @ contact.frame.reshape(3, 3)
    return total
