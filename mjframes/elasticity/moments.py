"""Points and weights that integrate polynomials exactly over a set of voxels (the paper, §5.3).

Σ_q V_q p(y_q) = ∫ p dV for all polynomials p of degree ≤ n: the weights V_q > 0 and the points y_q match the volume's
moments ∫ y_1^a y_2^b y_3^c dV, a + b + c ≤ n, with the voxels' own extent in them. Degree 1 takes the centroid; degree
2 the tetrahedron c + L t_k, L Lᵀ the second central moment, as the control points do. For more, a rule for cubes or
balls is bent until it fits, by Gauss and Newton's iteration with the shortest step: there are more unknowns (4 a point)
than moments. Where no such rule fits, the start is Tchakaloff's: no more points than moments, out of many inside.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from itertools import product
from math import comb

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.optimize import nnls

from mjframes.kinematics.control import TETRAHEDRON
from mjframes.kinematics.monomials import exponents, monomials

Array = NDArray[np.float64]

STEPS = 60  # of Gauss and Newton; 5 to 20 are usual
SAMPLE = 2500  # points that Tchakaloff's are taken from
LONGEST_STEP = 0.3  # [standard deviations]
MATCHED = 1e-13  # [-] of the largest moment: residual of a rule that fits
LEAST_WEIGHT = 1e-5  # [-] of the volume, of a point that is worth its cost

_AXES = np.eye(3, dtype=np.int64)


def mean_monomials(
    index: NDArray[np.int32], voxels: NDArray[np.int32], center: Array, scale: Array, degree: int
) -> Array:
    """Return the means (p,) over the voxels, with their extent, of the monomials of y = (index − center) / scale."""
    # the mean of (x + u)ⁿ over |u| ≤ h/2 is Σ_k C(n, 2k) (h/2)^2k / (2k + 1) x^(n − 2k)
    own = np.zeros((3, degree + 1, degree + 1))
    for n, k in product(range(degree + 1), repeat=2):
        if 2 * k <= n:
            own[:, n, n - 2 * k] = comb(n, 2 * k) * (0.5 / scale) ** (2 * k) / (2 * k + 1)
    return _sum_monomials(index, voxels, center, scale, exponents(degree), own) / len(voxels)


def inside(index: NDArray[np.int32], voxels: NDArray[np.int32], center: Array, scale: Array) -> Array:
    """Return y (s, 3) of Gauss's points in voxels spread over all of them: 5³ in each where few, 2³ where many."""
    some = voxels[np.unique(np.linspace(0, len(voxels) - 1, SAMPLE // 8).astype(int))]
    side = int(np.clip((SAMPLE / len(some)) ** (1 / 3) + 1e-9, 2, 5))
    offset = 0.5 * np.array(list(product(np.polynomial.legendre.leggauss(side)[0], repeat=3)))
    return ((index[some][:, None] + offset - center) / scale).reshape(-1, 3)


def rule(mean: Array, degree: int, candidates: Callable[[], Array]) -> tuple[Array, Array] | None:
    """Return points y (q, 3) and weights (q,), of sum 1, that match the means (p,) of the monomials up to `degree`.

    The means of first order must be 0.  candidates: (s, 3) points inside, asked for where no known rule bends to fit.
    None where they do not lead to a rule either.
    """
    if degree <= 1:
        return np.zeros((1, 3)), np.ones(1)
    spread = np.zeros((3, 3))
    for e, value in zip(exponents(2), mean, strict=False):
        if e.sum() == 2:
            i, j = np.repeat([0, 1, 2], e)
            spread[i, j] = spread[j, i] = value
    lower = np.linalg.cholesky(spread)
    if degree == 2:
        return 2 * TETRAHEDRON[:, 1:] @ lower.T, np.full(4, 0.25)
    for points, weights in _starts(degree):
        if (found := _bend(points @ lower.T, weights, mean, degree)) is not None:
            return found
    points = candidates()
    weights, _ = nnls(monomials(points, exponents(degree)), mean)
    some = weights > LEAST_WEIGHT
    return _bend(points[some], weights[some], mean, degree)


@cache
def _starts(degree: int) -> tuple[tuple[Array, Array], ...]:
    """Points of unit variance with weights, few first: icosahedron; octahedron and cube; Gauss's rules for a cube."""
    golden = (1 + 5**0.5) / 2
    edges = [p for s, t in product((1, -1), (golden, -golden)) for p in ((0, s, t), (s, t, 0), (t, 0, s))]
    icosahedron = np.array(edges) * (3 / (1 + golden**2)) ** 0.5
    cube = np.array(list(product((-1, 1), repeat=3)), np.float64)
    octahedron = 3**0.5 * np.concatenate([np.eye(3), -np.eye(3)])
    even = (icosahedron, np.concatenate([octahedron, cube])) if degree <= 4 else ()
    gauss = (np.polynomial.legendre.leggauss(n) for n in ((3, 4) if degree <= 4 else (4, 5)))
    return (
        *((points, np.full(len(points), 1 / len(points))) for points in even),
        *(
            (3**0.5 * np.array(list(product(x, repeat=3))), np.array(list(product(w / 2, repeat=3))).prod(axis=1))
            for x, w in gauss
        ),
    )


def _bend(y: Array, weights: Array, mean: Array, degree: int) -> tuple[Array, Array] | None:
    """The rule near points y (q, 3) and weights (q,) that matches the means, if there is one of positive weights."""
    powers = exponents(degree)
    n, size = len(y), np.abs(mean).max()
    root = np.sqrt(weights)  # so that weights stay positive
    for _ in range(STEPS):
        values = monomials(y, powers)
        residual = values @ root**2 - mean
        if np.abs(residual).max() <= 1e-15 * size:
            break
        slopes = [powers[:, [a]] * monomials(y, np.maximum(powers - _AXES[a], 0)) for a in range(3)]
        jacobian = np.concatenate([*(slope * root**2 for slope in slopes), 2 * values * root], axis=1)
        row = 1 / np.sqrt((jacobian**2).sum(axis=1))
        jacobian *= row[:, None]
        gram = jacobian @ jacobian.T
        gram[np.diag_indices_from(gram)] += 1e-12 * np.trace(gram) / len(gram)
        step = -jacobian.T @ np.linalg.solve(gram, row * residual)
        step *= min(1.0, LONGEST_STEP / np.abs(step).max())
        y = y + step[: 3 * n].reshape(3, n).T
        root = root + step[3 * n :]
    fits = np.abs(monomials(y, powers) @ root**2 - mean).max() <= MATCHED * size
    return (y, root**2) if fits and (root**2).min() >= LEAST_WEIGHT else None


@njit(cache=True, nogil=True)
def _sum_monomials(
    index: NDArray[np.int32],
    voxels: NDArray[np.int32],
    center: Array,
    scale: Array,
    powers: NDArray[np.int64],
    own: Array,
) -> Array:
    """Return (p,) sums of the means over each voxel; own: (3, n + 1, n + 1) coefficients of those of xⁿ."""
    degree = own.shape[1] - 1
    total, x, mean = np.zeros(len(powers)), np.empty(degree + 1), np.empty((3, degree + 1))
    for v in voxels:
        for a in range(3):
            x[0] = 1.0
            for n in range(1, degree + 1):
                x[n] = x[n - 1] * (index[v, a] - center[a]) / scale[a]
            for n in range(degree + 1):
                mean[a, n] = 0.0
                for k in range(n, -1, -2):
                    mean[a, n] += own[a, n, k] * x[k]
        for e in range(len(powers)):
            total[e] += mean[0, powers[e, 0]] * mean[1, powers[e, 1]] * mean[2, powers[e, 2]]
    return total
