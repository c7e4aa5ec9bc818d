"""Preconditioned conjugate gradients for k columns at once, each with its own step lengths.

The squared error of a column in the energy norm is eᵀAe = rᵀA⁻¹r ≤ rᵀMr / θ, where θ is the smallest eigenvalue of MA.
Conjugate gradients find it on their way: it is approached by the smallest eigenvalue of Lanczos's matrix, made of the
step lengths α and turns β. So the stop needs no knowledge of the body; thin bodies, with a small θ, iterate for longer.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mjframes.base.errors import MjframesError
from mjframes.finite_elements import kernels
from mjframes.finite_elements.batch import LoadBatch
from mjframes.finite_elements.cycle import precondition
from mjframes.finite_elements.levels import Levels
from mjframes.finite_elements.matrices import Floats, Lanes

STALLED = 0.05  # [-] where rounding stops the residual, as in long strands; the Ritz value is then one of rounding too
MOST_STEPS = 400  # several times what any body has needed

Array = NDArray[np.float64]


def solve(levels: Levels, batch: LoadBatch, tolerance: float, energy: Callable[[Floats], Array] | None = None) -> int:
    """Solve A x = r for the solution x of a batch, and return the number of steps.

    batch: its residual r is the right-hand side, and in the end what is left of it; its direction is overwritten.
    tolerance: on the error of each column in the energy norm, to the norm of the result or to the square root of
    `energy` (k,) at x.
    Raise MjframesError where that takes too many steps.
    """
    lanes, q = batch.lanes, batch.d[0]
    r, x, p = batch.residual, batch.solution, batch.direction
    x[:] = 0
    batch.r[0][:] = r
    p[:] = precondition(levels, batch)
    gained, squares = np.zeros(len(lanes)), _products(r, p, lanes)
    lengths: list[Array] = []
    turns: list[Array] = []
    while len(lengths) < MOST_STEPS:
        q[:] = 0
        levels.finest.subtract(p, q, batch.scratch[0], lanes)
        alpha = _quotient(squares, -_products(p, q, lanes))
        gained += alpha * squares
        kernels.advance(alpha.astype(x.dtype), p, q, x, r, batch.r[0], lanes)
        z = precondition(levels, batch)
        before, squares = squares, _products(r, z, lanes)
        beta = _quotient(squares, before)
        lengths.append(alpha)
        turns.append(beta)
        allowed = tolerance**2 * (gained if energy is None else energy(x))
        if _below(squares, allowed) and _below(squares, allowed * _smallest_eigenvalue(lengths, turns)):
            return len(lengths)
        kernels.turn(beta.astype(x.dtype), z, p, lanes)
    error = np.sqrt(np.max(_quotient(np.abs(squares), gained)))
    if error < STALLED:
        return MOST_STEPS
    raise MjframesError(
        f"the elasticity of the body is not solved: {MOST_STEPS} steps leave an error of {100 * error:.2g} %; "
        "give it materials that are less different, or Poisson's ratios further below 0.5."
    )


def _products(a: Floats, b: Floats, lanes: Lanes) -> Array:
    total = np.zeros(len(lanes))
    kernels.products(a, b, total, lanes)
    return total


def _quotient(a: Array, b: Array) -> Array:
    """a / b, but 0 where b is not positive: in columns that are 0, or solved to the last digit."""
    return np.where(b > 0, a / np.where(b > 0, b, 1), 0)


def _below(squares: Array, allowed: Array) -> bool:
    return bool((np.abs(squares) <= allowed).all())


def _smallest_eigenvalue(lengths: list[Array], turns: list[Array]) -> float:
    """θ: the smallest Ritz value of MA in any column."""
    alpha, beta = np.array(lengths), np.abs(turns)
    used = (alpha > 0).all(axis=0)
    if not used.any():
        return 1.0
    alpha, beta = alpha[:, used], beta[:, used]
    i = np.arange(len(alpha))
    lanczos = np.zeros((alpha.shape[1], len(i), len(i)))
    lanczos[:, i, i] = (1 / alpha).T
    lanczos[:, i[1:], i[1:]] += (beta[:-1] / alpha[:-1]).T
    lanczos[:, i[1:], i[:-1]] = (np.sqrt(beta[:-1]) / alpha[:-1]).T  # the lower triangle is all that is read
    return float(np.linalg.eigvalsh(lanczos)[:, 0].min())
