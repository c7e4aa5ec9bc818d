"""Positive semi-definite matrices whose degrees of freedom differ in kind and size: inverse and root of what is not 0.

    S A S = V λ Vᵀ,   S_ii = A_ii^(−1/2)      A⁺ = S V λ⁺ (S V)ᵀ,   R Rᵀ = A⁺ for R = S V λ^(−1/2)

Scaled to a diagonal of ones, what is soft is told from what is nothing, however much stiffer the rest is. Of bodies of
1 to 14 frames, with materials up to 5·10⁵ times as stiff as others, no eigenvalue is between 10⁻⁷ and 10⁻¹² of the
largest: what is below is rounding. The softest one falls with the fourth power of the number of frames in a row. Who
passes another tolerance than ZERO says what makes its matrix less exact.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

ZERO = 1e-11  # [-] eigenvalue of a scaled matrix, to the largest, that counts as 0; a hundred frames in a row: 4e-10
NOTHING = 1e-14  # [-] to the largest: a diagonal that is rounding, as of one point beside the line of others


def unit_diagonal(matrix: Array, nothing: float = NOTHING) -> Array:
    """Return the diagonal of S (n,), 0 where that of the matrix is at most `nothing` of its largest."""
    diagonal = np.diagonal(matrix)
    some = diagonal > nothing * diagonal.max(initial=0)
    return np.where(some, 1 / np.sqrt(np.where(some, diagonal, 1)), 0)


def scaled_eigenvectors(matrix: Array) -> tuple[Array, Array]:
    """Return λ (n,), ascending, and S V (n, n). What has no diagonal is scaled by the largest one."""
    scale = unit_diagonal(matrix)
    value, vector = np.linalg.eigh(matrix * scale * scale[:, None])
    largest = np.diagonal(matrix).max(initial=np.finfo(float).tiny)
    return np.asarray(value, np.float64), np.where(scale > 0, scale, 1 / np.sqrt(largest))[:, None] * vector


def nonzero_eigenvectors(matrix: Array, zero: float = ZERO) -> tuple[Array, Array]:
    """Return those (q,) and (n, q) of which λ is more than `zero` times the largest."""
    value, vector = scaled_eigenvectors(matrix)
    kept = value > zero * value.max(initial=0)
    return value[kept], vector[:, kept]


def pseudo_inverse(matrix: Array, zero: float = ZERO) -> Array:
    """Return A⁺ (n, n)."""
    value, vector = nonzero_eigenvectors(matrix, zero)
    return vector / value @ vector.T


def inverse_root(matrix: Array, zero: float = ZERO) -> Array:
    """Return R (n, q)."""
    value, vector = nonzero_eigenvectors(matrix, zero)
    return vector / np.sqrt(value)
