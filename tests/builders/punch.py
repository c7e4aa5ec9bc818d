"""What presses without friction on a slab glued at its base, in quadratic finite elements of a quarter of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.sparse.linalg import LinearOperator, cg

Array = NDArray[np.float64]


def punch_stiffness(width: float, thick: float, half: float, young: float, poisson: float, spacing: float) -> float:
    """[N/m] of the whole slab.  half: the punch's width.  spacing: of the elements; it divides all lengths."""
    sides = [np.linspace(0, length, round(length / spacing) + 1) for length in (width / 2, width / 2, thick)]
    near = spacing * 1e-6
    force = pressed_slab(sides, young, poisson, lambda x, y: np.where(np.maximum(x, y) < half + near, 1.0, -1.0))[1]
    return 4 * float(force.sum())


def pressed_slab(
    sides: Sequence[Array], young: float, poisson: float, depth: Callable[[Array, Array], Array]
) -> tuple[Array, Array]:
    """Return where nodes of a quarter touch (n, 2) [m], and the force on each (n,) [N].

    sides: of its elements, from the middle of the slab outwards, and from its base up [m].  depth: of the shape below
    the top at rest [m], at x and y; where it is negative nothing touches.
    """
    skfem = pytest.importorskip("skfem")
    elasticity = pytest.importorskip("skfem.models.elasticity")
    mesh = skfem.MeshHex.init_tensor(*sides)
    basis = skfem.Basis(mesh, skfem.ElementVector(skfem.ElementHex2()), intorder=4)
    matrix = elasticity.linear_elasticity(*elasticity.lame_parameters(young, poisson)).assemble(basis).tocsr()
    place, axis = basis.doflocs, np.empty(basis.N, int)
    for dofs in (basis.nodal_dofs, basis.edge_dofs, basis.facet_dofs, basis.interior_dofs):
        for a in range(3):
            axis[dofs[a::3]] = a
    near = 1e-9
    held = (place[2] < near) | ((place[0] < near) & (axis == 0)) | ((place[1] < near) & (axis == 1))
    below = depth(place[0], place[1])
    top = (place[2] > sides[2][-1] - near) & (axis == 2) & (below > 0)
    touches = top.copy()
    force = np.zeros(basis.N)
    for _ in range(20):
        free = np.flatnonzero(~(held | touches))
        moved = np.where(touches, -below, 0.0)
        reduced = matrix[free][:, free]
        scale = 1 / reduced.diagonal()
        inverse = LinearOperator(reduced.shape, lambda v, scale=scale: scale * v)  # pyright: ignore[reportCallIssue]
        moved[free], failed = cg(reduced, -(matrix @ moved)[free], rtol=1e-5, maxiter=5000, M=inverse)
        assert not failed
        force = -(matrix @ moved)
        wrong = (touches & (force < 0)) | (top & ~touches & (moved > 1e-6 * below.max() - below))
        if not wrong.any():
            break
        touches ^= wrong
    return place[:2, touches].T, force[touches]


def on_squares(place: Array, force: Array, width: float, count: int, edge: float = np.inf) -> Array:
    """Return the pressure (count, count) [Pa] on squares of a whole slab around its middle; a node between squares is
    of both.

    edge: of a punch [m]: nodes on it are of what is inside.
    """
    total = np.zeros((count, count))
    place = np.where(abs(place - edge) < 1e-6, place - 1e-6, place)
    for sign in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        for away in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
            square = np.floor((np.array(sign) * place + 1e-9 * np.array(away)) / width + count / 2).astype(int)
            np.add.at(total, tuple(square.T), force / 4)
    return total / width**2
