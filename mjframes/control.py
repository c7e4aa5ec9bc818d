"""Equimomental control points: affine frames as four point masses each (the paper, equations (3) and (8), row sums).

x(p̄) = Σ_j W_j(p̄) x_j with W_j = w_i φ_k and φ_k(p) = ¼ (1 + t_k · L⁻¹ (p − c)): the barycentric coordinates of the
tetrahedron x̄_k = c + L t_k, where c is the centroid and L Lᵀ the second central moment over m of dm = ρ w_i dV.
Then Σ_k φ_k = 1 and ∫ φ_k φ_l dm = (m/4) δ_kl: four masses m/4 carry the frame's row-sum lumped mass matrix exactly.

The paper drops M_ij for i ≠ j, which loses mass because Σ w_i² < 1; row sums keep mass, momentum and weight.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mjframes.grid import Grid
from mjframes.weights import frame_count

TETRAHEDRON = np.array(
    [[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], float
)  # t_k: Σ t = 0, t_k · t_l = 4 δ_kl − 1


@dataclass(frozen=True, eq=False)
class ControlPoints:
    """k control points, those of a frame one after the other, in the order of the frames.

    frame: (k,) the frame of each.  rest: (k, 3) x̄_j [m].  mass: (k,) [kg].
    basis: (k, 4), φ_j(p) = basis[j, 0] + basis[j, 1:] · p for p in volume coordinates [m].
    """

    frame: NDArray[np.int64]
    rest: NDArray[np.float64]
    mass: NDArray[np.float64]
    basis: NDArray[np.float64]


def control_points(grid: Grid, weights: sparse.csr_array) -> ControlPoints:
    """Four control points for each of the f frames of weights (n, f)."""
    share = sparse.csr_array(weights.T).multiply(grid.density * grid.cell_volume).tocsr()  # dm of each frame's voxels
    mass = share.sum(axis=1)
    origin = grid.centers.mean(axis=0)  # moments about a point inside: those about a far one would cancel
    offset = grid.centers - origin
    mean = share @ offset / mass[:, None]
    product = np.einsum("va,vb->vab", offset, offset).reshape(-1, 9)
    moment = (share @ product).reshape(-1, 3, 3) / mass[:, None, None] - np.einsum("ia,ib->iab", mean, mean)
    # The voxel's own extent: without it a plate one voxel thick has no moment across.
    moment += grid.axes @ np.diag(grid.spacing**2 / 12) @ grid.axes.T
    center = origin + mean
    root = np.linalg.cholesky(moment)
    slope = 0.25 * np.einsum("ka,iab->ikb", TETRAHEDRON, np.linalg.inv(root))
    constant = 0.25 - np.einsum("ikb,ib->ik", slope, center)
    return ControlPoints(
        frame=np.repeat(np.arange(len(mass)), 4),
        rest=(center[:, None, :] + np.einsum("iab,kb->ika", root, TETRAHEDRON)).reshape(-1, 3),
        mass=np.repeat(mass / 4, 4),
        basis=np.concatenate([constant[:, :, None], slope], axis=2).reshape(-1, 4),
    )


def points_of(control: ControlPoints, frames: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The control points (m,) of `frames`, frame by frame, and for each the place of its frame in `frames` (m,)."""
    place, point = np.nonzero(control.frame == frames[:, None])
    return point, place


def control_functions(
    control: ControlPoints, chosen: NDArray[np.int64], points: NDArray[np.float64]
) -> NDArray[np.float64]:
    """φ_j (s, j) of the control points `chosen` (j,) at points (s, 3) in volume coordinates [m]."""
    return control.basis[chosen, 0] + points @ control.basis[chosen, 1:].T


def control_weights(
    weights_rows: sparse.csr_array, control: ControlPoints, points: NDArray[np.float64]
) -> sparse.csr_array:
    """W_j (s, k) at points (s, 3) [m] from the frame weights (s, f) there; rows sum to 1."""
    per_frame = np.bincount(control.frame, minlength=frame_count(weights_rows))
    first = np.cumsum(per_frame) - per_frame
    repeats = per_frame[weights_rows.indices]
    within = np.arange(repeats.sum()) - np.repeat(np.cumsum(repeats) - repeats, repeats)
    j = np.repeat(first[weights_rows.indices], repeats) + within
    row = np.repeat(np.repeat(np.arange(len(points)), np.diff(weights_rows.indptr)), repeats)
    value = np.repeat(weights_rows.data, repeats) * (
        control.basis[j, 0] + np.einsum("qa,qa->q", control.basis[j, 1:], points[row])
    )
    return sparse.csr_array((value, (row, j)), shape=(len(points), len(control.frame)))
