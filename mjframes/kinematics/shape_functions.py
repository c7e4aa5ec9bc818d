"""The control weights W_j = w_i φ_j + ΔW_j, anywhere in the material: x(p̄) = Σ_j W_j(p̄) x_j (the paper, equation (3)).

w_i and ΔW are known at the voxels, and trilinear between voxels with the same frames; φ_j are polynomials. ΔW makes the
weights follow the body (`whole_body.weight_correction`); as Σ_j ΔW_j = 0 and Σ_j ΔW_j x̄_j = 0 at every voxel,
interpolation keeps what w_i φ_j reproduce. The paper's own weights have none.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mjframes.kinematics.control import ControlPoints, control_weights, points_of
from mjframes.kinematics.gradients import product_rule
from mjframes.volume.grid import Grid
from mjframes.weights.interpolation import voxel_shares
from mjframes.weights.weights import weight_gradients, weights_at

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ShapeFunctions:
    """The shape functions of f frames and k control points on n voxels.

    weights: (n, f) w_i, rows sum to 1.
    control: the points and their φ_j.
    correction: (n, k) ΔW_j, None for none.
    """

    weights: sparse.csr_array
    control: ControlPoints
    correction: sparse.csr_array | None = None

    def at(self, grid: Grid, points: Array, nearest: NDArray[np.integer] | None = None) -> sparse.csr_array:
        """Return W_j (s, k) at points (s, 3) in volume coordinates [m].

        nearest: the closest voxel of each, where they are known.
        """
        shares = voxel_shares(grid, self.weights, points, nearest)
        found = control_weights(sparse.csr_array(shares @ self.weights), self.control, points)
        return found if self.correction is None else sparse.csr_array(found + shares @ self.correction)

    def at_voxels(self, grid: Grid) -> sparse.csr_array:
        """Return W_j (n, k) at the voxels' centres."""
        found = control_weights(self.weights, self.control, grid.centers)
        return found if self.correction is None else sparse.csr_array(found + self.correction)

    def slopes(
        self,
        grid: Grid,
        voxels: NDArray[np.integer],
        frames: NDArray[np.int64],
        weight: Array,
        points: Array,
        within: NDArray[np.int32],
    ) -> tuple[Array, Array]:
        """Return W_j (s, m) and ∇W_j (s, m, 3) [1/m] of the control points of `frames` at points (s, 3) [m].

        weight: (s, f) w_i there.  voxels: (s,) next to the points, where ΔW and all slopes are taken.
        within: (n,) labels of the regions, inside which slopes are taken.
        """
        slope = weight_gradients(grid, self.weights, voxels, frames, within)
        value, gradient = product_rule(self.control, frames, weight, slope, points)
        if self.correction is not None:
            chosen = points_of(self.control, frames)[0]
            value += weights_at(self.correction, voxels, chosen)
            change = weight_gradients(grid, self.correction, voxels, chosen, within)
            gradient += change - change.mean(axis=1, keepdims=True)  # neighbours may have points that are left out
        return value, gradient
