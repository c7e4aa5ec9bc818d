"""Generalized forces as forces on the frames.

The three slides of a frame's outermost body move all that hangs on it by their axes e_a, so that their generalized
forces τ_a are the net force Σ_a τ_a e_a on that subtree; what hangs on it further down is subtracted.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

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


@dataclass(frozen=True, eq=False)
class Touch:
    """A contact of one of some geoms.

    geom: that one.  other: the other one, −1 for a flex.
    position: (3,) [m] and force: (3,) on it [N], in the world.  rows: of the constraints.
    """

    geom: int
    other: int
    position: Array
    force: Array
    rows: NDArray[np.int64]


def touches_of(model: mujoco.MjModel, data: mujoco.MjData, geoms: NDArray[np.int64]) -> Iterator[Touch]:
    """Yield the contacts of some geoms with others."""
    wrench, pyramid = np.zeros(6), model.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL
    chosen = set(geoms.tolist())
    for number, contact in enumerate(data.contact):
        first, second = contact.geom.tolist()
        if contact.efc_address < 0 or (first in chosen) == (second in chosen):
            continue
        mujoco.mj_contactForce(model, data, number, wrench)  # on the second geom
        geom, other, sign = (second, first, 1) if second in chosen else (first, second, -1)
        count = 2 * contact.dim - 2 if pyramid and contact.dim > 1 else contact.dim
        rows = contact.efc_address + np.arange(count)
        yield Touch(geom, other, contact.pos.copy(), sign * wrench[:3] @ contact.frame.reshape(3, 3), rows)


def forces_on_geoms(model: mujoco.MjModel, data: mujoco.MjData, geoms: NDArray[np.int64]) -> Array:
    """Return the net force (g, 3) on each of some geoms by contacts with others, in the world [N].

    As `touches_of`, all contacts at once: with forces f of its rows a contact has Σ f along its normal and μ (f − f')
    along each tangent if cones are pyramidal.
    """
    number = np.full(model.ngeom + 1, -1)  # the last one is of flexes
    number[geoms] = np.arange(len(geoms))
    contacts = data.contact
    own = number[contacts.geom]
    some = np.flatnonzero(((own[:, 0] < 0) != (own[:, 1] < 0)) & (contacts.efc_address >= 0))
    found = np.zeros((len(geoms), 3))
    if not len(some):
        return found
    dim, first = contacts.dim[some], contacts.efc_address[some]
    pyramid = (model.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL) & (dim > 1)
    count = np.where(pyramid, 2 * dim - 2, dim)
    padded = np.append(data.efc_force, 0.0)
    rows = np.arange(count.max())
    force = padded[np.where(rows < count[:, None], first[:, None] + rows, data.nefc)]  # (c, rows)
    local = np.zeros((len(some), 3))
    local[:, 0] = np.where(pyramid, force.sum(axis=1), force[:, 0])
    for axis in (1, 2):
        if force.shape[1] > axis:
            local[:, axis] = np.where(pyramid, 0, force[:, axis])
        if force.shape[1] > 2 * axis - 1:
            edges = contacts.friction[some, axis - 1] * (force[:, 2 * axis - 2] - force[:, 2 * axis - 1])
            local[:, axis] += np.where(pyramid, edges, 0)
    in_world = np.einsum("ca,cab->cb", local, contacts.frame[some].reshape(-1, 3, 3))
    second = own[some, 1] >= 0
    np.add.at(found, own[some, second.astype(int)], np.where(second[:, None], in_world, -in_world))
    return found


def constraint_force(model: mujoco.MjModel, data: mujoco.MjData, rows: NDArray[np.int64]) -> Array:
    """Return Σ_i J_iᵀ f_i (nv,) over some constraint rows."""
    total = np.zeros(model.nv)
    if not mujoco.mj_isSparse(model):
        return data.efc_force[rows] @ data.efc_J.reshape(data.nefc, model.nv)[rows]
    for i in rows:
        entries = slice(data.efc_J_rowadr[i], data.efc_J_rowadr[i] + data.efc_J_rownnz[i])
        np.add.at(total, data.efc_J_colind[entries], data.efc_force[i] * data.efc_J[entries])
    return total
