"""Stiffness of a region whose material relaxes within it: K_e = (Φ + Ψ)ᵀ K (Φ + Ψ).

The skinned field Φ x cannot show what a cross section does by itself, Poisson's strains of bending first of all; alone
it makes bars up to three times too stiff. So each region's material may leave it by a displacement v = Ψ x of its own,

    min over v of ½ ∫ ε(Φ x + v) : C ε(Φ x + v) dV   subject to, for each component of v,
    ∫ E v = 0,  ∫ w_i v = 0                no drift; the frames keep their meaning
    ∫ λ ∂v/∂x_a = ∫ μ ∂v/∂x_a = 0          uniform strain is untouched: the patch test
    ∫ E β ∇w_i · ∇v = 0, β ∈ {1, x, y, z}  frames, not v, carry stretch, bending and twist between them
    ∫ μ ∇(Φ z) · ∇v = 0                    for control weights Φ z that none of these sees

It costs nothing at run time, as v is condensed out here. v is a sum of monomials up to degree 4 and, on demand, of
trilinear functions on cells of q³ voxels (`voxel_fem`). All products of Φ run over the same points, so K_e is positive
semi-definite and never stiffer than Φᵀ K Φ.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from mjframes.voxel_fem import VALUES, CellGrid, add_moments, at_nodes, cell_stiffness, condense, rigid_motions

Array = NDArray[np.float64]

DEGREE = 4  # of the monomials: 2 frees Poisson's strains, 4 also warps cross sections in torsion
DEPENDENT = 1e-9  # [-] singular value, to the largest, below which a constraint follows from the others
TINY = 1e-13  # [-] added to the scaled diagonal, for monomials that vanish at all points, as z² may in a plate
EQUILIBRATE = 4  # passes that scale rows and columns to one: moduli, lengths and multipliers differ by many powers

_POWERS = np.array(sorted((e for e in product(range(DEGREE + 1), repeat=3) if sum(e) <= DEGREE), key=sum))
_LOWER = int(np.sum(_POWERS.sum(axis=1) < DEGREE))  # so many monomials make up all derivatives
_NOT_TRILINEAR = _POWERS.max(axis=1) > 1  # the others are functions on the cells already


def _derivatives() -> Array:
    """(p, 3, _LOWER) coefficients of the derivatives of the monomials."""
    place = {tuple(e): t for t, e in enumerate(_POWERS[:_LOWER].tolist())}
    table = np.zeros((len(_POWERS), 3, _LOWER))
    for t, e in enumerate(_POWERS):
        for a in np.flatnonzero(e):
            table[t, a, place[tuple((e - np.eye(3, dtype=int)[a]).tolist())]] = e[a]
    return table


_DERIVATIVES = _derivatives()


@dataclass(frozen=True, eq=False)
class Sums:
    """Products over points of one material, per unit of its moduli, then over a region, with them.

    The columns G are the components of the m control weights' gradients, then the monomials of degree < DEGREE; the
    functions u the control weights, then all monomials.
    by_lam, by_mu: (G, G).  young, lam, mu: (G,) means.  drift: (u,) Σ E u.  values: (f, u) Σ w_i u.
    stretch: (4f, m) Σ E β ∇w_i · ∇W_j, stretch_by: (4f, 3, lower) Σ E β ∂w_i/∂x_a · monomial, β fastest.
    nodal: (c, 8, …) moments on cells of the fields that `_nodal` splits again, or empty.
    """

    by_lam: Array
    by_mu: Array
    young: Array
    lam: Array
    mu: Array
    drift: Array
    values: Array
    stretch: Array
    stretch_by: Array
    nodal: Array
