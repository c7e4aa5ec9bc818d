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
    joint, dof = model.body_jntadr[carriers], model.body_dofadr[carriers]
    three = np.arange(3)
    axes, along = data.xaxis[joint[:, None] + three], generalized[np.where(joint >= 0, dof, 0)[:, None] + three]
    subtree = np.where(joint[:, None] >= 0, np.einsum("ba,bac->bc", along, axes), np.nan)
    forces = np.zeros((frame.max() + 1, 3))
    np.add.at(forces, frame[first], subtree)
    above = np.searchsorted(carriers, model.body_parentid[carriers]).clip(max=len(carriers) - 1)
    hangs = carriers[above] == model.body_parentid[carriers]
    np.subtract.at(forces, frame[first[above[hangs]]], subtree[hangs])
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
    some, own = _contacts_of(model, data, geoms)
    found = np.zeros((len(geoms), 3))
    if not len(some):
        return found
    contacts = data.contact
    pyramid, first, count = _rows_of(model, data, some)
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
    second = own[:, 1] >= 0
    np.add.at(found, own[np.arange(len(some)), second.astype(int)], np.where(second[:, None], in_world, -in_world))
    return found


def rows_of(model: mujoco.MjModel, data: mujoco.MjData, geoms: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the constraint rows of the contacts of some geoms with others."""
    _, first, count = _rows_of(model, data, _contacts_of(model, data, geoms)[0])
    return _all_of(first, count)


def _contacts_of(
    model: mujoco.MjModel, data: mujoco.MjData, geoms: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The contacts (c,) of some geoms with others, and the place of each side's geom among those (c, 2), or −1."""
    number = np.full(model.ngeom + 1, -1)  # the last one is of flexes
    number[geoms] = np.arange(len(geoms))
    own = number[data.contact.geom]
    some = np.flatnonzero(((own[:, 0] < 0) != (own[:, 1] < 0)) & (data.contact.efc_address >= 0))
    return some, own[some]


def _rows_of(
    model: mujoco.MjModel, data: mujoco.MjData, some: NDArray[np.int64]
) -> tuple[NDArray[np.bool_], NDArray[np.int64], NDArray[np.int64]]:
    """Of some contacts (c,): whether each has a pyramid, its first row, and how many it has."""
    dim = data.contact.dim[some]
    pyramid = (model.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL) & (dim > 1)
    return pyramid, data.contact.efc_address[some], np.where(pyramid, 2 * dim - 2, dim)


def _all_of(first: NDArray[np.integer], count: NDArray[np.integer]) -> NDArray[np.int64]:
    """The numbers of runs, one run after the other, of which each begins at `first` and has `count`."""
    return np.repeat(first - np.cumsum(count) + count, count) + np.arange(count.sum())


def constraint_force(model: mujoco.MjModel, data: mujoco.MjData, rows: NDArray[np.int64]) -> Array:
    """Return Σ_i J_iᵀ f_i (nv,) over some constraint rows."""
    force = data.efc_force[rows]
    if not mujoco.mj_isSparse(model):
        return force @ data.efc_J.reshape(data.nefc, model.nv)[rows]
    first, count = data.efc_J_rowadr[rows], data.efc_J_rownnz[rows]
    entries = _all_of(first, count)
    total = np.zeros(model.nv)
    np.add.at(total, data.efc_J_colind[entries], np.repeat(force, count) * data.efc_J[entries])
    return total
