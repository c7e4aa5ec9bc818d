"""Cells of the whole body's regions, where a hyperelastic law is evaluated: how much of its stiffness is the law's.

A region's energy, with y = Rᵀ x − x̄ of its control points and R its rotation, is

    W = Σ_q V_q ψ(I + E_q y) + ½ yᵀ K_r y,      K_i = K_r + Σ_q V_q E_qᵀ C E_q at rest

so that it answers small loads as the finite elements do, whatever the law, and large strains as the law does. C is the
law's tangent at rest. A cell q is all of one material in a region: more of them, each with a volume to keep, would lock
where the law resists that. E_q is the regression of
the mean over it of the displacement's gradient, ∇N̂ x of the superelement, on the region's own points, x ~ N(0, K⁺),
exact for rigid motions, others that cost nothing and uniform strains of the whole body:

    E = T M⁺ + ⟨g zᵀ⟩ ⟨z zᵀ⟩⁺ Zᵀ,   z = Zᵀ x,   Zᵀ M = 0,   g = ∇N̂ x − T M⁺ x

for these motions M and their gradients T, those of N̂ M. A mean's energy is less than the mean energy, so that
Σ_q V_q E_qᵀ C E_q ⪯ K but for what the region's points alone do not know. V_q is a cell's volume times a share ≤ 1 that
keeps the rest of K positive: where a motion costs more than K allows for, the cells that it costs most lose most. The
rest is split into one K_r a region as K was (`selection`): the frames are eliminated from the last one
on, and a frame's own block with what it couples to is its region's; all are positive semi-definite, and sum up to K.
What a material has of the rest (elasticity/shares.py) is what it has of K less its cells, made positive semi-definite
frame by frame, as cells may have more of one material than K has.
Index letters: v voxel; q cell; e region.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from mjframes.base.linear import ZERO, scaled_eigenvectors
from mjframes.base.rigid import motion_basis, rigid_motions, size_of
from mjframes.base.rows import members_of
from mjframes.elasticity.laws import LawParameters, hessian
from mjframes.elasticity.shares import by_material, factor_of
from mjframes.elasticity.stiffness import Stiffness, blind_to_translations
from mjframes.kinematics.control import ControlPoints
from mjframes.volume.grid import Grid
from mjframes.whole_body.selection import split
from mjframes.whole_body.superelement import Superelement, degrees, frame_motions
from mjframes.whole_body.weight_correction import assembled

Array = NDArray[np.float64]

MOST = 4  # cells of a region, those of the largest stiffness times volume; what others resist with stays in K_r
ROUNDS = 200  # in which cells lose volume
SLACK = 0.01  # [-] by which the largest energy may exceed what K allows before all cells lose the rest alike
SEEN = 1e-10  # [-] eigenvalue of a scaled matrix that counts as zero


@dataclass(frozen=True, eq=False)
class Cells:
    """The cells of r regions; m is the number of a region's control points, q that of its cells.

    volume: (q,) V_q, the cells' volumes times s [m³].
    material: (q,) places in the grid's table.
    slope: (q, 9, 3m) E_q [1/m], row 3a + b for ∂u_a/∂p_b, in volume coordinates.
    remainder: (3m, 3m) K_r [N/m].
    shares: (p, 3o, 3m) what each material but the last has of its rows [N/m], see elasticity/shares.py.
    """

    volume: tuple[Array, ...]
    material: tuple[NDArray[np.int64], ...]
    slope: tuple[Array, ...]
    remainder: tuple[Array, ...] = field(metadata={"symmetric": True})
    shares: tuple[Array, ...]

    def stiffened(self, before: Stiffness, after: Stiffness) -> Cells:
        """Return them where the regions became stiffer than they were before."""
        added = (new - old for new, old in zip(after.matrix, before.matrix, strict=True))
        return replace(self, remainder=tuple(K + more for K, more in zip(self.remainder, added, strict=True)))


def cells(
    grid: Grid,
    control: ControlPoints,
    types: Sequence[str],
    held: int,
    element: Superelement,
    stiffness: Stiffness,
    region: NDArray[np.int32],
    place: NDArray[np.integer],
    laws: Sequence[LawParameters],
    bones: int,
) -> Cells:
    """Return the cells of all regions.

    types: (f,) of the frames, of which the first `held` are held.  stiffness: of the regions.  region: (n,) of each
    voxel.  place: (n,) which of the element's places each voxel is.  laws: of each material of the grid's table.
    bones: how many regions, the last ones, only keep a frame in shape.
    """
    total = assembled(stiffness, len(control.frame))
    basis = frame_motions(control, types, control.rest, held)
    root, idle = _motions(total, basis, control.rest)
    kept = np.hstack([idle, basis @ (basis.T @ _uniform_strains(control.rest))])
    followed = element.lifting @ np.hstack([kept, root])
    turned = np.kron(grid.axes, grid.axes)
    allowed = basis @ basis.T
    tangent = [hessian(law, np.eye(3)[None])[0] for law in laws]
    volume, material, slope = [], [], []
    for voxels, points in zip(members_of(region, len(stiffness.points)), stiffness.points, strict=True):
        some = _members(grid, voxels)
        dof = degrees(points)
        fit = _Fit.of(control.rest[points], kept[dof], root[dof])
        volume.append(np.array([len(cell) * grid.cell_volume for cell in some]))
        material.append(np.array([grid.material[cell[0]] for cell in some], np.int64))
        slope.append(
            np.array(
                [fit.slope(turned @ _mean_gradient(grid, cell, element, place, tangent) @ followed) for cell in some]
            ).reshape(len(some), 9, len(dof))
            @ allowed[np.ix_(dof, dof)]
        )
    strains = [  # of unit motions, with their product with themselves the energy
        np.linalg.cholesky(tangent[number] + SEEN * tangent[number].max() * np.eye(9)).T @ E @ root[degrees(points)]
        for points, numbers, slopes in zip(stiffness.points, material, slope, strict=True)
        for number, E in zip(numbers, slopes, strict=True)
    ]
    ends = np.cumsum([len(V) for V in volume])[:-1]
    volume = np.split(_affordable(np.concatenate(volume), np.array(strains)), ends)
    shared = len(stiffness.points) - bones
    rest = _without_cells(stiffness, shared, factor_of(grid.table), tangent, volume, material, slope, total)
    parts = split(rest, np.diagonal(total), control, stiffness.points[:shared])
    remainder = [*(matrix for matrix, _ in parts), *stiffness.matrix[shared:]]
    return Cells(
        volume=tuple(volume),
        material=tuple(material),
        slope=tuple(slope),
        remainder=tuple(map(blind_to_translations, remainder)),
        shares=(*(shares for _, shares in parts), *stiffness.shares[shared:]),
    )


def _without_cells(
    stiffness: Stiffness,
    shared: int,
    factor: NDArray[np.int64],
    tangent: Sequence[Array],
    volume: Sequence[Array],
    material: Sequence[NDArray[np.int64]],
    slope: Sequence[Array],
    total: Array,
) -> Array:
    """(M, 3k, 3k) what each material has of the first `shared` regions' stiffness, less that of all cells at rest."""
    rest = np.zeros((factor.max() + 1, *total.shape))
    for e, points in enumerate(stiffness.points):
        every = np.ix_(degrees(points), degrees(points))
        if e < shared:
            for m, matrix in enumerate(by_material(stiffness.matrix[e], stiffness.shares[e])):
                rest[m][every] += matrix
        for V, number, E in zip(volume[e], material[e], slope[e], strict=True):
            rest[factor[number]][every] -= V * E.T @ tangent[number] @ E
    return rest


