"""Cells of the whole body's regions, where a hyperelastic law is evaluated: how much of its stiffness is the law's.

A region's energy, with y = Rᵀ x − x̄ of its control points and R its rotation, is

    W = Σ_q V_q ψ(I + E_q y) + ½ yᵀ K_r y,      K_i = K_r + Σ_q V_q E_qᵀ C E_q at rest

so that it answers small loads as the finite elements do, whatever the law, and large strains as the law does. C is the
law's tangent at rest. A cell q is what one set of frames moves of one material in a region. E_q is the regression of
the mean over it of the displacement's gradient, ∇N̂ x of the superelement, on the region's own points, x ~ N(0, K⁺),
exact for rigid motions:

    E = T M⁺ + ⟨g zᵀ⟩ ⟨z zᵀ⟩⁺ Zᵀ,   z = Zᵀ x,   Zᵀ M = 0,   g = ∇N̂ x − T M⁺ x

for rigid motions M and their gradients T. A mean's energy is less than the mean energy, Σ_q V_q E_qᵀ C E_q ⪯ K but for
what the region's points alone do not know; V_q is a cell's volume times the largest share s ≤ 1 that keeps the rest
of K positive. That is split into one K_r a region as K was (`selection`): the frames are eliminated from the last one
on, and a frame's own block with what it couples to is its region's; all are positive semi-definite, and sum up to K.
Index letters: v voxel; q cell; e region.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mjframes.control import ControlPoints
from mjframes.grid import Grid
from mjframes.laws import LawParameters, hessian
from mjframes.regions import frame_sets, members_of
from mjframes.rigid import rigid_motions
from mjframes.stiffness import Stiffness, blind_to_translations
from mjframes.whole_body.superelement import Superelement, degrees, frame_motions

Array = NDArray[np.float64]

SMALL = 0.1  # [-] of a region's volume of one material: smaller cells join the region's largest of that material
SEEN = 1e-10  # [-] eigenvalue of a scaled matrix that counts as zero


@dataclass(frozen=True, eq=False)
class Cells:
    """Of r regions; m is the number of a region's control points, q that of its cells.

    volume: (q,) V_q, the cells' volumes times s [m³].  material: (q,) places in the grid's table.
    slope: (q, 9, 3m) E_q [1/m], row 3a + b for ∂u_a/∂p_b, in volume coordinates.
    remainder: (3m, 3m) K_r [N/m].
    """

    volume: tuple[Array, ...]
    material: tuple[NDArray[np.int64], ...]
    slope: tuple[Array, ...]
    remainder: tuple[Array, ...]

    def stiffened(self, before: Stiffness, after: Stiffness) -> Cells:
        """Return them where the regions became stiffer than they were before."""
        added = (new - old for new, old in zip(after.matrix, before.matrix, strict=True))
        return replace(self, remainder=tuple(K + more for K, more in zip(self.remainder, added, strict=True)))


def cells(
    grid: Grid,
    weights: sparse.csr_array,
    control: ControlPoints,
    types: Sequence[str],
    held: int,
    element: Superelement,
    stiffness: Stiffness,
    region: NDArray[np.int32],
    place: NDArray[np.integer],
    laws: Sequence[LawParameters],
) -> Cells:
    """Return the cells of all regions.

    weights: (n, f) of the frames at the voxels.  types: (f,) of the frames, of which the first `held` are held.
    stiffness: of the regions.  region: (n,) of each voxel.  laws: of each material of the grid's table.
    """
    k = len(control.frame)
    total = np.zeros((3 * k, 3 * k))
    for points, matrix in zip(stiffness.points, stiffness.matrix, strict=True):
        total[np.ix_(degrees(points), degrees(points))] += matrix
    basis = frame_motions(control, types, control.rest, held)
    root = _root(total, basis)  # of K⁺
    followed = element.lifting @ root
    turned = np.kron(grid.axes, grid.axes)
    allowed = basis @ basis.T
    tangent = [hessian(law, np.eye(3)[None])[0] for law in laws]
    sets = frame_sets(weights)[0]
    volume, material, slope = [], [], []
    for voxels, points in zip(members_of(region, len(stiffness.points)), stiffness.points, strict=True):
        some = _members(grid, sets, voxels)
        dof = degrees(points)
        fits = _Fit(control.rest[points], root[dof])
        volume.append(np.array([len(cell) * grid.cell_volume for cell in some]))
        material.append(np.array([grid.material[cell[0]] for cell in some], np.int64))
        slope.append(
            np.array(
                [fits.slope(turned @ _mean_gradient(grid, cell, element, place, tangent) @ followed) for cell in some]
            ).reshape(len(some), 9, len(dof))
            @ allowed[np.ix_(dof, dof)]
        )
    taken = np.zeros_like(total)
    for points, V, numbers, E in zip(stiffness.points, volume, material, slope, strict=True):
        taken[np.ix_(degrees(points), degrees(points))] += _quadratic(V, numbers, E, tangent)
    share = 1 / max(1.0, np.linalg.eigvalsh(root.T @ taken @ root)[-1])
    remainder = _split(total - share * taken, control, stiffness.points)
    return Cells(
        volume=tuple(share * V for V in volume),
        material=tuple(material),
        slope=tuple(slope),
        remainder=tuple(map(blind_to_translations, remainder)),
    )


def _members(grid: Grid, sets: NDArray[np.int32], voxels: NDArray[np.int32]) -> list[NDArray[np.int32]]:
    """The voxels of each cell of a region."""
    found = []
    soft = voxels[grid.piece[voxels] < 0]
    for number in np.unique(grid.material[soft]):
        some = soft[grid.material[soft] == number]
        kinds, kind, count = np.unique(sets[some], return_inverse=True, return_counts=True)
        place = np.where(count < SMALL * len(some), np.argmax(count), np.arange(len(kinds)))[kind.ravel()]
        found += [some[place == cell] for cell in np.unique(place)]
    return found


class _Fit:
    """The regression on a region's points, at rest (m, 3); root: (3m, z) how they move, of unit covariance."""

    def __init__(self, rest: Array, root: Array) -> None:
        motion = rigid_motions(rest, rest.mean(axis=0), 1.0)
        inverse = np.linalg.pinv(motion, rcond=SEEN)
        left, size, _ = np.linalg.svd(motion, full_matrices=True)
        across = left[:, np.count_nonzero(size > SEEN * size[0]) :]
        gradient = np.zeros((9, motion.shape[1]))
        gradient[:, 3:] = rigid_gradients()
        self.rigid = gradient @ inverse  # (9, 3m)
        self.root = root
        self.across = across.T
        self.inverse = np.linalg.pinv(across.T @ root, rcond=SEEN**0.5)

    def slope(self, gradient: Array) -> Array:
        """E (9, 3m) for the gradient's (9, z) regression."""
        return self.rigid + (gradient - self.rigid @ self.root) @ self.inverse @ self.across


