"""Bricks of order 1 with Wilson's incompatible modes: finite elements on the voxels themselves that do not lock.

    u = Σ_a N_a u_a + Σ_d (1 − ξ_d²) α_d,  ξ ∈ [−1, 1]³;  K = K_uu − K_uα K_αα⁻¹ K_αu

They tell what of an error is the frames' and what is the mesh's: with split 1 they have the nodes that `build` has,
written down apart from it and solved by another way.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from benchmarks.solids.bricks import Bricks, assembled

Array = NDArray[np.float64]


def incompatible_stiffness(mesh: Bricks) -> sparse.csr_array:
    """Return (3N, 3N) for bricks of order 1, with natural boundaries."""
    gradient, volume = mesh.rule
    point = (np.polynomial.legendre.leggauss(2)[0] + 1) / 2
    at = 2 * np.stack(np.meshgrid(point, point, point, indexing="ij"), axis=-1).reshape(-1, 3) - 1
    bubble = np.einsum("qd,de->qde", -4 * at / mesh.size, np.eye(3))  # ∂(1 − ξ_d²)/∂x_e
    gradient = np.concatenate([gradient, bubble], axis=1)
    pairs = np.einsum("q,qak,qbl->akbl", volume, gradient, gradient)
    m = 3 * gradient.shape[1]
    by_lam = pairs.reshape(m, m)
    by_mu = (pairs.transpose(0, 3, 2, 1) + np.einsum("akbk,ij->aibj", pairs, np.eye(3))).reshape(m, m)
    kinds, kind = np.unique(np.column_stack([mesh.lam, mesh.mu]), axis=0, return_inverse=True)
    whole = kinds[:, :1, None] * by_lam + kinds[:, 1:, None] * by_mu
    nodes, inner = slice(0, 24), slice(24, m)
    condensed = whole[:, nodes, nodes] - whole[:, nodes, inner] @ np.linalg.solve(
        whole[:, inner, inner], whole[:, inner, nodes]
    )
    return assembled(mesh, mesh.element, condensed.reshape(len(kinds), -1)[kind.ravel()])


def consistent_mass(mesh: Bricks, density: Array) -> sparse.csr_array:
    """Return (3N, 3N) [kg] of voxels' densities (n,) [kg/m³]."""
    line = np.array([[2, 1], [1, 2]]) / 6
    share = np.kron(np.kron(np.kron(line, line), line), np.eye(3))
    return assembled(mesh, mesh.element, (density[mesh.voxel] * np.prod(mesh.size))[:, None] * share.ravel())
