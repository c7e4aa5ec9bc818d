"""Voxels replaced by fewer points with the same moments: Σ_v f(p_v) = Σ_s q_s f(p_s), polynomials f up to DEGREE.

With weights that are linear in a region all that its stiffness sums over the voxels is such a polynomial (the paper,
§5.3, integrates by moments as well), and 84 points do for any number of voxels. They are the lower set i + j + k ≤ 6 of
a 7 × 7 × 7 grid of Chebyshev's nodes in the box around the voxels; values there determine a polynomial of degree 6.
From the moments m_α = Σ_v T_α(p_v) of Chebyshev's polynomials follow the q_s by Σ_s q_s T_α(p_s) = m_α; some are
negative.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

DEGREE = 6  # twice that of the monomials' derivatives, see `condensation`

_SET = np.array([a for a in product(range(DEGREE + 1), repeat=3) if sum(a) <= DEGREE])
_NESTED = np.array([0, 6, 3, 2, 5, 1, 4])  # in this order rounding grows by 50 at most, in that of the nodes by 4e6
_NODES = np.cos(np.pi * (2 * _NESTED + 1) / (2 * DEGREE + 2))[_SET]  # (84, 3)
_VALUES = np.cos(_SET[:, None] * np.arccos(_NODES)).prod(axis=2)  # (84, 84) T_α at the nodes
_WEIGHTS = np.linalg.inv(_VALUES)  # of the nodes, by the moments
POINTS = len(_NODES)


def cubature(index: NDArray[np.integer], offsets: Array) -> tuple[Array, Array]:
    """Points (84, 3) in index coordinates, voxel centres at the integers, and their weights q (84,) [voxels].

    index: (n, 3) voxels, each with points at offsets (o, 3) from its centre [voxels], which share its weight.
    """
    low, high = index.min(axis=0) - 0.5, index.max(axis=0) + 0.5
    middle, half = (low + high) / 2, (high - low) / 2
    moments = np.zeros(POINTS)
    _add_moments(index, offsets, middle, half, moments)
    return middle + half * _NODES, _WEIGHTS @ moments / len(offsets)


@njit(cache=True, nogil=True)
def _add_moments(index, offsets, middle, half, moments):
    t = np.empty((3, DEGREE + 1))
    for v in range(len(index)):
        for o in range(len(offsets)):
            for axis in range(3):
                x = (index[v, axis] + offsets[o, axis] - middle[axis]) / half[axis]
                t[axis, 0], t[axis, 1] = 1.0, x
                for n in range(2, DEGREE + 1):
                    t[axis, n] = 2 * x * t[axis, n - 1] - t[axis, n - 2]
            at = 0
            for i in range(DEGREE + 1):
                for j in range(DEGREE + 1 - i):
                    both = t[0, i] * t[1, j]
                    for k in range(DEGREE + 1 - i - j):
                        moments[at] += both * t[2, k]
                        at += 1
