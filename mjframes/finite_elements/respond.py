"""How a body responds to many forces B: the compliance S = BᵀA⁻¹B and the displacements C A⁻¹B.

1. Whitening. One cycle for each column gives S₀ = BᵀM B. Its eigenvectors make combinations B W of the columns with
   compliances of about one, so that an error counts in the stiffest as in the softest.
2. Conjugate gradients for the columns of B W give X. They start with cycles of their own: where columns cancel, the
   sum of the cycles before would be more rounding than sum.
3. Galerkin's method in the span of all of X: with G = XᵀAX and Y = XᵀB the displacements are C X G⁻¹Y, and
   S = YᵀG⁻¹Y. So S is positive semidefinite and at most the exact one, and its error is but the square of X's.
4. What each material has of the energy: with A_m of its bricks alone, uᵀA_m v of the displacements u, v of two forces.

X is kept in single precision, but AX is made of the X before it was rounded: it is as smooth as the forces are.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from threadpoolctl import threadpool_limits

from mjframes.base.linear import pseudo_inverse, unit_diagonal
from mjframes.base.threads import in_parallel
from mjframes.finite_elements import conjugate
from mjframes.finite_elements.batch import (
    Array,
    LoadBatch,
    Progress,
    averages,
    in_rounds,
    load,
    moments,
    multiply,
    reporter,
)
from mjframes.finite_elements.cycle import precondition
from mjframes.finite_elements.matrices import Bricks, Floats
from mjframes.finite_elements.solver import BodySolver

TOLERANCE = 0.07  # [-] of X in the energy norm: S is then right to about 1 % in its worst mode
NOISE = 1e-7  # [-] to the largest eigenvalue of the scaled S₀: smaller ones are taken to be that large
DEPENDENT = 1e-6  # [-] as `base.linear.ZERO`, of G: X is in single precision
CHUNK = 4096  # [rows] of large products worked on at a time


@dataclass(frozen=True, eq=False)
class Response:
    """What forces do to a body whose held pieces rest, along the index axes.

    compliance: (3m, 3m) S [m/N], symmetric positive semidefinite.
    moved: (r, 3, 3m) float32 [m/N], displacement of the voxels' centres, or its mean over each block of voxels.
    shares: (p, 3m + q, 3m + q) uᵀA_m v of all columns and q more fields of displacement, of each group of materials.

    Column 3b + d is the force functions[:, b] [N] along axis d. Of a free body only combinations of columns that
    balance have a meaning; their displacements have no mean translation and no mean rotation of the nodes.
    """

    compliance: Array
    moved: NDArray[np.float32]
    shares: Array


def respond(
    solver: BodySolver,
    functions: sparse.csr_array,
    blocks: NDArray[np.integer] | None = None,
    progress: Progress = lambda done, of: None,
    tolerance: float = TOLERANCE,
    groups: Sequence[NDArray[np.bool_]] = (),
    others: Array | None = None,
) -> Response:
    """Return the response to forces `functions` (N, m) on the nodes, along each axis.

    blocks: (n,) the block of each voxel, numbered from 0 on, for the means of displacements.  progress: is called with
    the batches done and how many there are.  tolerance: see `conjugate`.
    groups: p times which (t,) of the grid's materials have a share.  others: (3N, q) the fields besides, none unless
    given.
    Raise MjframesError where conjugate gradients do not converge.
    """
    k = solver.levels.columns
    forces = sparse.csr_array(functions, dtype=solver.levels.dtype)
    centre = solver.centre if blocks is None else sparse.csr_array(averages(blocks) @ solver.centre, dtype=np.float32)
    with threadpool_limits(1, "blas"):  # the batches are spread over the processors already
        basis = _basis(solver, forces)
        report = reporter(progress, _batches(len(basis), k) + _batches(basis.shape[1], k))
        combinations = _whitening(_cycles(solver, forces, len(basis), report), basis)
        x, energies, work = _solve(solver, forces, combinations, tolerance, report)
        weights = pseudo_inverse(energies, DEPENDENT) @ work.T
        compliance = work @ weights / solver.levels.unit
        moved = _moved(centre, x, weights / solver.levels.unit, k)
        shares = _shares(solver, x, weights / solver.levels.unit, groups, others)
        return Response((compliance + compliance.T) / 2, moved, shares)


def _batches(columns: int, k: int) -> int:
    return -(-columns // k)


def _batch(columns: Array, number: int, k: int) -> Array:
    """(c, k) the columns of a batch, with zeros where there are no more."""
    some = columns[:, number * k : (number + 1) * k]
    return np.pad(some, ((0, 0), (0, k - some.shape[1])))


def _basis(solver: BodySolver, forces: sparse.csr_array) -> Array:
    """(3m, c) all columns scaled to one, or of a free body a basis of their combinations that balance."""
    norm = np.repeat(np.sqrt(np.asarray(forces.multiply(forces).sum(axis=0)).ravel()), 3)
    scale = np.where(norm > 0, 1 / np.where(norm > 0, norm, 1), 0)
    if solver.held:
        return np.diag(scale)
    resultants = (forces.T @ solver.rigid.reshape(-1, 18)).reshape(-1, 6) * scale[:, None]
    vectors, values, _ = np.linalg.svd(resultants)
    return scale[:, None] * vectors[:, np.count_nonzero(values > NOISE * values[0]) :]


def _cycles(solver: BodySolver, forces: sparse.csr_array, count: int, report: Callable[[], None]) -> Array:
    """S₀ of the `count` columns."""
    k, columns = solver.levels.columns, np.eye(count)

    def improve(batch: LoadBatch, number: int) -> Array:
        load(forces, _batch(columns, number, k), batch.r[0])
        return moments(forces, precondition(solver.levels, batch), k)

    rounds = in_rounds(solver.levels, _batches(count, k), improve, report)
    return np.hstack([part for some in rounds for _, part in some])[:, :count]


def _whitening(compliance: Array, basis: Array) -> Array:
    """Combinations W (3m, c) in the span of the basis with WᵀS₀W about one, the softest first."""
    within = basis.T @ (compliance + compliance.T) @ basis / 2
    scale = unit_diagonal(within)
    values, vectors = np.linalg.eigh(within * scale * scale[:, None])
    least = NOISE * max(values[-1], NOISE) if len(values) else 1.0
    return (basis * scale @ vectors / np.sqrt(np.maximum(values, least)))[:, ::-1]


def _solve(
    solver: BodySolver,
    forces: sparse.csr_array,
    combinations: Array,
    tolerance: float,
    report: Callable[[], None],
) -> tuple[list[Floats], Array, Array]:
    """X = A⁻¹B W, a batch an array, G (c, c) and Yᵀ (3m, c)."""
    k, columns = solver.levels.columns, combinations.shape[1]
    x = [np.empty(solver.levels.nodes * 3 * k, np.float32) for _ in range(_batches(columns, k))]
    energies = np.zeros((len(x) * k,) * 2)
    work = np.zeros((len(combinations), len(x) * k))

    def improve(batch: LoadBatch, number: int) -> None:
        chosen = _batch(combinations, number, k)
        load(forces, chosen, batch.residual)
        if x[number].dtype == batch.residual.dtype:
            batch.solution = x[number]
        conjugate.solve(solver.levels, batch, tolerance)
        if not solver.held:
            solver.remove_rigid(batch.solution)
        work[:, number * k : (number + 1) * k] = moments(forces, batch.solution, k)
        if batch.solution is not x[number]:
            x[number][:] = batch.solution
        load(forces, chosen, batch.direction)
        batch.direction -= batch.residual  # A x

    def pair(batch: LoadBatch, number: int) -> None:
        here = slice(number * k, (number + 1) * k)
        for other in range(number + 1):
            there = slice(other * k, (other + 1) * k)
            energies[there, here] = x[other].reshape(-1, k).T @ batch.direction.reshape(-1, k)
            energies[here, there] = energies[there, here].T

    done = 0
    for some in in_rounds(solver.levels, len(x), improve, report):
        for _ in in_parallel(lambda item: pair(*item), [(batch, done + i) for i, (batch, _) in enumerate(some)]):
            pass
        done += len(some)
    return x, (energies + energies.T)[:columns, :columns] / 2, work[:, :columns]


def _shares(
    solver: BodySolver, x: list[Floats], weights: Array, groups: Sequence[NDArray[np.bool_]], others: Array | None
) -> Array:
    """uᵀA_m v of the fields X weights (c, 3m) and others (3N, q), of each group of materials."""
    levels, k, columns = solver.levels, solver.levels.columns, len(weights)
    rest = np.zeros((3 * levels.nodes, 0)) if others is None else others
    fields = [*x, *(_batch(rest, number, k).astype(np.float32).ravel() for number in range(_batches(rest.shape[1], k)))]
    used = np.r_[:columns, len(x) * k : len(x) * k + rest.shape[1]]
    combine = np.zeros((columns + rest.shape[1], weights.shape[1] + rest.shape[1]))
    combine[:columns, : weights.shape[1]] = weights
    combine[columns:, weights.shape[1] :] = np.eye(rest.shape[1])
    found = np.zeros((len(groups), combine.shape[1], combine.shape[1]))
    for m, group in enumerate(groups):
        bricks = levels.finest._replace(coefficients=levels.finest.coefficients * group[:, None].astype(levels.dtype))
        energies = np.zeros((len(fields) * k,) * 2)

        def pair(batch: LoadBatch, number: int, bricks: Bricks = bricks, energies: Array = energies) -> None:
            batch.solution[:] = fields[number]
            batch.residual[:] = 0
            bricks.subtract(batch.solution, batch.residual, batch.scratch[0], batch.lanes)
            here = slice(number * k, (number + 1) * k)
            for other in range(number + 1):
                there = slice(other * k, (other + 1) * k)
                energies[there, here] = -fields[other].reshape(-1, k).T @ batch.residual.reshape(-1, k)
                energies[here, there] = energies[there, here].T

        for _ in in_rounds(levels, len(fields), pair, lambda: None):
            pass
        found[m] = combine.T @ energies[np.ix_(used, used)] @ combine * levels.unit
    return (found + found.transpose(0, 2, 1)) / 2


def _moved(centre: sparse.csr_array, x: list[Floats], weights: Array, k: int) -> NDArray[np.float32]:
    """(r, 3, 3m) what `centre` (r, N) makes of the displacements X weights (c, 3m)."""
    rows, (columns, count) = len(centre.indptr) - 1, weights.shape
    moved = np.empty((rows, 3, count), np.float32)

    def fill(start: int) -> None:
        some = slice(start, min(start + CHUNK, rows))
        chosen = sparse.csr_array(centre[some])
        fields = np.empty((some.stop - start, 3, len(x) * k), np.float32)
        part = np.empty((some.stop - start, 3, k), x[0].dtype)
        for number, values in enumerate(x):
            multiply(chosen, values, part)
            fields[:, :, number * k : (number + 1) * k] = part
        moved[some] = fields[:, :, :columns] @ weights.astype(np.float32)

    for _ in in_parallel(fill, range(0, rows, CHUNK)):
        pass
    return moved