def _members(grid: Grid, voxels: NDArray[np.int32]) -> list[NDArray[np.int32]]:
    """The voxels of each cell of a region."""
    soft = voxels[grid.piece[voxels] < 0]
    stiff = np.bincount(grid.material[soft], grid.young[soft], len(grid.table))
    chosen = np.sort(np.argsort(-stiff, kind="stable")[:MOST])
    return [soft[grid.material[soft] == number] for number in chosen if stiff[number] > 0]


@dataclass(frozen=True, eq=False)
class _Fit:
    """The regression on a region's m points, of gradients first in `kept`, then in `root`, motions of the points.

    rigid: (9, 3m) T M⁺ of rigid motions.
    kept: (3m, i).
    of_kept: (i, 3m) its inverse, blind to rigid motions.
    root: (3m, z) of unit, independent motions.
    of_root: (z, 3m) their regression, blind to all others.
    """

    rigid: Array
    kept: Array
    of_kept: Array
    root: Array
    of_root: Array

    @staticmethod
    def of(rest: Array, kept: Array, root: Array) -> _Fit:
        """Return that for points at rest (m, 3)."""
        size = size_of(rest)
        motion = rigid_motions(rest, rest.mean(axis=0), size)
        gradient = np.zeros((9, 6))
        for axis in range(3):  # u = e × p / size
            gradient[:, 3 + axis] = np.cross(np.eye(3)[axis], np.eye(3)).T.ravel() / size
        inverse, relative = _inverse(motion, np.eye(len(motion)))
        of_kept, others = _inverse(kept, relative)
        return _Fit(gradient @ inverse, kept, of_kept, root, _inverse(root, others)[0])

    def slope(self, gradient: Array) -> Array:
        """Return E (9, 3m) from the gradients (9, i + z) of these motions."""
        kept, root = np.split(gradient, [self.kept.shape[1]], axis=1)
        found = self.rigid + (kept - self.rigid @ self.kept) @ self.of_kept
        return found + (root - found @ self.root) @ self.of_root


