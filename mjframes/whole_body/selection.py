"""A region a frame: the superelement split by covariance selection (in place of §5.3's samples).

Eliminate the frames one by one; pa(i) are the frames that are coupled to i by then (`families`). With S_T the stiffness
condensed to the frames of T, all others free,

    K ≈ Σ_i K_i,   K_i = S_{i ∪ pa(i)} − S_{pa(i)} = [−β, 1]ᵀ C [−β, 1]

where C is the block of S_{i ∪ pa(i)} that belongs to i, and β the motion of i that goes with its parents': what frame i
adds, given its parents. The sum K̂ has the exact compliance on every clique i ∪ pa(i) (Dempster, Covariance selection,
1972; Vecchia's approximation of Gaussian fields); each K_i is positive semi-definite and blind to rigid motions.

K_i alone is blind to strains of the parents that the child follows. Turned together with its parents' image, a region
would have shapes without energy that are far from rest, and bodies would stay in them. So a part of the energy is that
of frame i and its closest parent p(i), all others free, in the region of i; of f frames

    K̂ = Σ_i (K̃_i + ε S_{i, p(i)}),   ε = PAIRED / f

S_T ⪯ K̂ for every T, so that Σ_i ε S_{i, p(i)} ⪯ K̂, and K̃_i splits the rest as K_i does K̂. A pair is a short way apart,
so that its energy is right at large rotations, too. What a material has of S_T is, to first order, its part of the
energy of how T is followed, and of a region the rows of it that belong to i's own points (elasticity/shares.py).
Index letters: i frame; j, k control point; m material.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mjframes.base.linear import nonzero_eigenvectors
from mjframes.base.rigid import rigid_motions, size_of
from mjframes.elasticity.shares import by_material
from mjframes.kinematics.control import ControlPoints
from mjframes.whole_body.superelement import degrees

Array = NDArray[np.float64]

PAIRED = 0.5  # [-] of the energy; at ¼ some bodies stay crumpled, at 1 a strip bent by its weight is a fifth too stiff
ROUNDING = 1e-10  # [-] eigenvalue of a part of K, to the diagonal of K, that counts as zero
ON_A_LINE = 1e-9  # [-] singular value of rigid motions, to the largest, of those that points on a line do not show


@dataclass(frozen=True, eq=False)
class Part:
    """The stiffness of one frame's region.

    frame: the child.
    points: (m,) control points, frame by frame in the order of elimination, those of its parents first.
    matrix: (3m, 3m) [N/m].
    shares: (p, 3o, 3m) what p materials have of the rows of its own o points [N/m].
    """

    frame: int
    points: NDArray[np.int64]
    matrix: Array
    shares: Array


def select(matrix: Array, control: ControlPoints, parents: Mapping[int, Sequence[int]], shares: Array) -> list[Part]:
    """Return the region of each frame, in the order of `parents`, from K (3k, 3k).

    parents: of each frame, which come before it.  shares: (p, 3k, 3k) of K.
    """
    own = [np.flatnonzero(control.frame == i) for i in parents]
    place = {i: number for number, i in enumerate(parents)}  # of all regions the same, so that a pair has one order
    members = [[*sorted(some, key=place.__getitem__), i] for i, some in parents.items()]
    points = [np.concatenate([own[place[j]] for j in some]) for some in members]
    cliques = _condense(np.stack([matrix, *shares]), points)
    given = [
        _part(i, some, S, control.rest[some], len(last))
        for i, some, S, last in zip(parents, points, cliques, own, strict=True)
    ]
    rest = np.zeros((1 + len(shares), *matrix.shape))  # by material
    for part in given:
        every = degrees(part.points)
        rest[:, every[:, None], every] += by_material(part.matrix, part.shares)
    scale, pairs = np.diagonal(rest.sum(axis=0)).copy(), []
    for part, clique in zip(given, cliques, strict=True):
        pair = degrees(_pair(part, control))
        S = PAIRED / len(given) * _schur(clique, pair)
        every = degrees(part.points)[pair]
        rest[:, every[:, None], every] -= np.stack([*S[1:], S[0] - S[1:].sum(axis=0)])
        pairs.append((pair, S))
    parts = zip(given, split(rest, scale, control, points), pairs, strict=True)
    return [_with_pair(part, control, *remainder, *pair) for part, remainder, pair in parts]


def _pair(part: Part, control: ControlPoints) -> NDArray[np.int64]:
    """The places among a region's points of those of its frame and of the parent that this is coupled to most."""
    frame = control.frame[part.points]
    own = frame == frame[-1]
    coupling = np.abs(part.matrix).reshape(len(frame), 3, len(frame), 3).sum(axis=(1, 3))[own].sum(axis=0)
    of_frame = np.bincount(frame, np.where(own, 0, coupling))
    return np.flatnonzero(own | (frame == (np.argmax(of_frame) if not own.all() else -1)))


