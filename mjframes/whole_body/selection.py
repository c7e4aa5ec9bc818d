"""A region a frame: the superelement split along the frames' tree by covariance selection (in place of §5.3's samples).

Eliminate the frames from the leaves up; pa(i) are the frames that are coupled to i by then, all of them its ancestors
or held. With S_T the stiffness condensed to the frames of T, all others free,

    K ≈ Σ_i K_i,   K_i = S_{i ∪ pa(i)} − S_{pa(i)} = [−β, 1]ᵀ C [−β, 1]

where C is the block of S_{i ∪ pa(i)} that belongs to i, and β the motion of i that goes with its parents': what frame i
adds, given its parents. The sum has the exact compliance on every clique i ∪ pa(i) (Dempster, Covariance selection,
1972; Vecchia's approximation of Gaussian fields); each K_i is positive semi-definite and blind to rigid motions, and β
is put right for these to the last digit. K_i has the rank of C: its last rows, those of i's own points, make all of it,
Rᵀ C⁻¹ R. What a material has of S_T is, to first order, its part of the energy of how T is followed, and of K_i the
rows of it (elasticity/shares.py). Index letters: i frame; j, k control point; m material.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mjframes.base.rigid import rigid_motions, size_of
from mjframes.kinematics.control import ControlPoints
from mjframes.whole_body.superelement import degrees, scaled_eigenvectors

Array = NDArray[np.float64]

LOOSE = 1e-11  # [-] eigenvalue of a scaled stiffness that counts as zero; rounding leaves about 1e-15


@dataclass(frozen=True, eq=False)
class Part:
    """What one frame adds.

    points: (m,) control points, those of its parents first.
    matrix: (3m, 3m) K_i [N/m].
    shares: (p, 3o, 3m) what p materials have of the rows of its own o points [N/m].
    """

    points: NDArray[np.int64]
    matrix: Array
    shares: Array


def families(coupled: Iterable[NDArray[np.integer]], frames: int) -> list[list[int]]:
    """Return pa(i) of each of `frames` frames, ascending, numbered so that parents come before children.

    coupled: sets of frames that share a voxel.
    """
    parents: list[set[int]] = [set() for _ in range(frames)]
    for members in (some.tolist() for some in coupled):
        for i in members:
            parents[i] |= {j for j in members if j < i}
    for i in reversed(range(frames)):  # eliminating i couples its parents
        if parents[i]:
            last = max(parents[i])
            parents[last] |= parents[i] - {last}
    return [sorted(some) for some in parents]


def select(matrix: Array, control: ControlPoints, parents: Sequence[Sequence[int]], shares: Array) -> list[Part]:
    """Return K_i of each frame whose parents are given, from K (3k, 3k).  shares: (p, 3k, 3k) of it."""
    points = [np.flatnonzero(np.isin(control.frame, [*some, i])) for i, some in enumerate(parents)]
    return [
        _part(some, S, control.rest[some], int(np.count_nonzero(control.frame[some] == i)))
        for i, (some, S) in enumerate(zip(points, _condense(np.stack([matrix, *shares]), points), strict=True))
    ]


def _condense(matrices: Array, sets: list[NDArray[np.int64]]) -> list[Array]:
    """S_T, and its shares, for the points of each T: half of the sets at a time, so that what none of them needs goes
    early.
    """
    if len(sets) == 1:
        return [_schur(matrices, degrees(sets[0]))]
    found: list[Array] = []
    for some in (sets[: len(sets) // 2], sets[len(sets) // 2 :]):
        union = np.unique(np.concatenate(some))
        found += _condense(_schur(matrices, degrees(union)), [np.searchsorted(union, points) for points in some])
    return found


def _schur(matrices: Array, kept: NDArray[np.int64]) -> Array:
    """The stiffness of the degrees of freedom `kept`, all others free, and its shares: the energies of how these
    follow.  matrices: the stiffness (3k, 3k), then its shares.
    """
    free = np.setdiff1d(np.arange(matrices.shape[1]), kept)
    some = matrices[:, kept[:, None], kept]
    if not len(free):
        return some
    coupling, block = matrices[:, free[:, None], kept], matrices[:, free[:, None], free]
    follow = _solve(block[0], coupling[0])
    crossed = coupling.transpose(0, 2, 1) @ follow
    condensed = some - crossed
    condensed[1:] += follow.T @ block[1:] @ follow - crossed[1:].transpose(0, 2, 1)
    return (condensed + condensed.transpose(0, 2, 1)) / 2


def _solve(matrix: Array, right: Array) -> Array:
    """K⁺ times `right`: what has no stiffness does not move."""
    value, vector = scaled_eigenvectors(matrix)
    kept = value > LOOSE * value[-1]
    basis = vector[:, kept]
    return basis @ ((basis.T @ right) / value[kept, None])


def _part(points: NDArray[np.int64], condensed: Array, rest: Array, own: int) -> Part:
    """[−β, 1]ᵀ C [−β, 1] of the last `own` points, from S_{i ∪ pa(i)}, its shares, and all points at rest (m, 3)."""
    n = condensed.shape[1] - 3 * own
    block = condensed[0, n:, n:]
    value, vector = np.linalg.eigh(block)
    block = (vector * np.maximum(value, 0)) @ vector.T
    # about the parents' middle, so that translations are met whatever rotations their points can show
    motion = rigid_motions(rest, rest[: n // 3 or None].mean(axis=0), size_of(rest))
    follow = -_solve(block, condensed[0, n:, :n])
    shares = condensed[1:, n:].copy()
    if n:
        carried = np.linalg.pinv(motion[:n], rcond=1e-9)
        follow += (motion[n:] - follow @ motion[:n]) @ carried
        relative = np.hstack([-follow, np.eye(3 * own)])
        shares[:, :, :n] -= shares @ motion @ carried
    else:
        relative = np.eye(3 * own) - motion @ np.linalg.pinv(motion, rcond=1e-9)
        shares = relative.T @ shares @ relative
    added = relative.T @ block @ relative
    return Part(points, (added + added.T) / 2, shares)
