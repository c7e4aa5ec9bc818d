"""Moments of the frames' masses, dm = ρ w_i dV, in one pass over all weights (the paper, equation (8), row sums).

With c the centroid of frame i and s its radius of gyration, ∫ y^e dm for y = axesᵀ (p − c) / s and exponents e up to
degree 2 or 4. A voxel counts with its own extent, the mean of y^e over it: without it a plate has none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import sparse

from mjframes.base.threads import in_parallel
from mjframes.kinematics.monomials import exponents
from mjframes.volume.grid import Grid
from mjframes.weights.weights import frame_count

Array = NDArray[np.float64]

EXPONENTS = exponents(4)  # the square of a quadratic function has degree 4
SHARE = 1 << 17  # [voxels] that one thread sums up at a time


@dataclass(frozen=True, eq=False)
class FrameMoments:
    """The moments of f frames.

    mass: (f,) [kg].
    center: (f, 3) c, volume coordinates [m].
    scale: (f,) s [m].
    power: (f, 35) ∫ y^e dm [kg] for EXPONENTS; 0 beyond the frame's degree.
    """

    mass: Array
    center: Array
    scale: Array
    power: Array


def frame_moments(grid: Grid, weights: sparse.csr_array, degrees: Sequence[int]) -> FrameMoments:
    """Return the moments of the f frames of weights (n, f); degrees: (f,) 2 or 4."""
    f = frame_count(weights)
    dm = grid.per_material("density") * grid.cell_volume
    terms = np.array([np.count_nonzero(EXPONENTS.sum(axis=1) <= degree) for degree in degrees])
    parts = [slice(start, start + SHARE) for start in range(0, len(grid.index), SHARE)]

    def first(part: slice) -> Array:
        rows, index = sparse.csr_array(weights[part]), grid.index[part]
        rows.data = rows.data * np.repeat(dm[grid.material[part]], np.diff(rows.indptr))
        return rows.T @ np.column_stack([np.ones(len(index)), index])

    sums = sum(in_parallel(first, parts), np.zeros((f, 4)))
    mass = sums[:, 0].copy()
    middle = sums[:, 1:] / mass[:, None]
    length = float(np.linalg.norm(grid.spacing * grid.lookup.shape))
    edges = grid.spacing / length

    def higher(part: slice) -> Array:
        total = np.zeros((f, len(EXPONENTS)))
        rows = weights.indptr[part.start : part.stop + 1]
        _add_higher(
            rows, weights.indices, weights.data, grid.index[part], grid.material[part], dm,
            middle, edges, terms, EXPONENTS, total,
        )  # fmt: skip
        return total

    power = sum(in_parallel(higher, parts), np.zeros((f, len(EXPONENTS))))
    square = (EXPONENTS.sum(axis=1) == 2) & (EXPONENTS.max(axis=1) == 2)
    scale = np.sqrt(power[:, square].sum(axis=1) / mass)
    power /= scale[:, None] ** EXPONENTS.sum(axis=1)
    return FrameMoments(mass, grid.origin + (middle + 0.5) * grid.spacing @ grid.axes.T, scale * length, power)


@njit(cache=True, nogil=True)
def _add_higher(
    indptr: NDArray[np.integer],
    indices: NDArray[np.integer],
    data: NDArray,
    index: NDArray[np.int32],
    material: NDArray[np.unsignedinteger],
    dm: Array,
    middle: Array,
    edges: Array,
    terms: NDArray[np.int64],
    exponents: NDArray[np.int64],
    total: Array,
) -> None:
    """Add ∫ y^e dm to total (f, 35), y = (index − middle) edges; terms: (f,) how many exponents a frame has."""
    power = np.empty((3, 5))
    for v in range(len(index)):
        for k in range(indptr[v], indptr[v + 1]):
            i = indices[k]
            share = dm[material[v]] * data[k]
            for axis in range(3):
                h = edges[axis]
                x = (index[v, axis] - middle[i, axis]) * h
                power[axis, 0] = 1.0
                power[axis, 1] = x
                power[axis, 2] = x * x + h * h / 12
                power[axis, 3] = x * x * x + x * h * h / 4
                power[axis, 4] = x * x * x * x + x * x * h * h / 2 + h * h * h * h / 80
            for t in range(terms[i]):
                total[i, t] += share * power[0, exponents[t, 0]] * power[1, exponents[t, 1]] * power[2, exponents[t, 2]]