def _with_pair(
    part: Part, control: ControlPoints, matrix: Array, shares: Array, at: NDArray[np.int64], S: Array
) -> Part:
    """The region with the energy S, and its shares, of the degrees of freedom `at`."""
    matrix, own = matrix.copy(), shares.shape[1]
    matrix[np.ix_(at, at)] += S[0]
    of_pair = np.zeros((len(shares), *matrix.shape))
    of_pair[:, at[:, None], at] = S[1:]
    rest = control.rest[part.points]
    blind = _blind(rigid_motions(rest, rest.mean(axis=0), size_of(rest)))  # but for rounding the matrix is
    matrix = blind @ matrix @ blind
    return Part(part.frame, part.points, (matrix + matrix.T) / 2, (shares + of_pair[:, len(matrix) - own :]) @ blind)


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
    value, basis = nonzero_eigenvectors(matrix)
    return basis @ ((basis.T @ right) / value[:, None])


def _part(frame: int, points: NDArray[np.int64], condensed: Array, rest: Array, own: int) -> Part:
    """[−β, 1]ᵀ C [−β, 1] of the frame of the last `own` points, from S_{i ∪ pa(i)}, its shares, and rest (m, 3)."""
    n = condensed.shape[1] - 3 * own
    block = condensed[0, n:, n:]
    value, vector = np.linalg.eigh(block)
    block = (vector * np.maximum(value, 0)) @ vector.T
    # about the parents' middle, so that translations are met whatever rotations their points can show
    motion = rigid_motions(rest, rest[: n // 3 or None].mean(axis=0), size_of(rest))
    follow = -_solve(block, condensed[0, n:, :n])
    shares = condensed[1:, n:].copy()
    if n:
        carried = np.linalg.pinv(motion[:n], rcond=ON_A_LINE)
        follow += (motion[n:] - follow @ motion[:n]) @ carried
        relative = np.hstack([-follow, np.eye(3 * own)])
        shares[:, :, :n] -= shares @ motion @ carried
    else:
        relative = _blind(motion)
        shares = relative.T @ shares @ relative
    added = relative.T @ block @ relative
    return Part(frame, points, (added + added.T) / 2, shares)


def _blind(motion: Array) -> Array:
    """The projection (3m, 3m) that takes out motions (3m, 6), which may depend on each other."""
    return np.eye(len(motion)) - motion @ np.linalg.pinv(motion, rcond=ON_A_LINE)


def split(
    matrices: Array, scale: Array, control: ControlPoints, regions: Sequence[NDArray[np.int64]]
) -> list[tuple[Array, Array]]:
    """Return positive semi-definite parts (3m, 3m), one a region, of a positive semi-definite matrix, and their shares.

    The frames are eliminated from the last one on, and a frame's own block with what it couples to is its region's.
    matrices: (M, 3k, 3k) what each material has of it.  scale: (3k,) the diagonal of K, of which it is a part.
    regions: (m,) control points of each, the child's last; parents come before their children.
    """
    rest, by_one, parts = matrices.sum(axis=0), matrices.copy(), []
    for points in reversed(regions):
        own, every = degrees(points[control.frame[points] == control.frame[points[-1]]]), degrees(points)
        others = every[: len(every) - len(own)]
        value, vector = np.linalg.eigh(rest[np.ix_(own, own)])
        kept = value > ROUNDING * scale[own].max()
        root = vector[:, kept] * np.sqrt(value[kept])  # of the own block C
        inverse = vector[:, kept] / np.sqrt(value[kept])
        reach = inverse.T @ rest[np.ix_(own, every)]
        follow = -inverse @ reach[:, : len(others)]
        rows = by_one[:, own[:, None], every]
        crossed = rows[:, :, : len(others)].transpose(0, 2, 1) @ follow
        by_one[:, others[:, None], others] += crossed + crossed.transpose(0, 2, 1)
        by_one[:, others[:, None], others] += follow.T @ rows[:, :, len(others) :] @ follow
        parts.append((reach.T @ reach, _positive(rows, follow, root, inverse)[:-1]))
        rest[np.ix_(every, every)] -= parts[-1][0]
    return parts[::-1]


def _positive(rows: Array, follow: Array, root: Array, inverse: Array) -> Array:
    """Rows [Y_m, C_m] (M, o, o') of all materials with C_m made positive semi-definite, their sum the same.

    follow: F = −C⁺ Y of the sum, C = root rootᵀ.  inverse: of the root. Y_m + C_m F, how other moduli change F, stays.
    """
    n = follow.shape[1]
    value, vector = np.linalg.eigh(inverse.T @ rows[:, :, n:] @ inverse)
    positive = (vector * np.maximum(value, 0)[:, None]) @ vector.transpose(0, 2, 1)
    size, axes = np.linalg.eigh(positive.sum(axis=0))  # ⪰ 1
    back = axes / np.sqrt(size) @ axes.T
    own = root @ back @ positive @ back @ root.T
    onto = inverse @ root.T  # what does not move C does not count
    change = onto.T @ (rows[:, :, :n] + rows[:, :, n:] @ follow)
    return np.concatenate([change - own @ follow, own], axis=2)
