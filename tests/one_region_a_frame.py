"""Soft bodies with one region a frame, K_i = S_{i ∪ pa(i)} − S_{pa(i)}: what frame i adds to its parents pa(i).

S_T is the whole body's stiffness condensed to the frames of T, all others free; the parents are the frames before i
that elimination from the last frame to the first couples to it. Dense: for small bodies.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mjframes.body import SoftBody
from mjframes.rotations import with_rotations
from mjframes.stiffness import Stiffness, blind_to_translations

SINGULAR = 1e-10  # [-] eigenvalue, to the largest, that counts as zero


def one_region_a_frame(body: SoftBody) -> SoftBody:
    """The same body with other regions; points of frames that nothing strains, given their parents, have none."""
    frame, total = body.control.frame, dense_stiffness(body)
    points, matrices = [], []
    for i, parents in enumerate(parents_of(body)):
        child, above = np.flatnonzero(frame == i), np.flatnonzero(np.isin(frame, parents))
        matrix = condensed(total, dofs(np.append(above, child)))
        matrix[: 3 * len(above), : 3 * len(above)] -= condensed(total, dofs(above))
        if i >= body.held and np.abs(matrix).max() > SINGULAR * np.abs(total).max():
            points.append(np.append(above, child))
            matrices.append(blind_to_translations(positive(matrix)))
    stiffness = Stiffness(tuple(points), (), tuple(matrices), np.zeros(len(points)))
    region = regions_of_voxels(body, [set(frame[some].tolist()) for some in points])
    return replace(
        body,
        stiffness=with_rotations(stiffness, body.control),
        fit_error=np.zeros(len(points)),
        fields=replace(body.fields, region=region),
    )


def dense_stiffness(body: SoftBody) -> np.ndarray:
    """K (3k, 3k) at rest."""
    total = np.zeros((3 * len(body.control.frame),) * 2)
    for points, matrix in zip(body.stiffness.points, body.stiffness.matrix, strict=True):
        total[np.ix_(dofs(points), dofs(points))] += matrix
    return total


def parents_of(body: SoftBody) -> list[list[int]]:
    """Of each frame, ascending."""
    coupled: list[set[int]] = [set() for _ in body.types]
    for points in body.stiffness.points:
        frames = set(body.control.frame[points].tolist())
        for i in frames:
            coupled[i] |= {j for j in frames if j < i}
    for i in range(len(coupled) - 1, -1, -1):
        for j in coupled[i]:
            coupled[j] |= {other for other in coupled[i] if other < j}
    return [sorted(frames) for frames in coupled]


def dofs(points: np.ndarray) -> np.ndarray:
    return (3 * points[:, None] + np.arange(3)).ravel()


def condensed(total: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """The Schur complement of K on the degrees of freedom `kept`."""
    others = np.setdiff1d(np.arange(len(total)), kept)
    inverse = np.linalg.pinv(total[np.ix_(others, others)], rcond=SINGULAR, hermitian=True)
    across = total[np.ix_(kept, others)]
    return total[np.ix_(kept, kept)] - across @ inverse @ across.T


def positive(matrix: np.ndarray) -> np.ndarray:
    """The same without negative eigenvalues, which are rounding."""
    values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
    return (vectors * values.clip(0)) @ vectors.T


def regions_of_voxels(body: SoftBody, frames: list[set[int]]) -> np.ndarray:
    """(n,) the first region that has all free frames of each voxel."""
    weights = body.fields.weights
    chosen = {}
    region = np.empty(weights.shape[0], np.int32)
    for v in range(len(region)):
        members = tuple(weights.indices[weights.indptr[v] : weights.indptr[v + 1]].tolist())
        if members not in chosen:
            free = {i for i in members if i >= body.held}
            chosen[members] = next(e for e, some in enumerate(frames) if free <= some)
        region[v] = chosen[members]
    return region
