"""A region a frame: the superelement split along the frames' tree by covariance selection (in place of §5.3's samples).

Eliminate the frames from the leaves up; pa(i) are the frames that are coupled to i by then, all of them its ancestors
or held. With S_T the stiffness condensed to the frames of T, all others free,

    K ≈ Σ_i K_i,   K_i = S_{i ∪ pa(i)} − S_{pa(i)} = [−β, 1]ᵀ C [−β, 1]

where C is the block of S_{i ∪ pa(i)} that belongs to i, and β the motion of i that goes with its parents': what frame i
adds, given its parents. The sum has the exact compliance on every clique i ∪ pa(i) (Dempster, Covariance selection,
1972; Vecchia's approximation of Gaussian fields); each K_i is positive semi-definite and blind to rigid motions, and β
is put right for these to the last digit. Index letters: i frame; j, k control point.
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
    """

    points: NDArray[np.int64]
    matrix: Array


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


def select(matrix: Array, control: ControlPoints, parents: Sequence[Sequence[int]]) -> list[Part]:
    """Return K_i of each frame whose parents are given, from K (3k, 3k)."""
    points = [np.flatnonzero(np.isin(control.frame, [*some, i])) for i, some in enumerate(parents)]
    condensed = _condense(matrix, points)
    return [
        Part(some, _added(S, control.rest[some], int(np.count_nonzero(control.frame[some] == i))))
        for i, (some, S) in enumerate(zip(points, condensed, strict=True))
    ]


def _condense(matrix: Array, sets: list[NDArray[np.int64]]) -> list[Array]:
    """S_T for the points of each T: half of the sets at a time, so that what none of them needs goes early."""
    if len(sets) == 1:
        return [_schur(matrix, degrees(sets[0]))]
    found: list[Array] = []
    for some in (sets[: len(sets) // 2], sets[len(sets) // 2 :]):
        union = np.unique(np.concatenate(some))
        found += _condense(_schur(matrix, degrees(union)), [np.searchsorted(union, points) for points in some])
    return found


def _schur(matrix: Array, kept: NDArray[np.int64]) -> Array:
    """The stiffness of the degrees of freedom `kept`, all others free."""
    free = np.setdiff1d(np.arange(len(matrix)), kept)
    if not len(free):
        return matrix[np.ix_(kept, kept)]
    coupling = matrix[np.ix_(free, kept)]
    condensed = matrix[np.ix_(kept, kept)] - coupling.T @ _solve(matrix[np.ix_(free, free)], coupling)
    return (condensed + condensed.T) / 2


def _solve(matrix: Array, right: Array) -> Array:
    """K⁺ times `right`: what has no stiffness does not move."""
    value, vector = scaled_eigenvectors(matrix)
    kept = value > LOOSE * value[-1]
    basis = vector[:, kept]
    return basis @ ((basis.T @ right) / value[kept, None])


def _added(condensed: Array, rest: Array, own: int) -> Array:
    """[−β, 1]ᵀ C [−β, 1] of the last `own` points, from S_{i ∪ pa(i)} and all points at rest (m, 3)."""
    n = len(condensed) - 3 * own
    block = condensed[n:, n:]
    value, vector = np.linalg.eigh(block)
    block = (vector * np.maximum(value, 0)) @ vector.T
    # about the parents' middle, so that translations are met whatever rotations their points can show
    motion = rigid_motions(rest, rest[: n // 3 or None].mean(axis=0), size_of(rest))
    follow = -_solve(block, condensed[n:, :n])
    if n:
        follow += (motion[n:] - follow @ motion[:n]) @ np.linalg.pinv(motion[:n], rcond=1e-9)
        relative = np.hstack([-follow, np.eye(3 * own)])
    else:
        relative = np.eye(3 * own) - motion @ np.linalg.pinv(motion, rcond=1e-9)
    added = relative.T @ block @ relative
    return (added + added.T) / 2
