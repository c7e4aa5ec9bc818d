"""Stiffness of the regions, summed over their voxels: K_e = Σ_v V B_vᵀ C_v B_v (the paper, equation (9) and §5.3).

With g_j = ∇W_j at the voxel's centre, ∇W_j = φ_j ∇w_i + w_i ∇φ_j, and Hooke's law of its own (λ, μ), block (j, k) is
Σ_v V (λ g_j g_kᵀ + μ g_k g_jᵀ + μ (g_j · g_k) I). Since Σ_i w_i = 1 and Σ_i ∇w_i = 0 over the region's frames, the
gradients reproduce linear fields, Σ_j x̄_j g_jᵀ = I, at each voxel: K_e passes the patch test.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from threadpoolctl import threadpool_limits

from mjframes.base.rows import members_of
from mjframes.base.threads import in_parallel
from mjframes.elasticity.regions import Regions
from mjframes.elasticity.shares import factor_of
from mjframes.kinematics.control import ControlPoints, points_of
from mjframes.kinematics.gradients import control_gradients
from mjframes.kinematics.shape_functions import ShapeFunctions
from mjframes.kinematics.tree import Tree
from mjframes.volume.grid import Grid

BLOCK = 1024  # [voxels] of one matrix product: its gradients fit the cache
SHARE = 1 << 15  # [voxels] that one thread sums up at a time


@dataclass(frozen=True, eq=False)
class Stiffness:
    """The stiffness of r regions; m is the number of a region's control points.

    points: (m,) control points of each; of the whole body those of the region's own frame last.
    gradient: (m, 3) ḡ_j that show how it is turned [1/m]: mean of ∇W_j by E dV, or as in rotations.py.
    matrix: (3m, 3m) K_e [N/m], degree of freedom 3a + xyz of the a-th point.
    volume: (r,) [m³].
    shares: (p, 3o, 3m) what each material but the last has of the rows of the last o points [N/m], see shares.py.
    """

    points: tuple[NDArray[np.int64], ...]
    gradient: tuple[NDArray[np.float64], ...]
    matrix: tuple[NDArray[np.float64], ...] = field(metadata={"symmetric": True})
    volume: NDArray[np.float64]
    shares: tuple[NDArray[np.float64], ...] = ()


def region_stiffness(grid: Grid, shapes: ShapeFunctions, regions: Regions, tree: Tree) -> Stiffness:
    """Return the stiffness matrix and the mean gradients of every region, at rest."""
    weights, control = shapes.weights, shapes.control
    rank = np.argsort(tree.order)
    frames = [np.array(members)[np.argsort(rank[list(members)])] for members in regions.frames]
    voxels = members_of(regions.label, len(frames))
    points = [points_of(control, members)[0] for members in frames]
    gradients = [np.zeros(3 * len(some)) for some in points]
    factor = factor_of(grid.table)
    count = int(factor.max()) + 1
    matrices = [np.zeros((count, 3 * len(some), 3 * len(some))) for some in points]  # by material
    young, lam, mu = (grid.per_material(name) for name in ("young", "lam", "mu"))
    moduli = np.zeros(len(frames))  # Σ_v E

    def work(piece: tuple[int, NDArray[np.int32]]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        return _sum_voxels(grid, weights, control, piece[1], frames[piece[0]], regions.label)

    pieces = [(e, some) for e in range(len(frames)) for some in _of_one_material(grid, voxels[e])]
    with threadpool_limits(1, "blas"):  # the regions are spread over the processors already
        sums = in_parallel(work, pieces)
        for (e, some), (gradient, product) in zip(pieces, sums, strict=True):
            material = grid.material[some[0]]
            gradients[e] += young[material] * gradient
            moduli[e] += young[material] * len(some)
            matrices[e][factor[material]] += _hooke(
                float(lam[material]) * grid.cell_volume, float(mu[material]) * grid.cell_volume, product
            )
    volume = np.array([len(some) for some in voxels]) * grid.cell_volume
    mean = [
        shows_rotations((g / total).reshape(-1, 3), control.rest[some])
        for g, total, some in zip(gradients, moduli, points, strict=True)
    ]
    matrices = [np.array([blind_to_translations(of_one) for of_one in some]) for some in matrices]
    total = tuple(np.asarray(some.sum(axis=0)) for some in matrices)
    return Stiffness(tuple(points), tuple(mean), total, volume, shares=tuple(some[:-1] for some in matrices))


def shows_rotations(gradient: NDArray[np.float64], rest: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return ḡ (m, 3), changed the least for Σ_j x̄_j ḡ_jᵀ = I as far as the points x̄ (m, 3) reach, and Σ_j ḡ_j = 0.

    Weights of frames that can turn have it already; those of point frames would not see a rotation as one.
    """
    offset = rest - rest.mean(axis=0)
    missing = np.eye(3) - rest.T @ gradient
    return gradient + offset @ np.linalg.pinv(offset.T @ offset, rcond=1e-9, hermitian=True) @ missing


def blind_to_translations(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return K_e (3m, 3m) without the forces on common translations of all points, which are rounding errors.

    Where h²K/m is as much as one over rounding, they would push a free body around.
    """
    blocks = matrix.reshape(len(matrix) // 3, 3, -1, 3)
    blocks = blocks - blocks.mean(axis=0)
    blocks = blocks - blocks.mean(axis=2, keepdims=True)
    centred = blocks.reshape(matrix.shape)
    return 0.5 * (centred + centred.T)


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
    region: NDArray[np.int32],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Σ_v g (3m,) and Σ_v g gᵀ (3m, 3m), g the gradients of all control points of `frames` at voxel v."""
    size = 3 * len(points_of(control, frames)[0])
    total, product = np.zeros(size), np.zeros((size, size))
    for start in range(0, len(voxels), BLOCK):
        some = voxels[start : start + BLOCK]
        gradient = control_gradients(grid, weights, control, some, frames, region).reshape(len(some), size)
        total += gradient.sum(axis=0)
        product += gradient.T @ gradient  # one factor twice: half the work, and symmetric to the bit
    return total, product


def _hooke(lam: float, mu: float, product: NDArray[np.float64]) -> NDArray[np.float64]:
    """Σ_v C_v: λ g_j g_kᵀ + μ g_k g_jᵀ + μ (g_j · g_k) I from Σ_v g gᵀ (3m, 3m)."""
    m = len(product) // 3
    blocks = product.reshape(m, 3, m, 3)
    matrix = lam * product + mu * blocks.transpose(0, 3, 2, 1).reshape(3 * m, 3 * m)
    return matrix + np.kron(mu * np.einsum("jaka->jk", blocks), np.eye(3))
