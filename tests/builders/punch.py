"""A frictionless square punch on a slab that is glued at its base, in quadratic finite elements of a quarter of it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse.linalg import LinearOperator, cg


def punch_stiffness(width: float, thick: float, half: float, young: float, poisson: float, spacing: float) -> float:
    """[N/m] of the whole slab.  half: the punch's width.  spacing: of the elements; it divides all lengths."""
    skfem = pytest.importorskip("skfem")
    elasticity = pytest.importorskip("skfem.models.elasticity")
    sides = [np.linspace(0, length, round(length / spacing) + 1) for length in (width / 2, width / 2, thick)]
    mesh = skfem.MeshHex.init_tensor(*sides)
    basis = skfem.Basis(mesh, skfem.ElementVector(skfem.ElementHex2()), intorder=4)
    matrix = elasticity.linear_elasticity(*elasticity.lame_parameters(young, poisson)).assemble(basis).tocsr()
    place, axis = basis.doflocs, np.empty(basis.N, int)
    for dofs in (basis.nodal_dofs, basis.edge_dofs, basis.facet_dofs, basis.interior_dofs):
        for a in range(3):
            axis[dofs[a::3]] = a
    near = spacing * 1e-6
    held = (place[2] < near) | ((place[0] < near) & (axis == 0)) | ((place[1] < near) & (axis == 1))
    below = (place[2] > thick - near) & (place[:2] < half + near).all(axis=0) & (axis == 2)
    free = np.flatnonzero(~(held | below))
    moved = -below.astype(float)
    reduced = matrix[free][:, free]
    scale = 1 / reduced.diagonal()
    inverse = LinearOperator(reduced.shape, lambda v: scale * v)  # pyright: ignore[reportCallIssue]
    moved[free], failed = cg(reduced, -(matrix @ moved)[free], rtol=1e-5, maxiter=5000, M=inverse)
    assert not failed
    return 4 * float(moved @ (matrix @ moved))
