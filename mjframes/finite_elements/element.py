"""The brick of one voxel: eight nodes, trilinear, with Wilson's incompatible modes (Wilson, Taylor et al. 1973).

In ξ ∈ [−1, 1]³ the displacement is Σ_a N_a u_a + Σ_d (1 − ξ_d²) α_d; the nine α are eliminated. So a brick one voxel
thick bends without locking, and a uniform strain is still exact, as the modes' slopes have no mean over a brick.

Corner a = 4x + 2y + z of (x, y, z) ∈ {0, 1}³, degree of freedom 3a + d. In the Walsh–Hadamard basis of the corners,
mode s is odd along the axes in the bits of s: u_d(s) = Σ_a (−1)^|a ∧ s| u_d(a). An isotropic brick is symmetric under
reflection along each axis, so u_d(s) meets u_e(t) only where s ⊕ axis_d = t ⊕ axis_e: eight 3 × 3 blocks, one for each
parity, with 33 coefficients on and above their diagonals that are not zero. They are all that a product needs.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

CORNERS = np.array(list(product((0, 1), repeat=3)))  # (8, 3)

# The modes (d, s) that meet, in the order in which `kernels` takes the coefficients of their pairs.
COUPLED = (
    ((0, 4), (1, 2), (2, 1)),
    ((1, 6), (2, 5)),
    ((0, 6), (2, 3)),
    ((0, 5), (1, 3)),
    ((0, 2), (1, 4)),
    ((2, 7),),
    ((0, 1), (2, 4)),
    ((1, 7),),
    ((1, 1), (2, 2)),
    ((0, 7),),
    ((0, 3), (1, 5), (2, 6)),
)
_PAIRS = [(3 * s + d, 3 * t + e) for group in COUPLED for n, (d, s) in enumerate(group) for e, t in group[n:]]

_ALONG = np.array([[1.0, 1.0], [1.0, -1.0]])
_HADAMARD = np.kron(np.kron(np.kron(_ALONG, _ALONG), _ALONG), np.eye(3))  # its square is 8


def brick_stiffness(poisson: float, edges: ArrayLike) -> Array:
    """Return the (24, 24) stiffness for Young's modulus 1 of a brick with `edges` (3,); times E it is that of E."""
    edges = np.asarray(edges, np.float64)
    lam, mu = poisson / ((1 + poisson) * (1 - 2 * poisson)), 1 / (2 * (1 + poisson))
    law = np.diag([2 * mu] * 3 + [mu] * 3)  # stress of (ε_xx, ε_yy, ε_zz, 2ε_yz, 2ε_xz, 2ε_xy)
    law[:3, :3] += lam
    total = np.zeros((33, 33))
    for xi in product((-1 / np.sqrt(3), 1 / np.sqrt(3)), repeat=3):  # Gauss's points: exact
        strain = _strain_matrix(_slopes(np.array(xi)) * 2 / edges)
        total += strain.T @ law @ strain * np.prod(edges) / 8
    nodes, modes = slice(0, 24), slice(24, 33)
    stiffness = total[nodes, nodes] - total[nodes, modes] @ np.linalg.solve(total[modes, modes], total[modes, nodes])
    return (stiffness + stiffness.T) / 2


def coefficients(stiffness: Array) -> Array:
    """Return the (33,) coefficients of a brick's stiffness (24, 24): (H K H / 64) at the pairs of modes that meet."""
    rows, columns = np.array(_PAIRS).T
    return (_HADAMARD @ stiffness @ _HADAMARD / 64)[rows, columns]


def _slopes(xi: Array) -> Array:
    """∂/∂ξ (11, 3) of the eight N_a and of the three 1 − ξ_d² at ξ."""
    sign = 2 * CORNERS - 1
    factor = (1 + sign * xi) / 2
    slopes = np.empty((8, 3))
    for d in range(3):
        slopes[:, d] = sign[:, d] / 2 * np.prod(np.delete(factor, d, axis=1), axis=1)
    return np.vstack([slopes, np.diag(-2 * xi)])


def _strain_matrix(slopes: Array) -> Array:
    """(6, 3f) strains of f functions with slopes (f, 3) in each component."""
    x, y, z = slopes.T
    none = np.zeros_like(x)
    rows = [[x, none, none], [none, y, none], [none, none, z], [none, z, y], [z, none, x], [y, x, none]]
    return np.array(rows).transpose(0, 2, 1).reshape(6, -1)
