"""How a body moves under given loads: u = C A⁻¹ Cᵀf, each load by itself."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse
from threadpoolctl import threadpool_limits

from mjframes.finite_elements import conjugate
from mjframes.finite_elements.batch import LoadBatch, Progress, in_rounds, multiply, reporter
from mjframes.finite_elements.solver import BodySolver

TOLERANCE = 0.02  # [-] in the energy norm


def displacements(
    solver: BodySolver,
    loads: ArrayLike,
    progress: Progress = lambda done, of: None,
    tolerance: float = TOLERANCE,
) -> NDArray[np.float32]:
    """Return the displacements (n, 3, l) [m] of the voxels' centres under loads (n, 3, l) [N] on them, index axes.

    Held pieces rest. Loads on a free body must balance; its nodes have no mean translation and no mean rotation.
    progress: is called with the batches done and how many there are.  tolerance: see `conjugate`.
    Raise MjframesError where conjugate gradients do not converge.
    """
    forces = np.asarray(loads)
    n, _, count = forces.shape
    levels, k = solver.levels, solver.levels.columns
    to_nodes = sparse.csr_array(solver.centre.T)
    moved = np.empty((n, 3, count), np.float32)

    def solve(batch: LoadBatch, number: int) -> None:
        some = slice(number * k, min((number + 1) * k, count))
        values = np.zeros((n, 3, k), levels.dtype)
        values[:, :, : some.stop - some.start] = forces[:, :, some]
        multiply(to_nodes, values, batch.residual)
        conjugate.solve(levels, batch, tolerance)
        if not solver.held:
            solver.remove_rigid(batch.solution)
        multiply(solver.centre, batch.solution, values)
        moved[:, :, some] = values[:, :, : some.stop - some.start] / levels.unit

    batches = -(-count // k)
    with threadpool_limits(1, "blas"):
        for _ in in_rounds(levels, batches, solve, reporter(progress, batches)):
            pass
    return moved
