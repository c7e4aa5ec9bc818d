"""Stiffness of the regions, summed over their voxels: K_e = Σ_v V B_vᵀ C_v B_v (the paper, equation (9) and §5.3).

With g_j = ∇W_j at the voxel's centre, ∇W_j = φ_j ∇w_i + w_i ∇φ_j, and Hooke's law of its own (λ, μ), block (j, k) is
Σ_v V (λ g_j g_kᵀ + μ g_k g_jᵀ + μ (g_j · g_k) I). Since Σ_i w_i = 1 and Σ_i ∇w_i = 0 over the region's frames, the
gradients reproduce linear fields, Σ_j x̄_j g_jᵀ = I, at each voxel: K_e passes the patch test.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import sparse
from threadpoolctl import threadpool_limits

from mjframes.control import ControlPoints, points_of
from mjframes.grid import Grid
from mjframes.regions import Regions, members_of
from mjframes.threads import in_parallel
from mjframes.tree import Tree
from mjframes.weights import weight_gradients, weights_at

BLOCK = 1024  # [voxels] of one matrix product: its gradients fit the cache
SHARE = 1 << 15  # [voxels] that one thread sums up at a time


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
    frames = [np.array(members)[np.argsort(rank[list(members)])] for members in regions.frames]
    voxels = members_of(regions.label, len(frames))
    points = [points_of(control, members)[0] for members in frames]
    gradients = [np.zeros(3 * len(some)) for some in points]
    matrices = [np.zeros((3 * len(some), 3 * len(some))) for some in points]
    young, lam, mu = (grid.per_material(name) for name in ("young", "lam", "mu"))
    moduli = np.zeros(len(frames))  # Σ_v E

    def work(piece: tuple[int, NDArray[np.int32]]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        return _sum_voxels(grid, weights, control, piece[1], frames[piece[0]])

    pieces = [(e, some) for e, members in enumerate(voxels) for some in _of_one_material(grid, members)]
    with threadpool_limits(1, "blas"):  # the regions are spread over the processors already
        sums = in_parallel(work, pieces)
        for (e, some), (gradient, product) in zip(pieces, sums, strict=True):
            material = grid.material[some[0]]
            gradients[e] += young[material] * gradient
            moduli[e] += young[material] * len(some)
            matrices[e] += _hooke(lam[material] * grid.cell_volume, mu[material] * grid.cell_volume, product)
    volume = np.array([len(some) for some in voxels]) * grid.cell_volume
    mean = [(g / total).reshape(-1, 3) for g, total in zip(gradients, moduli, strict=True)]
    return Stiffness(tuple(points), tuple(mean), tuple(matrices), volume)


def control_gradients(
    grid: Grid,
    weights: sparse.csr_array,
    control: ControlPoints,
    voxels: NDArray[np.integer],
    frames: NDArray[np.int64],
) -> NDArray[np.float64]:
    """∇W_j (v, m, 3) [1/m] at voxel centres, of the control points of `frames`, which hold all their weight."""
    chosen, place = points_of(control, frames)
    return _product_rule(
        weights_at(weights, voxels, frames), weight_gradients(grid, weights, voxels, frames), place,
        grid.points(voxels), control.basis[chosen], control.center[chosen], control.scale[chosen], control.axes,
    )  # fmt: skip


def _of_one_material(grid: Grid, voxels: NDArray[np.int32]) -> list[NDArray[np.int32]]:
    """The voxels in lists of one material each, none longer than a thread's share."""
    material = grid.material[voxels]
    lists = [voxels[material == m] for m in np.unique(material)]
    return [some[start : start + SHARE] for some in lists for start in range(0, len(some), SHARE)]


def _sum_voxels(
    grid: Grid,
    weights: sparse.csr_array,
    control: ControlPoints,
    voxels: NDArray[np.int32],
    frames: NDArray[np.int64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Σ_v g (3m,) and Σ_v g gᵀ (3m, 3m), g the gradients of all control points of `frames` at voxel v."""
    size = 3 * len(points_of(control, frames)[0])
    total, product = np.zeros(size), np.zeros((size, size))
    for start in range(0, len(voxels), BLOCK):
        some = voxels[start : start + BLOCK]
        gradient = control_gradients(grid, weights, control, some, frames).reshape(len(some), size)
        total += gradient.sum(axis=0)
        product += gradient.T @ gradient  # one factor twice: half the work, and symmetric to the bit
    return total, product


def _hooke(lam: float, mu: float, product: NDArray[np.float64]) -> NDArray[np.float64]:
    """Σ_v C_v: λ g_j g_kᵀ + μ g_k g_jᵀ + μ (g_j · g_k) I from Σ_v g gᵀ (3m, 3m)."""
    m = len(product) // 3
    blocks = product.reshape(m, 3, m, 3)
    matrix = lam * product + mu * blocks.transpose(0, 3, 2, 1).reshape(3 * m, 3 * m)
    return matrix + np.kron(mu * np.einsum("jaka->jk", blocks), np.eye(3))


@njit(cache=True, nogil=True)
def _product_rule(weight, weight_gradient, place, points, basis, center, scale, axes):
    """φ_j ∇w_i + w_i ∇φ_j (v, m, 3) of points j of frame i = place[j]."""
    gradient = np.empty((len(points), len(place), 3))
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
            for x in range(3):
                turned[x] = (axes[x, 0] * slope[0] + axes[x, 1] * slope[1] + axes[x, 2] * slope[2]) / scale[j]
                gradient[v, j, x] = phi * weight_gradient[v, i, x] + weight[v, i] * turned[x]
    return gradient