def _mean_gradient(
    grid: Grid, voxels: NDArray[np.int32], element: Superelement, place: NDArray[np.integer], tangent: Sequence[Array]
) -> Array:
    """(9, c) mean of the gradients of the element's fields over voxels of one material, along the grid's axes.

    From differences to neighbours of that material. An axis along which there are none is free of stress.
    """
    shares = [_difference(grid, voxels, axis) for axis in range(3)]
    known = np.array([share is not None for share in shares])
    found = np.zeros((3, 3, element.moved.shape[2]))
    for axis, share in enumerate(shares):
        if share is not None:
            rows = np.flatnonzero(share)
            found[:, axis] = np.tensordot(share[rows], element.moved[place[rows]], 1)
    flat, given = found.reshape(9, -1), np.tile(known, 3)
    if not known.all():
        C = tangent[grid.material[voxels[0]]]
        flat[~given] = -np.linalg.pinv(C[np.ix_(~given, ~given)], rcond=SEEN) @ C[np.ix_(~given, given)] @ flat[given]
    return flat


def _difference(grid: Grid, voxels: NDArray[np.int32], axis: int) -> Array | None:
    """(n,) what each voxel's displacement counts in the mean slope along an axis [1/m], None for none."""
    near = []
    for side in (1, -1):
        index = grid.index[voxels] + 1
        index[:, axis] += side
        other = grid.padded[tuple(index.T)]
        alike = (other >= 0) & (grid.material[other] == grid.material[voxels])
        near.append(np.where(alike, other, voxels))
    steps = (near[0] != voxels).astype(int) + (near[1] != voxels)
    if not steps.any():
        return None
    share = np.zeros(len(grid.index))
    each = np.divide(1, steps, out=np.zeros(len(steps)), where=steps > 0) / (
        grid.spacing[axis] * np.count_nonzero(steps)
    )
    np.add.at(share, near[0], each)
    np.add.at(share, near[1], -each)
    return share


def rigid_gradients() -> Array:
    """(9, 3) of the rotations by 1 rad about each axis: u = e × p, row 3a + b for ∂u_a/∂p_b."""
    return np.stack([np.cross(axis, np.eye(3)).T.ravel() for axis in np.eye(3)], axis=1)


def _root(stiffness: Array, basis: Array) -> Array:
    """(3k, z) with its product with its transpose K⁺ [m/N], of motions in the span of `basis`."""
    matrix = basis.T @ stiffness @ basis
    scale = 1 / np.sqrt(np.maximum(np.diagonal(matrix), np.finfo(float).tiny))
    value, vector = np.linalg.eigh(matrix * scale * scale[:, None])
    kept = value > SEEN * value[-1]
    return basis @ (scale[:, None] * vector[:, kept]) / np.sqrt(value[kept])


def _quadratic(volume: Array, material: NDArray[np.int64], slope: Array, tangent: Sequence[Array]) -> Array:
    """Σ_q V_q E_qᵀ C E_q (3m, 3m) [N/m] of a region."""
    size = slope.shape[2]
    found = np.zeros((size, size))
    for V, number, E in zip(volume, material, slope, strict=True):
        found += V * E.T @ tangent[number] @ E
    return found


def _split(matrix: Array, control: ControlPoints, regions: Sequence[NDArray[np.int64]]) -> list[Array]:
    """Positive semi-definite parts (3m, 3m), one a region, of a positive semi-definite (3k, 3k) matrix."""
    rest, parts = matrix.copy(), []
    for points in reversed(regions):
        child = control.frame[points] == control.frame[points[-1]]
        own, all_ = degrees(points[child]), degrees(points)
        value, vector = np.linalg.eigh(rest[np.ix_(own, own)])
        kept = value > SEEN * max(value[-1], 0)
        reach = (vector[:, kept] / np.sqrt(value[kept])).T @ rest[np.ix_(own, all_)]
        parts.append(reach.T @ reach)
        rest[np.ix_(all_, all_)] -= parts[-1]
    return parts[::-1]
