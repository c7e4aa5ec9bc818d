"""How a body resists and follows motions of the pieces that hold it.

Let piece i of h move by q_i: three translations [m], and three rotations about its centroid. Then u is what makes
½ uᵀAu least. No energy is needed to move all pieces as one rigid body, so only motions relative to the last piece are
solved for: q_i − T_i q_h, where T_i q_h is the motion of piece i if the last one carried it along. A body that one
piece holds moves as that does, and a free one has a rigid motion of its own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from threadpoolctl import threadpool_limits

from mjframes.base.rigid import rigid_motions, size_of
from mjframes.finite_elements import conjugate, kernels
from mjframes.finite_elements.batch import Array, LoadBatch, averages, in_rounds
from mjframes.finite_elements.matrices import Floats
from mjframes.finite_elements.solver import BodySolver

TOLERANCE = 0.01  # [-] in the energy norm: energies are right to 1e-4


@dataclass(frozen=True, eq=False)
class Motions:
    """What unit motions of the h held pieces, or of a body that none holds, do to it, along the index axes.

    Column 6i + d moves piece i while the others rest, by 1 m along axis d, or for d > 2 by 1 / scale [rad] about the
    axis d − 3 through its center, linearly.

    center: (max(h, 1), 3) [m] means of the voxels' centres, turned to the index axes.
    scale: [m] the body's size.
    energy: (6h, 6h) uᵀAu of each two columns, positive semidefinite, 0 for motions of all pieces as one rigid body.
    moved: (r, 3, 6h) float32, displacement of the voxels' centres, or its mean over each block of voxels.
    moments: (3m, 6h) BᵀU, the sums of the nodes' displacements, in rows as those of `Response.compliance`.
    fields: (3N, q) displacements of the nodes by what moves the pieces relatively, and change: (q, 6h) how much of them
    each column has; the rest of a column is rigid.
    """

    center: Array
    scale: float
    energy: Array
    moved: NDArray[np.float32]
    moments: Array
    fields: Array
    change: Array


def motions(
    solver: BodySolver,
    functions: sparse.csr_array,
    blocks: NDArray[np.integer] | None = None,
) -> Motions:
    """Return what motions of the held pieces do, or those of the whole body where none is held.

    functions, blocks: see `respond`.
    Raise MjframesError where conjugate gradients do not converge.
    """
    grid, mesh, last = solver.grid, solver.mesh, max(len(solver.held) - 1, 0)
    shift = grid.origin @ grid.axes
    places = (grid.index + 0.5) * grid.spacing + shift
    nodes = mesh.position * grid.spacing + shift
    pieces = solver.held or (np.arange(len(places)),)
    center = np.array([places[piece].mean(axis=0) for piece in pieces])
    scale = size_of(nodes)
    given = np.zeros((len(nodes), 3, 6 * last), solver.levels.dtype)
    relative = np.zeros((len(places), 3, 6 * last))  # at the voxels
    change = np.hstack([np.eye(6 * last), np.zeros((6 * last, 6))])  # from q_i and q_h to q_i − T_i q_h
    for i in range(last):
        columns = slice(6 * i, 6 * i + 6)
        on_piece = mesh.held_by == i
        given[on_piece, :, columns] = _motion(nodes[on_piece], center[i], scale)
        relative[solver.held[i], :, columns] = _motion(places[solver.held[i]], center[i], scale)
        change[columns, 6 * last :] = -np.eye(6)
        change[6 * i : 6 * i + 3, 6 * last :] = -_motion(center[[i]], center[last], scale)[0]
    with threadpool_limits(1, "blas"):
        fields, forces = _solve(solver, given)
    relative += (solver.centre @ fields.reshape(len(nodes), 18 * last)).reshape(relative.shape)
    energy = change.T @ (fields.T @ forces) @ change * solver.levels.unit
    moved = relative @ change
    moved[:, :, 6 * last :] += _motion(places, center[last], scale)
    followed = fields.reshape(len(nodes), 3, 6 * last) @ change
    followed[:, :, 6 * last :] += _motion(nodes, center[last], scale)
    moments = (functions.T @ followed.reshape(len(nodes), -1)).reshape(-1, moved.shape[2])
    if blocks is not None:
        moved = (averages(blocks) @ moved.reshape(len(places), -1)).reshape(-1, *moved.shape[1:])
    return Motions(center, scale, (energy + energy.T) / 2, moved.astype(np.float32), moments, fields, change)


def _motion(points: Array, center: Array, scale: float) -> Array:
    """(p, 3, 6) the displacements of points (p, 3) for each motion of a piece."""
    return rigid_motions(points, center, scale).reshape(-1, 3, 6)


def _solve(solver: BodySolver, given: Floats) -> tuple[Array, Array]:
    """u and A u (3N, c) where the held nodes are displaced as `given` (N, 3, c)."""
    levels, k, count = solver.levels, solver.levels.columns, given.shape[2]
    fields, forces = (np.empty((3 * levels.nodes, count)) for _ in range(2))

    def solve(batch: LoadBatch, number: int) -> None:
        some = slice(number * k, min((number + 1) * k, count))
        used = some.stop - some.start
        prescribed = np.zeros((3 * levels.nodes, k), levels.dtype)
        prescribed[:, :used] = given.reshape(3 * levels.nodes, -1)[:, some]
        u, force, energies = prescribed.flatten(), np.empty(prescribed.size, levels.dtype), np.zeros(k)

        def energy(x: Floats) -> Array:
            np.add(prescribed.ravel(), x, out=u)
            force[:] = 0
            levels.finest.subtract(u, force, batch.scratch[0], batch.lanes)
            kernels.products(u, force, energies, batch.lanes)
            return -energies

        batch.residual[:] = 0
        levels.finest.subtract(u, batch.residual, batch.scratch[0], batch.lanes)
        conjugate.solve(levels, batch, TOLERANCE, energy)
        fields[:, some] = u.reshape(-1, k)[:, :used]
        forces[:, some] = -force.reshape(-1, k)[:, :used]

    batches = -(-count // k)
    for _ in in_rounds(levels, batches, solve, lambda: None):
        pass
    return fields, forces
