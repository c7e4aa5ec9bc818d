"""Control weights W_j = w_i φ_j at points, and their gradients ∇W_j = φ_j ∇w_i + w_i ∇φ_j (the paper, §3)."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import sparse

from mjframes.kinematics.control import ControlPoints, points_of
from mjframes.volume.grid import Grid
from mjframes.weights.weights import weight_gradients, weights_at


def control_gradients(
    grid: Grid,
    weights: sparse.csr_array,
    control: ControlPoints,
    voxels: NDArray[np.integer],
    frames: NDArray[np.int64],
    within: NDArray[np.int32] | None = None,
) -> NDArray[np.float64]:
    """Return ∇W_j (v, m, 3) [1/m] at voxel centres, of the control points of `frames`, which hold all their weight.

    within: (n,) labels of the regions, where slopes shall be those inside them.
    """
    slope = weight_gradients(grid, weights, voxels, frames, within)
    return product_rule(control, frames, weights_at(weights, voxels, frames), slope, grid.points(voxels))[1]


def product_rule(
    control: ControlPoints,
    frames: NDArray[np.int64],
    weight: NDArray[np.float64],
    slope: NDArray[np.float64],
    points: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return W_j (s, m) and ∇W_j (s, m, 3) [1/m] of the control points of `frames`, from their weights w_i (s, f) and
    slopes ∇w_i (s, f, 3) at points (s, 3) [m].
    """
    chosen, place = points_of(control, frames)
    return _product_rule(
        weight, slope, place, points, control.basis[chosen], control.center[chosen], control.scale[chosen], control.axes
    )


@njit(cache=True, nogil=True)
def _product_rule(
    weight: NDArray[np.float64],
    weight_gradient: NDArray[np.float64],
    place: NDArray[np.int64],
    points: NDArray[np.float64],
    basis: NDArray[np.float64],
    center: NDArray[np.float64],
    scale: NDArray[np.float64],
    axes: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """w_i φ_j (v, m) and φ_j ∇w_i + w_i ∇φ_j (v, m, 3) of points j of frame i = place[j]."""
    value, gradient = np.empty((len(points), len(place))), np.empty((len(points), len(place), 3))
    y, slope, turned = np.empty(3), np.empty(3), np.empty(3)
    for v in range(len(points)):
        for j in range(len(place)):
            i = place[j]
            b = basis[j]
            if j == 0 or place[j - 1] != i:  # all points of a frame share center and scale
                for a in range(3):
                    y[a] = 0.0
                    for x in range(3):
                        y[a] += (points[v, x] - center[j, x]) * axes[x, a] / scale[j]
            phi = b[0] + b[1] * y[0] + b[2] * y[1] + b[3] * y[2]
            slope[0], slope[1], slope[2] = b[1], b[2], b[3]
            if b[4] != 0 or b[5] != 0 or b[6] != 0 or b[7] != 0 or b[8] != 0 or b[9] != 0:
                phi += b[4] * y[0] * y[0] + b[5] * y[1] * y[1] + b[6] * y[2] * y[2]
                phi += b[7] * y[0] * y[1] + b[8] * y[1] * y[2] + b[9] * y[2] * y[0]
                slope[0] += 2 * b[4] * y[0] + b[7] * y[1] + b[9] * y[2]
                slope[1] += 2 * b[5] * y[1] + b[7] * y[0] + b[8] * y[2]
                slope[2] += 2 * b[6] * y[2] + b[8] * y[1] + b[9] * y[0]
            value[v, j] = weight[v, i] * phi
            for x in range(3):
                turned[x] = (axes[x, 0] * slope[0] + axes[x, 1] * slope[1] + axes[x, 2] * slope[2]) / scale[j]
                gradient[v, j, x] = phi * weight_gradient[v, i, x] + weight[v, i] * turned[x]
    return value, gradient
