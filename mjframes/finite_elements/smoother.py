"""Chebyshev polynomials of the fourth kind in D⁻¹A, D the diagonal of A: smoothing by products alone.

They need but an upper bound λ of the eigenvalues (Lottes 2023, *Optimal polynomial smoothers for multigrid V-cycles*):

    d_1 = 4/(3λ) D⁻¹r,   d_i = (2i − 3)/(2i + 1) d_{i−1} + (8i − 4)/((2i + 1)λ) D⁻¹r,   x ← x + d_i,   r ← r − A d_i
"""

from __future__ import annotations

import numpy as np

from mjframes.finite_elements import kernels
from mjframes.finite_elements.matrices import Floats, Matrix

BULK = 2.0  # [-] many eigenvalues are larger, in any body
FILTER = 8  # [-] degree of the polynomial that brings out the largest
MARGIN = 1.05  # [-] on the largest that is found; smoothing would bear 16 % less


def polynomial(bound: float, degree: int, dtype: type[np.floating]) -> list[tuple[np.floating, np.floating]]:
    """Return what each step keeps of the last d, and its gain; the first keeps nothing."""
    kept = [0.0, *((2 * i - 3) / (2 * i + 1) for i in range(2, degree + 1))]
    gains = [(8 * i - 4) / ((2 * i + 1) * bound) for i in range(1, degree + 1)]
    return [(dtype(keep), dtype(gain)) for keep, gain in zip(kept, gains, strict=True)]


def eigenvalue_bound(matrix: Matrix, inverse: Floats, k: int) -> float:
    """Return a bound of the eigenvalues of D⁻¹A. inverse: (N, 3) of D, 0 at held nodes.

    Chebyshev polynomials of the first kind stay within ±1 up to BULK and grow fast beyond, the fastest for the largest
    eigenvalue, however few nodes it lives on. They are applied to noise in k columns; each gives a Rayleigh quotient.
    """
    lanes, scratch, dtype = (0,) * k, matrix.scratch(k), inverse.dtype.type
    whole = (0, len(inverse), lanes)
    noise = np.random.default_rng(0).standard_normal((inverse.size, k), np.float32)
    held = inverse.reshape(-1, 1) == 0
    r = np.where(held, 0, noise / np.sqrt(np.where(held, 1, inverse.reshape(-1, 1)))).astype(dtype).ravel()
    d, x = np.zeros_like(r), np.zeros_like(r)
    kernels.step(d, r, x, inverse, dtype(0), dtype(2 / BULK), *whole)
    for _ in range(FILTER):
        matrix.smooth(d, r, x, inverse, dtype(1), dtype(4 / BULK), scratch, lanes)
    kernels.step(d, r, x, inverse, dtype(0), dtype(1), *whole)
    x[:] = 0
    matrix.subtract(d, x, scratch, lanes)
    above, below = np.zeros(k), np.zeros(k)
    kernels.products(d, x, above, lanes)
    kernels.products(d, r, below, lanes)
    return MARGIN * float(np.max(-above / below))
