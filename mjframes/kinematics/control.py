"""Equimomental control points: every frame as 1, 4 or 10 point masses (the paper, equations (3) and (8), row sums).

x(p̄) = Σ_j W_j(p̄) x_j with W_j = w_i φ_k, for a frame of order n with d = 4 (affine) or 10 (quadratic) points.
A rigid frame has those of an affine one, on one body. A point frame (n = 0, d = 1) only translates: with it the sum
does not reproduce p̄ at rest, and stands for the displacement, x(p̄) = p̄ + Σ_j W_j(p̄) (x_j − x̄_j), as in the paper.
Let ψ be the monomials of order n made orthonormal under dm/m, constant first, dm = ρ w_i dV, and Q orthogonal with a
constant first column. Then φ_k = Σ_l Q_kl ψ_l / √d satisfies

    Σ_k φ_k = 1,   ∫ φ_k φ_l dm = (m/d) δ_kl,   x̄_k = d ∫ φ_k p̄ dm / m,   Σ_k φ_k x̄_k = p̄

so d masses m/d carry the frame's row-sum lumped mass matrix exactly. For n = 1 the points are the vertices c + L t_k of
a tetrahedron around the centroid c, L Lᵀ the second central moment over m. The paper drops M_ij for i ≠ j, which loses
mass because Σ w_i² < 1; row sums keep mass, momentum and weight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import sparse

from mjframes.base.choices import FRAME_TYPES
from mjframes.base.errors import MjframesError
from mjframes.kinematics.frame_moments import EXPONENTS, FrameMoments, frame_moments
from mjframes.volume.grid import Grid
from mjframes.weights.weights import frame_count

# powers of (x, y, z) in each monomial: those of order ≤ 1 first, as in the paper's bases
POWERS = np.array(
    [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [2, 0, 0], [0, 2, 0], [0, 0, 2], [1, 1, 0], [0, 1, 1], [1, 0, 1]]
)
POINTS = {name: kind.points for name, kind in FRAME_TYPES.items()}

TETRAHEDRON = 0.5 * np.array([[1, 1, 1, 1], [1, 1, -1, -1], [1, -1, 1, -1], [1, -1, -1, 1]])  # Q for d = 4
_AXIS = np.eye(10)[0] - np.sqrt(0.1)
TEN_POINTS = np.eye(10) - 2 * np.outer(_AXIS, _AXIS) / (_AXIS @ _AXIS)  # Q for d = 10: a reflection of the first axis
MIXING = {1: np.eye(1), 4: TETRAHEDRON, 10: TEN_POINTS}


@dataclass(frozen=True, eq=False)
class ControlPoints:
    """k control points, those of a frame one after the other, in the order of the frames.

    frame: (k,) the frame of each.
    rest: (k, 3) x̄_j [m].
    mass: (k,) [kg].

    φ_j(p) = basis[j] · monomials of y = axesᵀ (p − center[j]) / scale[j], p in volume coordinates [m]:
    basis: (k, 10) in the order of POWERS.
    center: (k, 3) [m].
    scale: (k,) [m].
    axes: (3, 3).
    """

    frame: NDArray[np.int64]
    rest: NDArray[np.float64]
    mass: NDArray[np.float64]
    basis: NDArray[np.float64]
    center: NDArray[np.float64]
    scale: NDArray[np.float64]
    axes: NDArray[np.float64]


def frame_types(frame_type: str | Sequence[str], frames: int) -> tuple[str, ...]:
    """Return a type for each of `frames` frames. Raise MjframesError for unknown types and a wrong number of them."""
    types = (frame_type,) * frames if isinstance(frame_type, str) else tuple(frame_type)
    if unknown := [name for name in types if name not in POINTS]:
        raise MjframesError(f"frame_type has {unknown[0]!r}; the types are {', '.join(map(repr, POINTS))}.")
    if len(types) != frames:
        raise MjframesError(f"frame_type names {len(types)} types for {frames} frames; give one, or one a frame.")
    return types


def control_points(grid: Grid, weights: sparse.csr_array, types: Sequence[str] | None = None) -> ControlPoints:
    """Return the control points of the f frames of weights (n, f), all affine unless `types` (f,) says otherwise."""
    types = types or ("affine",) * frame_count(weights)
    sizes = [POINTS[name] for name in types]
    moments = frame_moments(grid, weights, [4 if d == 10 else 2 for d in sizes])
    parts = [_frame(grid, moments, i, d) for i, d in enumerate(sizes)]
    rest, mass, basis, center, scale = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    return ControlPoints(np.repeat(np.arange(len(types)), sizes), rest, mass, basis, center, scale, grid.axes)


def _frame(grid: Grid, moments: FrameMoments, i: int, d: int) -> tuple[NDArray[np.float64], ...]:
    """rest (d, 3), mass (d,), basis (d, 10), center (d, 3), scale (d,) of frame i."""
    mass, center, scale = moments.mass[i], moments.center[i], moments.scale[i]
    place = {tuple(e): t for t, e in enumerate(EXPONENTS.tolist())}
    # each product of two monomials is a monomial again: its integral over the frame
    products = (POWERS[:d, None] + POWERS[None, :d]).reshape(-1, 3).tolist()
    gram = moments.power[i, [place[tuple(e)] for e in products]].reshape(d, d)
    psi = np.linalg.inv(np.linalg.cholesky(gram / mass))  # rows: orthonormal polynomials in the monomials
    phi = MIXING[d] @ psi / np.sqrt(d)
    first = gram[:, 1:4] / mass  # means of monomial × y; a point frame has no y, and rests at the center
    rest = center + (scale * d * phi @ first @ grid.axes.T if d > 1 else np.zeros((1, 3)))
    basis = np.zeros((d, len(POWERS)))
    basis[:, :d] = phi
    return rest, np.full(d, mass / d), basis, np.tile(center, (d, 1)), np.full(d, scale)


def points_of(control: ControlPoints, frames: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the control points (m,) of `frames`, frame by frame, and the place of each one's frame there (m,)."""
    place, point = np.nonzero(control.frame == frames[:, None])
    return point, place


