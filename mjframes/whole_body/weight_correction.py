"""Control weights that follow the body: each voxel's W_j refitted to how the finite elements really move it.

    minimize over ΔW_v   E |N̂_v x − Σ_j W_vj x_j|² + ε Σ_j (ΔW_vj / w_i(j))²,   W = w_i φ_j + ΔW,   x ~ N(0, K⁺)
    subject to           Σ_j ΔW_vj = 0,   Σ_j ΔW_vj x̄_j = 0

N̂ is how the superelement moves the voxel's centre, or its block of them, K the sum of the regions, and j the points of
the voxel's own frames: a small system a voxel. W reproduces linear fields as before, but is smooth where the material
is and kinked where that is: shape functions that know the material in the full sense of the paper's §4. Surfaces,
contacts, masses and sensors use W. The term with ε lets a correction vanish where its frame's weight does, so that W
has no jumps there.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mjframes.base.linear import nonzero_eigenvectors
from mjframes.base.rows import members_of
from mjframes.base.threads import in_parallel
from mjframes.elasticity.regions import frame_sets
from mjframes.elasticity.stiffness import Stiffness
from mjframes.kinematics.control import ControlPoints, points_of
from mjframes.weights.weights import weights_at
from mjframes.whole_body.superelement import Superelement, degrees, frame_motions

Array = NDArray[np.float64]

TAPER = 1e-3  # [-] ε, to the mean variance: costs a tenth of a per cent, and halves the largest jumps
PLANE = 1e-9  # [-] singular value below which points span no further direction
CHUNK = 4096  # [voxels] at a time


def assembled(stiffness: Stiffness, k: int) -> Array:
    """Return Σ_i K_i (3k, 3k) [N/m] of all regions."""
    total = np.zeros((3 * k, 3 * k))
    for points, matrix in zip(stiffness.points, stiffness.matrix, strict=True):
        total[np.ix_(degrees(points), degrees(points))] += matrix
    return total


def compliance(stiffness: Array, control: ControlPoints, types: Sequence[str], held: int) -> Array:
    """Return K⁺ (3k, 3k) [m/N] of what the frames can do while the first `held` of them stand still."""
    basis = frame_motions(control, types, control.rest, held, held)
    value, vector = nonzero_eigenvectors(basis.T @ stiffness @ basis)  # not rigid motions and null modes
    vector = basis @ vector
    return (vector / value) @ vector.T


def correction(
    weights: sparse.csr_array,
    functions: sparse.csr_array,
    control: ControlPoints,
    axes: Array,
    element: Superelement,
    covariance: Array,
) -> sparse.csr_array:
    """Return ΔW (r, k) at the element's r places, 0 where one frame has all the weight.

    weights: (r, f) w_i, and functions: (r, k) w_i φ_j there.  axes: (3, 3) of the grid.  covariance: (3k, 3k) of x.
    """
    k = len(control.frame)
    own = np.einsum("jaka->jk", covariance.reshape(k, 3, k, 3))
    # E u_c x_jc of the fields of `moved`, along the grid's axes
    followed = ((element.lifting @ covariance).reshape(-1, k, 3) @ axes).transpose(2, 0, 1).reshape(-1, k)
    moved = element.moved.reshape(len(element.moved), -1)

    def fit(voxels: NDArray[np.int32]) -> tuple[NDArray[np.integer], NDArray[np.integer], Array]:
        frames = np.sort(weights.indices[slice(*weights.indptr[voxels[0] : voxels[0] + 2])]).astype(np.int64)
        points, of_frame = points_of(control, frames)
        free = _across_linear(control.rest[points])
        variance = free @ own[np.ix_(points, points)] @ free.T
        mean = np.trace(variance) / max(len(free), 1)
        if not mean > 0:  # nothing here moves but linearly
            return voxels[:0], points[:0], np.zeros(0)
        tapers = np.stack([free[:, of_frame == i] @ free[:, of_frame == i].T for i in range(len(frames))])
        missed = moved[voxels] @ followed[:, points].astype(np.float32)
        missed = missed - functions[voxels][:, points].toarray() @ own[np.ix_(points, points)]
        share = weights_at(weights, voxels, frames)
        system = variance + TAPER * mean * np.tensordot(1 / share**2, tapers, 1)
        found = np.linalg.solve(system, (missed @ free.T)[:, :, None])[:, :, 0] @ free
        return np.repeat(voxels, len(points)), np.tile(points, len(voxels)), found.ravel()

    label, sets = frame_sets(weights)
    groups = [
        some[start : start + CHUNK]
        for some, members in zip(members_of(label, len(sets)), sets, strict=True)
        if members.sum() > 1
        for start in range(0, len(some), CHUNK)
    ]
    entries = list(in_parallel(fit, groups))
    if not entries:
        return sparse.csr_array(functions.shape)
    rows, columns, values = (np.concatenate(parts) for parts in zip(*entries, strict=True))
    return sparse.csr_array((values, (rows, columns)), shape=functions.shape)


def _across_linear(rest: Array) -> Array:
    """(z, m) orthonormal combinations of m points' weights that see no linear field; rest: (m, 3)."""
    offset = rest - rest.mean(axis=0)
    linear = np.hstack([np.full((len(rest), 1), np.abs(offset).max()), offset])
    left, size, _ = np.linalg.svd(linear, full_matrices=True)
    return left[:, np.count_nonzero(size > PLANE * size[0]) :].T
