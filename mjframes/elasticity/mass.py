"""The consistent mass matrix: M_jk = ∫ ρ W_j W_k dV over the voxels (the paper, equation (7)).

MuJoCo's point masses carry its row sums, Σ_k M_jk. What they lack, D = M − diag(Σ_k M_jk), is constant and summed up
region by region; its rows add up to zero, so that neither weight nor momentum changes. A voxel is integrated with its
own extent h: the mean of W_j W_k over it is that of the centre plus Σ_a h_a²/12 ∂_a W_j ∂_a W_k.

The weights are w_i φ_j, not corrected: theirs are the masses that are positive whatever the materials, and as
∫ ρ w_i φ_j p̄ dV = m_j x̄_j, D is blind to all linear fields: what turns as a whole, on a link of a robot or as the frame
of a rigid one, has the inertia that MuJoCo gives it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mjframes.base.rows import members_of
from mjframes.elasticity.stiffness import Stiffness
from mjframes.kinematics.gradients import product_rule
from mjframes.kinematics.shape_functions import ShapeFunctions
from mjframes.volume.grid import Grid
from mjframes.weights.weights import weight_gradients, weights_at

BLOCK = 4096  # [voxels] at a time
SHARED = 0.01  # [-] of the sum of |r| that μ is at least; below, kernels touch without a voxel in common, and r is tiny


def uncoupled(difference: NDArray[np.float64], branch: NDArray[np.integer]) -> NDArray[np.float64]:
    """Return D (m, m) [kg] without what couples points of different branches (m,) of the kinematic tree.

    MuJoCo's inertia matrix has no room for it there. What the points of branch b share with those of c, of mass μ, is
    theirs as r rᵀ / μ, r_j = Σ_k D_jk over the points k of c: rows still add up to zero, and the mass stays positive
    definite. The diagonal r would not: r_j is negative where the weights of a frame's points are.
    """
    kept = np.where(branch[:, None] == branch, difference, 0.0)
    for one in np.unique(branch):
        for other in np.unique(branch[branch != one]):
            rows = np.where(branch == one, difference[:, branch == other].sum(axis=1), 0.0)
            shared = rows.sum()
            kept += np.outer(rows, rows) / shared if shared > SHARED * np.abs(rows).sum() else np.diag(rows)
    return kept


def mass_difference(
    grid: Grid, metric: Grid, shapes: ShapeFunctions, label: NDArray[np.int32], stiffness: Stiffness
) -> tuple[NDArray[np.float64], ...]:
    """Return D (m, m) [kg] of each region, in the order of its control points.

    metric: the grid in the metric of the weights.  label: (n,) the region of each voxel.
    """
    control, differences = shapes.control, []
    for voxels, points in zip(members_of(label, len(stiffness.points)), stiffness.points, strict=True):
        frames = control.frame[points][np.flatnonzero(np.diff(control.frame[points], prepend=-1))]
        total = np.zeros((len(points), len(points)))
        for start in range(0, len(voxels), BLOCK):
            some = voxels[start : start + BLOCK]
            dm = (grid.density[some] * grid.cell_volume)[:, None]
            weight = weights_at(shapes.weights, some, frames)
            slope = weight_gradients(metric, shapes.weights, some, frames, label)
            value, gradient = product_rule(control, frames, weight, slope, grid.points(some))
            along = gradient @ grid.axes
            total += value.T @ (dm * value)
            for a in range(3):
                total += grid.spacing[a] ** 2 / 12 * along[:, :, a].T @ (dm * along[:, :, a])
        total = (total + total.T) / 2
        differences.append(total - np.diag(total.sum(axis=1)))
    return tuple(differences)
