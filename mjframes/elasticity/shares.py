"""What each material has of a region's stiffness, and the region's stiffness with other moduli.

With factors s_m of the materials' moduli E_m a region's K is homogeneous of degree one in s, so that its derivatives
K_m = ∂K/∂s_m at s = 1 sum up to K (Euler). Of a region that is what one frame adds to its parents (whole_body/
selection.py) only the rows R = [Y, C] of the frame's own points are kept, which are all of it but for a rest Q:

    R(s) = s_M R + Σ_{m<M} (s_m − s_M) R_m
    K(s) = R(s)ᵀ C(s)⁻¹ R(s) + s̄ Q,   Q = K − Rᵀ C⁻¹ R,   s̄ = tr C(s) / tr C

That is right to first order but for Q, and positive semi-definite for all s > 0, as C(s) and Q are. Q is what the
energy of a pair of frames (whole_body/selection.py) has for the parent alone, and what holds null modes. A region that
is a sum over voxels has all its points as its own, and K(s) = R(s) exactly.
Index letters: m material, M the last; o a region's own control points, the last ones. The plugin computes the same
(plugin/shares.cc).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mjframes.volume.material import Material

Array = NDArray[np.float64]

TINY = np.finfo(float).tiny
SINGULAR = 1e-12  # [-] pivot of C, to its largest diagonal, of what has no stiffness


def factor_of(table: Sequence[Material]) -> NDArray[np.int64]:
    """Return (t,) which factor each material of a grid's table follows: the deformable ones their own, in their order,
    the rigid ones that of the stiffest of these, to which their stiffness is put.
    """
    deforms = np.array([not material.is_rigid for material in table])
    if not deforms.any():
        return np.zeros(len(table), np.int64)
    number = np.cumsum(deforms) - 1
    stiffest = np.argmax([material.young if deforms[t] else 0.0 for t, material in enumerate(table)])
    return np.where(deforms, number, number[stiffest])


def groups(table: Sequence[Material]) -> list[NDArray[np.bool_]]:
    """Return for each factor but the last which (t,) materials follow it."""
    factor = factor_of(table)
    return [factor == m for m in range(factor.max())]


def scaled(matrix: Array, shares: Array, factors: Array) -> Array:
    """Return K(s) (3m, 3m) [N/m] of a region from K, its shares (M − 1, 3o, 3m) and factors (M,) [-]."""
    own, last = shares.shape[1], factors[-1]
    n = len(matrix) - own
    rows = last * matrix[n:] + np.tensordot(factors[:-1] - last, shares, 1)
    found = np.empty_like(matrix)
    found[n:], found[:n, n:] = rows, rows[:, :n].T
    mean = np.trace(rows[:, n:]) / max(np.trace(matrix[n:, n:]), TINY)
    found[:n, :n] = mean * (matrix[:n, :n] - _carried(matrix[n:])) + _carried(rows)
    return found


def by_material(matrix: Array, shares: Array) -> Array:
    """Return K_m (M, 3m, 3m) [N/m] of all materials; their sum is K."""
    own = shares.shape[1]
    n = len(matrix) - own
    rows = np.concatenate([shares, [matrix[n:] - shares.sum(axis=0)]])
    follow = np.linalg.pinv(matrix[n:, n:], rcond=SINGULAR, hermitian=True) @ matrix[n:, :n]
    found = np.zeros((len(rows), *matrix.shape))
    found[:, n:], found[:, :n, n:] = rows, rows[:, :, :n].transpose(0, 2, 1)
    crossed = rows[:, :, :n].transpose(0, 2, 1) @ follow
    found[:, :n, :n] = crossed + crossed.transpose(0, 2, 1) - follow.T @ rows[:, :, n:] @ follow
    part = np.trace(rows[:, :, n:], axis1=1, axis2=2)
    rest = matrix[:n, :n] - found[:, :n, :n].sum(axis=0)
    found[:, :n, :n] += (part / max(part.sum(), TINY))[:, None, None] * rest
    return found


def _carried(rows: Array) -> Array:
    """Yᵀ C⁻¹ Y of rows [Y, C]; what has no stiffness carries nothing."""
    n = rows.shape[1] - len(rows)
    value, vector = np.linalg.eigh(rows[:, n:])
    kept = value > SINGULAR * value[-1]
    reach = (vector[:, kept] / np.sqrt(value[kept])).T @ rows[:, :n]
    return reach.T @ reach
