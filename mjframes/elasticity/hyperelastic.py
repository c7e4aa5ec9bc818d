"""A region of a hyperelastic law, written as its equations (the paper, §5.2): energies summed over quadrature points.

    F_q = Σ_j x_j ∇W_j(q)ᵀ
    W   = Σ_q V_q ψ(F_q)                  energy [J]
    f_j = −Σ_q V_q P(F_q) ∇W_j(q)         force [N], the exact −∂W/∂x
    K_jk = Σ_q V_q ∇W_jᵀ (∂P/∂F) ∇W_k     with ∂P/∂F projected, positive semi-definite
    Pᵀ K P,  P = I − Z (Zᵀ Z)⁺ Zᵀ         stiffness of a step [N/m]: blind to rotations of the current shape too,
                                          (Z a)_j = a × (x_j − x̄); K where F is large or inverted

The plugin computes the same inside `mj_step`; this is what views read and what the plugin is tested against.
Index letters: j, k control point; q quadrature point; r, s rows of F; a, b its columns.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mjframes.elasticity.corotational import cross_stack
from mjframes.elasticity.laws import LawParameters, energy, projected_hessian, stress

Array = NDArray[np.float64]

CALM = 1.5  # [-] |F| / √3 below which the stiffness of a step is blind to turns, as in plugin/constants.h
IN_LINE = 1e-6  # [-] singular value of Z, to the largest, below which points lie on a line


@dataclass(frozen=True, eq=False)
class HyperelasticRegion:
    """A region with a hyperelastic law at its quadrature points.

    points: (m,) its control points.
    gradient: ∇W_j (q, m, 3) [1/m].
    volume: (q,) [m³].
    material: (q,) places in `laws`, the law's constants for each material.
    """

    points: NDArray[np.int64]
    gradient: Array
    volume: Array
    material: NDArray[np.int64]
    laws: tuple[LawParameters, ...]

    def energy(self, x: Array) -> float:
        """Return the energy [J] with the region's control points at x (m, 3) [m]."""
        F = self._deformation(x)
        return float(sum(self.volume[q] @ energy(law, F[q]) for law, q in self._cells()))

    def response(self, x: Array) -> tuple[Array, Array]:
        """Return elastic force (m, 3) [N] and the stiffness of a step (3m, 3m) [N/m]."""
        F, m = self._deformation(x), len(self.points)
        force, stiffness = np.zeros((m, 3)), np.zeros((3 * m, 3 * m))
        for law, q in self._cells():
            slope, V = self.gradient[q], self.volume[q]
            force -= np.einsum("q,qra,qja->jr", V, stress(law, F[q]), slope)
            tangent = projected_hessian(law, F[q]).reshape(-1, 3, 3, 3, 3)
            stiffness += np.einsum("q,qja,qrasb,qkb->jrks", V, slope, tangent, slope, optimize=True).reshape(3 * m, -1)
        if (np.linalg.norm(F, axis=(1, 2)) >= CALM * 3**0.5).any() or (np.linalg.det(F) <= 0).any():
            return force, stiffness
        turns = cross_stack(x - x.mean(axis=0))
        projection = np.eye(3 * m) - turns @ np.linalg.pinv(turns, rcond=IN_LINE)
        return force, projection @ stiffness @ projection

    def _deformation(self, x: Array) -> Array:
        return np.einsum("jr,qja->qra", x, self.gradient)

    def _cells(self) -> Iterator[tuple[LawParameters, NDArray[np.int64]]]:
        for number in np.unique(self.material):
            yield self.laws[number], np.flatnonzero(self.material == number)
