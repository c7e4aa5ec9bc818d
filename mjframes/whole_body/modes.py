"""How the body moves beyond its control weights: the modes that frames and material share within a region.

    x(p̄) = Σ_j W_j x_j + R Φ(p̄) T y,   y = Rᵀ x − x̄ of the region's control points, R its rotation

N̂ x is how the superelement moves a voxel. N̂ x − Σ_j W_j x_j, when only the region's own points are known, and not how
they move as one rigid body, is its regression on them, x ~ N(0, K⁺). By the singular value decomposition of that, a few
modes Φ T remain. They hold what scalar weights cannot: that a body thins where it is stretched, and bends along with
what it is made of. R makes them follow any rotation. Index letters: v voxel; j control point; m mode.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mjframes.base.rigid import rigid_motions, size_of
from mjframes.base.rows import members_of
from mjframes.base.threads import in_parallel
from mjframes.elasticity.stiffness import Stiffness
from mjframes.kinematics.control import ControlPoints
from mjframes.volume.grid import Grid
from mjframes.whole_body.superelement import Superelement, degrees

Array = NDArray[np.float64]

MODES = 12  # a region: half of what weights miss is in the first eight to sixteen
STILL = 1e-14  # [-] to the variance of the points, what is rounding: a bone does not deform
SEEN = 1e-10  # [-] eigenvalue of a scaled covariance below which a combination of points never moves
FLAT = 1e-9  # [-] singular value below which points cannot turn about an axis
OTHER = 1e-6  # [-] what a neighbour of another material counts in a slope: nothing beside one of the same
SLIGHT = 1e-3  # [-] rms of a mode, to that of the region's motion, below which it is left out


@dataclass(frozen=True, eq=False)
class Lifting:
    """How r regions move with q modes at most.

    mode: (n, 3, q) float32 Φ at the voxels' centres, of the voxel's region, in volume coordinates, 1 at most, 0 for
    modes that a region has not.
    share: for each region T (q, 3m), of its control points in their order.
    """

    mode: NDArray[np.float32] = field(metadata={"kept": np.float16})
    share: tuple[Array, ...]


def lifting(
    functions: sparse.csr_array,
    control: ControlPoints,
    axes: Array,
    element: Superelement,
    covariance: Array,
    stiffness: Stiffness,
    region: NDArray[np.int32],
) -> Lifting:
    """Return the modes of all regions at the element's r places.

    functions: (r, k) W_j, and region: (r,) there.  axes: (3, 3) of the grid.  covariance: K⁺ (3k, 3k).
    """
    moved = element.moved.reshape(len(element.moved), 3, -1)
    followed = element.lifting @ covariance  # (c, 3k)
    voxels = members_of(region, len(stiffness.points))

    def of_region(e: int) -> tuple[NDArray[np.float32], Array]:
        points = stiffness.points[e]
        dof = degrees(points)
        own = covariance[np.ix_(dof, dof)]
        relative = relative_motions(control.rest[points], np.flatnonzero(np.diagonal(own) <= 0))
        seen = relative @ own @ relative.T
        inverse = inverse_root(seen)
        if not len(voxels[e]) or not len(inverse) or np.trace(seen) < STILL * np.trace(own):
            return np.zeros((len(voxels[e]), 3, 0), np.float32), np.zeros((0, len(dof)))
        unit = relative.T @ inverse.T  # to unit, independent motions of the points, but for their common rigid one
        wanted = (followed[:, dof] @ unit).astype(np.float32)
        field = np.tensordot(moved[voxels[e]], wanted, (2, 0))  # (v, 3, q) along the grid's axes
        field = np.einsum("ab,vbq->vaq", axes.astype(np.float32), field)
        size = np.linalg.norm(field)
        weights = functions[voxels[e]][:, points].toarray().astype(np.float32)
        field -= np.tensordot(weights, (own @ unit).reshape(len(points), 3, -1).astype(np.float32), (1, 0))
        flat = field.reshape(-1, field.shape[2])
        value, vector = np.linalg.eigh((flat.T @ flat).astype(np.float64))
        kept = vector[:, ::-1][:, :MODES][:, value[::-1][:MODES] > (SLIGHT * size) ** 2]
        mode = field @ kept.astype(np.float32)
        largest = np.abs(mode).max(axis=(0, 1), initial=0)
        return mode / largest, largest[:, None] * (unit @ kept).T

    found = list(in_parallel(of_region, range(len(stiffness.points))))
    most = max((len(share) for _, share in found), default=0)
    mode = np.zeros((len(region), 3, most), np.float32)
    for some, (values, share) in zip(voxels, found, strict=True):
        mode[some, :, : len(share)] = values
    return Lifting(mode, tuple(share for _, share in found))


def displaced(lifted: Lifting, stiffness: Stiffness, region: NDArray[np.int32], x: Array) -> Array:
    """Return R Φ T y (n, 3, c) at rest, R = 1, for small displacements x (3k, c) of the control points."""
    found = np.zeros((len(lifted.mode), 3, x.shape[1]))
    for voxels, points, share in zip(
        members_of(region, len(lifted.share)), stiffness.points, lifted.share, strict=True
    ):
        found[voxels] = np.tensordot(lifted.mode[voxels, :, : len(share)], share @ x[degrees(points)], (2, 0))
    return found


def mode_slopes(
    grid: Grid,
    mode: NDArray[np.float32],
    voxels: NDArray[np.integer],
    region: NDArray[np.int32],
    within: NDArray[np.int32],
) -> Array:
    """Return ∇Φ (s, 3, 3, q) [1/m] at voxels (s,), derivatives in the third axis, in volume coordinates.

    mode: (n, 3, q).  region, within: (n,) labels; a slope along an index axis is the mean of those towards the
    neighbours of the same `within`, or without any, of the same region, or 0.
    """
    slopes = np.zeros((len(voxels), *mode.shape[1:], 3))
    own = mode[voxels]
    for axis, step in enumerate(np.eye(3, dtype=np.int32)):
        sums, weight = np.zeros(own.shape), np.zeros(len(voxels))
        for side in (-1, 1):
            other = grid.beside(side * step, voxels)
            inside = (other >= 0) & (region[other] == region[voxels])
            counts = np.where(within[other] == within[voxels], 1.0, OTHER) * inside
            sums += (side * counts / grid.spacing[axis])[:, None, None] * (mode[other] - own)
            weight += counts
        slopes[..., axis] = sums / np.where(weight > 0, weight, 1)[:, None, None]
    return np.einsum("vmqb,ab->vmaq", slopes, grid.axes)


def relative_motions(rest: Array, still: NDArray[np.integer]) -> Array:
    """(3m, 3m) from displacements of m points to those less a rigid motion of all: what is left is what deforms.

    still: the degrees of freedom of the held ones, whose motion that is; without any, it is the nearest one.
    """
    some = still if len(still) else np.arange(3 * len(rest))
    turns = rigid_motions(rest, rest[some[::3] // 3].mean(axis=0), size_of(rest))
    relative = np.eye(3 * len(rest))
    relative[:, some] -= turns @ np.linalg.pinv(turns[some], rcond=FLAT)
    return relative


def inverse_root(covariance: Array) -> Array:
    """A⁺ (q, 3m) of A (3m, q) with A Aᵀ the covariance, 0 for what stands still.

    Not `base.linear.inverse_root`, which multiplies where this divides: in directions that hardly move, rounding alone
    changes the modes by some per cent.
    """
    variance = np.diagonal(covariance)
    moves = variance > SEEN * variance.max(initial=0)
    scale = np.sqrt(variance[moves])
    value, vector = np.linalg.eigh(covariance[np.ix_(moves, moves)] / scale / scale[:, None])
    kept = value > SEEN * value[-1] if len(value) else value > 0
    inverse = np.zeros((np.count_nonzero(kept), len(moves)))
    inverse[:, moves] = (vector[:, kept] / np.sqrt(value[kept])).T / scale
    return inverse