def _inverse(motion: Array, seen: Array) -> tuple[Array, Array]:
    """The pseudo-inverse (i, 3m) of motions (3m, i) as far as the orthonormal rows `seen` (s, 3m) see them, and those
    combinations of these rows that see none of them.
    """
    left, size, right = np.linalg.svd(seen @ motion, full_matrices=True)
    least = max(SEEN**0.5 * size.max(initial=0), SEEN * np.linalg.norm(motion))
    rank = np.count_nonzero(size > least)
    inverse = (right[:rank].T / size[:rank]) @ left[:, :rank].T @ seen
    return np.asarray(inverse, np.float64), np.asarray(left[:, rank:].T @ seen, np.float64)


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
        C = tangent[int(grid.material[voxels[0]])]
        flat[~given] = -np.linalg.pinv(C[np.ix_(~given, ~given)], rcond=SEEN) @ C[np.ix_(~given, given)] @ flat[given]
    return flat


def _difference(grid: Grid, voxels: NDArray[np.int32], axis: int) -> Array | None:
    """(n,) what each voxel's displacement counts in the mean slope along an axis [1/m], None for none."""
    near = []
    for side in (1, -1):
        other = grid.beside(side * np.eye(3, dtype=np.int32)[axis], voxels)
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


def _motions(stiffness: Array, basis: Array, rest: Array) -> tuple[Array, Array]:
    """Of motions in the span of `basis`: a root of K⁺ (3k, z), its product with its transpose, and (3k, i) those that
    cost nothing but are not rigid.
    """
    value, vector = scaled_eigenvectors(basis.T @ stiffness @ basis)
    vector = basis @ vector
    kept = value > ZERO * value[-1]
    rigid = motion_basis(rest)
    free = np.linalg.qr(vector[:, ~kept])[0]
    idle, length, _ = np.linalg.svd(free - rigid @ (rigid.T @ free), full_matrices=False)
    return vector[:, kept] / np.sqrt(value[kept]), idle[:, length > SEEN**0.5]


def _uniform_strains(rest: Array) -> Array:
    """(3k, 6) the motions of points (k, 3) by strains along and across the axes."""
    offset = (rest - rest.mean(axis=0)) / size_of(rest)
    eye = np.eye(3)
    strains = [np.outer(eye[a], eye[b]) + np.outer(eye[b], eye[a]) for a in range(3) for b in range(a + 1)]
    return np.stack([(offset @ strain).ravel() for strain in strains], axis=1)


def _affordable(volume: Array, strain: Array) -> Array:
    """V_q (q,) of cells with these volumes whose energies Σ_q V_q |strain_q z|² (q, 9, z) do not exceed |z|²."""
    largest = 1.0
    for _ in range(ROUNDS):
        flat = (np.sqrt(volume)[:, None, None] * strain).reshape(-1, strain.shape[2])
        value, vector = np.linalg.eigh(flat @ flat.T)
        largest = max(1.0, value[-1])
        if largest <= 1 + SLACK:
            break
        cost = np.sum(vector[:, -1].reshape(len(volume), -1) ** 2, axis=1)  # of each cell in the costliest motion
        volume = volume * (1 - (1 - 1 / largest) * cost / cost.max())
    return volume / largest
