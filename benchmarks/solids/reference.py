"""The solutions that errors are measured against: finite elements on the same voxels, refined until they stand still.

Levels are (order, split) of `bricks`. Linear systems are solved by conjugate gradients; algebraic multigrid on bricks
of order 1 with the same nodes preconditions all orders.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, cg

from benchmarks.solids import SOURCES
from benchmarks.solids.bricks import Bricks, at_centers, bricks, internal_force, linear_stiffness, nodal_load
from benchmarks.solids.cases import Case, all_cases
from benchmarks.solids.processes import by_name
from mjframes.base.cache import cached
from mjframes.base.errors import MjframesError
from mjframes.base.packages import optional
from mjframes.base.rigid import rigid_motions, size_of

Array = NDArray[np.float64]

LEVELS = ((1, 1), (1, 2), (2, 1), (2, 2))
MOST_NODES, MOST_NODES_LARGE = 90_000, 20_000  # beyond that a level is left out; for large displacements
TOLERANCE = 1e-8  # [-] of the residual of linear systems, and of Newton's iterations
INCREMENTS = 4  # of a large load


@dataclass(frozen=True, eq=False)
class Reference:
    """The solution of finite elements for a case.

    moved: (n, 3) at the voxels' centres [m].
    load: (n, 3) [N] the case's, scaled.
    levels: (order, split, nodes) of each level.
    change: relative L2 distance of each level from the last.
    quantity: of each level [m].
    """

    moved: Array
    load: Array
    levels: list[tuple[int, int, int]]
    change: list[float]
    quantity: list[float]

    def error(self, moved: Array) -> float:
        """Return the relative L2 distance of displacements (n, 3) from these [-]."""
        return float(np.linalg.norm(moved - self.moved) / np.linalg.norm(self.moved))


def refined(case: Case) -> Reference:
    """Return the reference of a case, computed once, then kept."""
    inputs = (
        SOURCES,
        case.volume,
        case.fixed,
        case.load,
        case.goal,
        case.amplitude,
        case.nonlinear,
        MOST_NODES,
        MOST_NODES_LARGE,
    )
    known = cached("reference", inputs, lambda: _solve(case))
    fields = known["fields"]
    size = np.linalg.norm(fields[-1])
    return Reference(
        fields[-1],
        known["load"],
        [tuple(level) for level in known["levels"].tolist()],
        [float(np.linalg.norm(field - fields[-1]) / size) for field in fields],
        [case.quantity(field) for field in fields],
    )


def references(names: Sequence[str], progress: Callable[[str], None]) -> dict[str, Reference]:
    """Return those of cases of the full report, by name, several computed at once."""
    return by_name(_named, names, progress)


def _named(name: str) -> Reference:
    return refined(next(case for case in all_cases(quick=False) if case.name == name))


def _solve(case: Case) -> dict[str, Array]:
    fields, levels, load = [], [], case.load
    for order, split in LEVELS:
        mesh = bricks(case.grid, case.held, order, split)
        if fields and len(mesh.nodes) > (MOST_NODES_LARGE if case.nonlinear else MOST_NODES):
            continue
        low = mesh if order == 1 else bricks(case.grid, case.held, 1, order * split)
        moved = linear_solution(mesh, low, load)
        if not fields:
            scale = case.amplitude * case.grid.length / np.abs(at_centers(mesh, moved)).max()
            load, moved = scale * load, scale * moved
        if case.nonlinear:
            moved = nonlinear_solution(mesh, low, load)
        fields.append(at_centers(mesh, moved))
        levels.append((order, split, len(mesh.nodes)))
    return {"fields": np.array(fields), "levels": np.array(levels), "load": load}


def linear_solution(mesh: Bricks, low: Bricks, load: Array) -> Array:
    """Return displacements (N, 3) [m] under forces (n, 3) [N]; low: bricks of order 1 with the same nodes."""
    return next(linear_solutions(mesh, low, [load]))


def linear_solutions(
    mesh: Bricks, low: Bricks, loads: Iterable[Array], tolerance: float = TOLERANCE
) -> Iterator[Array]:
    """Yield the same for many loads on one body; those of a free one are in balance."""
    moving = mesh.moving
    matrix = linear_stiffness(mesh)[moving][:, moving]
    inverse = preconditioner(matrix if low is mesh else linear_stiffness(low)[moving][:, moving], mesh)
    for load in loads:
        moved = np.zeros(len(moving))
        moved[moving] = solve(matrix, inverse, nodal_load(mesh, load).ravel()[moving], tolerance)
        yield moved.reshape(-1, 3)


def nonlinear_solution(mesh: Bricks, low: Bricks, load: Array) -> Array:
    """Return the same for large displacements: Newton's iterations, the load in increments."""
    moving, force = mesh.moving, nodal_load(mesh, load)
    moved = np.zeros_like(mesh.nodes)
    for part in np.arange(1, INCREMENTS + 1) / INCREMENTS:
        for _ in range(30):
            inner, tangent = internal_force(mesh, moved)
            residual = (part * force - inner).ravel()[moving]
            if np.linalg.norm(residual) < TOLERANCE * np.linalg.norm(force):
                break
            rough = tangent if low is mesh else internal_force(low, moved)[1]
            matrix, rough = (sparse.csr_array(some[moving][:, moving]) for some in (tangent, rough))
            step = np.zeros(len(moving))
            step[moving] = solve(matrix, preconditioner(rough, mesh), residual, 1e-5)
            moved = moved + step.reshape(-1, 3)
        else:
            raise MjframesError("the nonlinear finite elements did not come to rest; make the load smaller.")
    return moved


def preconditioner(matrix: sparse.csr_array, mesh: Bricks) -> LinearOperator:
    """Return one cycle of multigrid for the moving nodes' matrix, of bricks of order 1."""
    pyamg = optional("pyamg", "the report", "harmonic")
    blocks = sparse.csr_matrix(matrix)
    if not mesh.mirrored:  # then a node moves along all of its axes, or along none
        blocks = sparse.bsr_matrix(blocks, blocksize=(3, 3))
    smoother = ("gauss_seidel" if mesh.mirrored else "block_gauss_seidel", {"sweep": "symmetric"})
    motions = rigid_motions(mesh.nodes, mesh.nodes.mean(axis=0), size_of(mesh.nodes))[mesh.moving]
    grids = pyamg.smoothed_aggregation_solver(blocks, B=motions, presmoother=smoother, postsmoother=smoother)
    return grids.aspreconditioner()


def solve(matrix: sparse.csr_array, inverse: LinearOperator, right: Array, tolerance: float = TOLERANCE) -> Array:
    result, failed = cg(matrix, right, rtol=tolerance, M=inverse, maxiter=2000)
    if failed:
        raise MjframesError("the finite elements' linear system did not converge.")
    return result
