"""The mass matrix of a scene without elasticity.

In a step the plugin adds h² K and more to `data.M` (plugin/README.md), and it stays there: what reads `data.M` or its
factors afterwards sees how hard the scene is to move within one step, not its mass.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import mujoco
import numpy as np

from mjframes.scene import view
from mjframes.scene.load import require_state


def mass_matrix(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Return the mass matrix M without the elasticity that a step adds to `data.M`.

    The kinetic energy is ½ q̇ᵀ M q̇. M contains the bodies and armatures that MuJoCo knows, and the mass of soft bodies
    between their points.

    Parameters
    ----------
    model, data
        The compiled model and its state, which stays as it is. M is that of the positions of the last `mj_forward`;
        after `mj_step`, of the positions before the step.

    Returns
    -------
    array
        M (nv, nv) [kg, and kg m² for rotations].

    Raises
    ------
    MjframesError
        If `data` is not of the model.
    """
    require_state(model, data)
    before = data.M.copy()
    mujoco.mj_makeM(model, data)
    inertia = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    data.M[:] = before
    for name in view.soft_names(model):
        body = view.soft(model, data, name)
        differences = body.mass_difference
        jacobian = _jacobian(model, data, body) if differences else np.zeros(0)
        for points, difference in differences:
            some = jacobian[points].reshape(len(points), -1)
            inertia += np.einsum("jra,jrb->ab", jacobian[points], (difference @ some).reshape(jacobian[points].shape))
    return inertia


@contextmanager
def rigid_inertia(model: mujoco.MjModel, data: mujoco.MjData) -> Iterator[None]:
    """Make `data.M` and its factors those of `mass_matrix`, in a `with` block.

    It is for code that calls `mj_fullM`, `mj_mulM`, `mj_solveM` or `mj_energyVel`, such as operational-space
    controllers. Afterwards both are again what the step works with. Do not step inside the block.

    Parameters
    ----------
    model, data
        The compiled model and its state.

    Raises
    ------
    MjframesError
        If `data` is not of the model.
    """
    require_state(model, data)
    before = data.M.copy(), data.qLD.copy(), data.qLDiagInv.copy()
    rows = np.repeat(np.arange(model.nv), model.M_rownnz)
    try:
        data.M[:] = mass_matrix(model, data)[rows, model.M_colind]
        mujoco.mj_factorM(model, data)
        yield
    finally:
        data.M[:], data.qLD[:], data.qLDiagInv[:] = before


def _jacobian(model: mujoco.MjModel, data: mujoco.MjData, body: view.Soft) -> np.ndarray:
    """(k, 3, nv) of the control points."""
    jacobian = np.zeros((len(body.bodies), 3, model.nv))
    for j, (carrier, x) in enumerate(zip(body.bodies, body.control_positions, strict=True)):
        mujoco.mj_jac(model, data, jacobian[j], None, x, int(carrier))
    return jacobian
