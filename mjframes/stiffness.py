"""Stiffness of the regions, summed over their voxels: K_e = Σ_v V B_vᵀ C_v B_v (the paper, equation (9) and §5.3).

With g_j = ∇W_j at the voxel's centre, ∇W_j = φ_j ∇w_i + w_i ∇φ_j, and Hooke's law of its own (λ, μ), block (j, k) is
Σ_v V (λ g_j g_kᵀ + μ g_k g_jᵀ + μ (g_j · g_k) I). Since Σ_i w_i = 1 and Σ_i ∇w_i = 0 over the region's frames, the
gradients reproduce linear fields, Σ_j x̄_j g_jᵀ = I, at each voxel: K_e passes the patch test.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from threadpoolctl import threadpool_limits

from mjframes.control import ControlPoints, control_functions, points_of
from mjframes.grid import Grid
from mjframes.regions import Regions
from mjframes.tree import Tree
from mjframes.weights import weight_gradients, weights_at

BLOCK = 4096  # [voxels] of one matrix product: its gradients fit the cache


@dataclass(frozen=True, eq=False)
class Stiffness:
    """Of r regions; m is the number of a region's control points.

    points: (m,) control points of each, ancestors in the tree first.  gradient: (m, 3) mean of ∇W_j by E dV [1/m].
    matrix: (3m, 3m) K_e [N/m], degree of freedom 3a + xyz of the a-th point.  volume: (r,) [m³].
    """

    points: tuple[NDArray[np.int64], ...]
    gradient: tuple[NDArray[np.float64], ...]
    matrix: tuple[NDArray[np.float64], ...]
    volume: NDArray[np.float64]


def region_stiffness(
    grid: Grid, weights: sparse.csr_array, control: ControlPoints, regions: Regions, tree: Tree
) -> Stiffness:
    """Stiffness matrix and mean gradients of every region, at rest."""
    rank = np.argsort(tree.order)
    points, gradients, matrices = [], [], []
    order = np.argsort(regions.label, kind="stable")
    voxels = np.split(order, np.searchsorted(regions.label[order], np.arange(1, len(regions.frames))))
    # the products are small: threads of the linear algebra would only wait for each other on a busy machine
    with threadpool_limits(1, user_api="blas"):
        for members, some in zip(regions.frames, voxels, strict=True):
            frames = np.array(members)[np.argsort(rank[list(members)])]
            gradient, matrix = _sum_voxels(grid, weights, control, some, frames)
            points.append(points_of(control, frames)[0])
            gradients.append(gradient)
            matrices.append(matrix)
    volume = np.array([len(some) for some in voxels]) * grid.cell_volume
    return Stiffness(tuple(points), tuple(gradients), tuple(matrices), volume)


def control_gradients(
    grid: Grid,
    weights: sparse.csr_array,
    control: ControlPoints,
    voxels: NDArray[np.int64],
    frames: NDArray[np.int64],
) -> NDArray[np.float64]:
    """∇W_j (v, m, 3) [1/m] at voxel centres, of the control points of `frames`, which hold all their weight."""
    chosen, place = points_of(control, frames)
    gradient = weight_gradients(grid, weights, voxels, frames)[:, place]
    gradient *= control_functions(control, chosen, grid.centers[voxels])[:, :, None]
    gradient += weights_at(weights, voxels, frames)[:, place, None] * control.basis[chosen, 1:]
    return gradient


def _sum_voxels(
    grid: Grid,
    weights: sparse.csr_array,
    control: ControlPoints,
    voxels: NDArray[np.int64],
    frames: NDArray[np.int64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean gradient (m, 3) and K_e (3m, 3m) of one region."""
    m = len(points_of(control, frames)[0])
    mean, by_lam, by_mu = np.zeros(3 * m), np.zeros((3 * m, 3 * m)), np.zeros((3 * m, 3 * m))
    for start in range(0, len(voxels), BLOCK):
        some = voxels[start : start + BLOCK]
        gradient = control_gradients(grid, weights, control, some, frames).reshape(len(some), 3 * m)
        mean += grid.young[some] @ gradient
        for modulus, total in ((grid.lam, by_lam), (grid.mu, by_mu)):
            scaled = gradient * np.sqrt(grid.cell_volume * modulus[some])[:, None]
            total += scaled.T @ scaled  # one factor twice: half the work, and symmetric to the bit
    swapped = by_mu.reshape(m, 3, m, 3)
    matrix = by_lam + swapped.transpose(0, 3, 2, 1).reshape(3 * m, 3 * m)
    matrix += np.kron(np.einsum("jaka->jk", swapped), np.eye(3))
    return (mean / grid.young[voxels].sum()).reshape(m, 3), matrix
