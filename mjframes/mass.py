"""The consistent mass matrix: M_jk = ∫ ρ W_j W_k dV over the voxels (the paper, equation (7)).

MuJoCo's point masses carry its row sums, Σ_k M_jk. What they lack, D = M − diag(Σ_k M_jk), is constant and summed up
region by region; its rows add up to zero, so that neither weight nor momentum changes. A voxel is integrated with its
own extent h: the mean of W_j W_k over it is that of the centre plus Σ_a h_a²/12 ∂_a W_j ∂_a W_k.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mjframes.control import ControlPoints
from mjframes.gradients import product_rule
from mjframes.grid import Grid
from mjframes.regions import Regions, members_of
from mjframes.stiffness import Stiffness
from mjframes.weights import weight_gradients, weights_at

BLOCK = 4096  # [voxels] at a time


def mass_difference(
    grid: Grid, weights: sparse.csr_array, control: ControlPoints, regions: Regions, stiffness: Stiffness
) -> tuple[NDArray[np.float64], ...]:
    """D (m, m) [kg] of each region, in the order of its control points."""
    differences = []
    for voxels, points in zip(members_of(regions.label, len(stiffness.points)), stiffness.points, strict=True):
        frames = control.frame[points][np.flatnonzero(np.diff(control.frame[points], prepend=-1))]
        total = np.zeros((len(points), len(points)))
        for start in range(0, len(voxels), BLOCK):
            some = voxels[start : start + BLOCK]
            dm = (grid.density[some] * grid.cell_volume)[:, None]
            weight, slope = (
                weights_at(weights, some, frames),
                weight_gradients(grid, weights, some, frames, regions.label),
            )
            value, gradient = product_rule(control, frames, weight, slope, grid.points(some))
            along = gradient @ grid.axes
            total += value.T @ (dm * value)
            for a in range(3):
                total += grid.spacing[a] ** 2 / 12 * along[:, :, a].T @ (dm * along[:, :, a])
        differences.append(total - np.diag(total.sum(axis=1)))
    return tuple(differences)