def control_weights(
    weights_rows: sparse.csr_array, control: ControlPoints, points: NDArray[np.float64]
) -> sparse.csr_array:
    """Return W_j (s, k) at points (s, 3) [m] from the frame weights (s, f) there; rows sum to 1."""
    first = np.searchsorted(control.frame, np.arange(frame_count(weights_rows) + 1))
    number = np.append(0, np.cumsum(np.diff(first)[weights_rows.indices]))[weights_rows.indptr]
    column, value = np.empty(number[-1], np.int32), np.empty(number[-1])
    of_frame = first, control.basis, control.center, control.scale, control.axes
    start, frame = weights_rows.indptr.astype(np.int64), weights_rows.indices.astype(np.int32)  # compiled for once
    _multiply(start, frame, weights_rows.data, *of_frame, points, column, value)
    return sparse.csr_array((value, column, number), shape=(len(points), len(control.frame)))


@njit(cache=True, nogil=True)
def _multiply(
    start: NDArray[np.int64],
    frame: NDArray[np.int32],
    weight: NDArray,
    first: NDArray[np.int64],
    basis: NDArray[np.float64],
    center: NDArray[np.float64],
    scale: NDArray[np.float64],
    axes: NDArray[np.float64],
    points: NDArray[np.float64],
    column: NDArray[np.int32],
    value: NDArray[np.float64],
) -> None:
    """Fill w_i φ_j, row by row; first: (f + 1,) control point of each frame, which share center and scale."""
    at = 0
    monomial = np.ones(10)
    for s in range(len(points)):
        for t in range(start[s], start[s + 1]):
            begin, end = first[frame[t]], first[frame[t] + 1]
            for a in range(3):
                y = 0.0
                for b in range(3):
                    y += (points[s, b] - center[begin, b]) * axes[b, a]
                monomial[1 + a] = y / scale[begin]
            for a in range(3):
                monomial[4 + a] = monomial[1 + a] ** 2
                monomial[7 + a] = monomial[1 + a] * monomial[1 + (a + 1) % 3]
            for j in range(begin, end):
                total = 0.0
                for q in range(10):
                    total += basis[j, q] * monomial[q]
                column[at], value[at] = j, weight[t] * total
                at += 1
