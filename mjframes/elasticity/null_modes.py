"""Control points that can move without moving any material, and a stiffness that holds them.

Hat weights reproduce coordinates, Σ_i (x − x_i) w_i = 0: affine frames can then strain and shift along the bar with
no trace in the material. Such z, with Σ_j W_j z_j = 0, make K singular beyond the rigid motions: static solves fail,
and these modes drift. For each, κ q qᵀ is added to *one* region, so that no further frames are coupled. As every state
can be shifted along z at no cost until qᵀx = 0, it changes no equilibrium; q is orthogonal to linear fields, so that
qᵀx = 0 at rest, in rigid motion and in uniform strain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mjframes.base.linear import scaled_eigenvectors
from mjframes.elasticity.stiffness import Stiffness
from mjframes.kinematics.control import ControlPoints

NULL = 1e-9  # [-] eigenvalue, to the largest of the scaled matrix, that counts as zero; rounding leaves about 1e-14


def null_modes(stiffness: Stiffness, control: ControlPoints, rigid: Sequence[int] = ()) -> NDArray[np.float64]:
    """Return vectors (z, k), a number a control point, that strain no region in any direction; not the constant one.

    rigid: frames that cannot be strained: their points move alike.
    """
    k = len(control.frame)
    alike = np.where(np.isin(control.frame, rigid), k + control.frame, np.arange(k))
    merge = (alike[:, None] == np.unique(alike)).astype(float)
    total = np.zeros((k, k))
    for points, matrix in zip(stiffness.points, stiffness.matrix, strict=True):
        total[np.ix_(points, points)] += sum(matrix[a::3, a::3] for a in range(3))
    total = merge.T @ total @ merge
    value, vector = scaled_eigenvectors(total)
    found = merge @ vector[:, value < NULL * value[-1]]
    basis, size, _ = np.linalg.svd(found - found.mean(axis=0), full_matrices=False)  # one direction less
    # Without a null mode what remains of the constant is rounding alone: measured against what was found, not itself.
    return basis[:, size > NULL**0.5 * np.linalg.norm(found)].T


def hold_null_modes(stiffness: Stiffness, control: ControlPoints, rigid: Sequence[int] = ()) -> Stiffness:
    """Return the same with a stiffness of the size of K_e's mean diagonal against each null mode."""
    modes = null_modes(stiffness, control, rigid)
    matrices = list(stiffness.matrix)
    for i in range(len(modes)):
        parts = [_across_linear(modes[i, points], control.rest[points]) for points in stiffness.points]
        e = int(np.argmax([part @ part for part in parts]))
        q, points = parts[e] / np.linalg.norm(parts[e]), stiffness.points[e]
        matrices[e] = matrices[e] + np.mean(np.diagonal(stiffness.matrix[e])) * np.kron(np.outer(q, q), np.eye(3))
        seen = modes[:, points] @ q  # the later modes shall not move this one's q
        modes[i + 1 :] -= np.outer(seen[i + 1 :] / seen[i], modes[i])
    return replace(stiffness, matrix=tuple(matrices))


def _across_linear(z: NDArray[np.float64], rest: NDArray[np.float64]) -> NDArray[np.float64]:
    """The part of z (m,) that is orthogonal to 1, x, y and z of the points (m, 3)."""
    offset = rest - rest.mean(axis=0)
    ones = np.full((len(z), 1), np.abs(offset).max())
    linear, size, _ = np.linalg.svd(np.hstack([ones, offset]), full_matrices=False)
    linear = linear[:, size > NULL * size[0]]
    return z - linear @ (linear.T @ z)
