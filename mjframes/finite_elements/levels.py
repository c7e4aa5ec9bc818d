"""The levels of a body, from its bricks to a matrix small enough to be inverted.

Stiffness is in units of the body's median Young's modulus times its mean voxel edge, so that single precision holds it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse

from mjframes.base.linear import unit_diagonal
from mjframes.base.rigid import rigid_motions, size_of
from mjframes.finite_elements.coarsen import Coarsening, LevelCells, Rows, coarsened
from mjframes.finite_elements.element import brick_stiffness, coefficients
from mjframes.finite_elements.galerkin import Blocks, from_blocks, from_bricks
from mjframes.finite_elements.matrices import BlockRows, Bricks, Floats, Matrix
from mjframes.finite_elements.mesh import Mesh
from mjframes.finite_elements.smoother import eigenvalue_bound
from mjframes.volume.grid import Grid

FEW = 300  # [nodes] of a level whose matrix is inverted: some 30 ms
MANY = 800  # [nodes] the same where the next level would hardly be smaller: half a second
SMALLER = 0.8  # [-] a level worth having has at most that part of the nodes of the one before
DEPENDENT = 1e-12  # [-] to the diagonal: smaller pivots are of nodes that move with others
DOUBLE = 1e7  # [-] condition from which on single precision would lose the softest motions
COLUMNS = (16, 8, 4)  # at once: the most that LARGEST allows
VECTORS = 6  # [-] of the finest level's size that a batch of columns needs, with those of the coarser levels
LARGEST = 6e8  # [bytes] for these

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Level:
    """A level of N nodes above a coarser one.

    inverse: (N, 3) of the matrix's diagonal D, 0 at held nodes.
    bound: of the eigenvalues of D⁻¹A.
    parent, weight: (N lists) of coarse nodes, and the part of each of them in a node's displacement.
    """

    matrix: Matrix
    inverse: Floats
    bound: float
    parent: Rows
    weight: Floats


@dataclass(frozen=True, eq=False)
class Levels:
    """All levels, the finest first. Stiffness is in units of `unit` [N/m].

    finest: its matrix.
    above: the levels but for the last.
    last: (3N', 3N') the inverse matrix of the last, blind to rigid motions of a free body.
    dtype: float32, or float64 where that would not do.
    columns: k, how many to solve for at once.
    """

    finest: Bricks
    above: tuple[Level, ...]
    last: Array
    unit: float
    dtype: type[np.floating]
    columns: int

    @property
    def nodes(self) -> int:
        """Return N of the finest level."""
        return int(self.finest.node_planes[-1])

    @property
    def memory(self) -> int:
        """Return the size of the vectors of a batch [bytes]."""
        return _memory(self.nodes, self.dtype) * self.columns


def body_levels(grid: Grid, mesh: Mesh) -> Levels:
    """Return the levels of a mesh on a grid."""
    young, poisson = grid.per_material("young"), grid.per_material("poisson")
    reference, size = float(np.median(grid.young)), float(grid.cell_volume ** (1 / 3))
    stiffness = np.array(
        [e / reference * brick_stiffness(nu, grid.spacing / size) for e, nu in zip(young, poisson, strict=True)]
    )
    coarsenings, matrices = _coarse_matrices(mesh, stiffness, young / reference)
    held = mesh.held_by >= 0
    last = _dense(matrices[-1]) if matrices else _dense_bricks(mesh, stiffness, held)
    position = coarsenings[-1].position if coarsenings else mesh.position
    inverse, condition = _inverse(last, None if held.any() else position)
    condition *= 4.0 ** len(coarsenings)  # energies are kept, but Σ D u² of a displacement is a fourth on each level
    dtype = np.float32 if condition < DOUBLE else np.float64
    k = next((k for k in COLUMNS if k * _memory(len(mesh.position), dtype) <= LARGEST), COLUMNS[-1])
    table = np.array([coefficients(matrix) for matrix in stiffness], dtype)
    finest = Bricks(mesh.corner, mesh.material, table, mesh.brick_planes, mesh.node_planes)
    forms = [finest, *(BlockRows(*matrix.column, matrix.value.reshape(-1, 9).astype(dtype)) for matrix in matrices)]
    diagonals = [_brick_diagonal(mesh, stiffness), *map(_diagonal, matrices)]
    above = []
    for matrix, diagonal, coarsening in zip(forms, diagonals, coarsenings, strict=False):
        moves = np.diff(coarsening.parent.start) > 0
        reciprocal = np.where(moves[:, None], 1 / diagonal, 0).astype(dtype)
        bound = eigenvalue_bound(matrix, reciprocal, k)
        above.append(Level(matrix, reciprocal, bound, coarsening.parent, coarsening.weight.astype(dtype)))
    return Levels(finest, tuple(above), inverse, reference * size, dtype, k)


def _memory(nodes: int, dtype: type[np.floating]) -> int:
    """[bytes] of the vectors that a column needs."""
    return VECTORS * 3 * nodes * np.dtype(dtype).itemsize


def _coarse_matrices(mesh: Mesh, stiffness: Array, modulus: Array) -> tuple[list[Coarsening], list[Blocks]]:
    """Level after level, until the last is small enough. modulus: (m,) of each material [-]."""
    low = mesh.position.min(axis=0)
    position, held = mesh.position - low, mesh.held_by >= 0
    corners = Rows(8 * np.arange(len(mesh.corner) + 1), mesh.nodes.ravel())
    cells = LevelCells(corners, modulus[mesh.material], mesh.place - low)
    coarsenings: list[Coarsening] = []
    matrices: list[Blocks] = []
    while len(position) > FEW:
        coarsening = coarsened(position, cells, held)
        if len(coarsening.position) > SMALLER * len(position):
            if len(position) <= MANY:
                break
            coarsening = coarsened(position, cells, held, weak=0.0)
        matrices.append(from_blocks(matrices[-1], coarsening) if matrices else from_bricks(mesh, stiffness, coarsening))
        coarsenings.append(coarsening)
        position, cells = coarsening.position, coarsening.cells
        held = np.zeros(len(position), bool)
    return coarsenings, matrices


def _brick_diagonal(mesh: Mesh, stiffness: Array) -> Array:
    """(N, 3) of the finest matrix; a brick has the same at each of its corners."""
    diagonal = np.zeros((len(mesh.position), 3))
    for d in range(3):
        share = stiffness[:, d, d][mesh.material]
        for corner in mesh.nodes.T:
            diagonal[:, d] += np.bincount(corner, share, len(diagonal))
    return diagonal


def _diagonal(matrix: Blocks) -> Array:
    start, column = matrix.column
    row = np.repeat(np.arange(len(start) - 1), np.diff(start))
    return np.einsum("bii->bi", matrix.value[row == column])


def _dense(matrix: Blocks) -> Array:
    size = 3 * (len(matrix.column.start) - 1)
    return sparse.bsr_array((matrix.value, matrix.column.item, matrix.column.start), shape=(size, size)).toarray()


def _dense_bricks(mesh: Mesh, stiffness: Array, held: NDArray[np.bool_]) -> Array:
    """The finest matrix of a small body, 0 where nodes are held."""
    dof = (3 * mesh.nodes[:, :, None] + np.arange(3)).reshape(-1, 24)
    dense = np.zeros((3 * len(mesh.position),) * 2)
    np.add.at(dense, (dof[:, :, None], dof[:, None, :]), stiffness[mesh.material])
    free = np.repeat(~held, 3)
    return dense * free * free[:, None]


def _inverse(matrix: Array, position: NDArray[np.int32] | None) -> tuple[Array, float]:
    """The inverse, and about the condition of the matrix with its rows and columns scaled to a diagonal of ones.

    Degrees of freedom that depend on others, as those of coarse nodes may, or are held, stay 0. position: (N', 3) of
    the nodes of a free body, whose rigid motions are given stiffness.
    """
    scale = unit_diagonal(matrix, nothing=0)  # a coarse node may have but a trace of the softest material
    scaled = matrix * scale * scale[:, None]
    if position is not None:
        motions = np.linalg.qr(rigid_motions(position, position.mean(axis=0), size_of(position)) / scale[:, None])[0]
        scaled += motions @ motions.T
    (factorize,) = linalg.get_lapack_funcs(("pstrf",), (scaled,))
    factor, pivot, rank, _ = factorize(scaled, lower=1, tol=DEPENDENT)
    used = pivot[:rank] - 1
    root = linalg.solve_triangular(np.tril(factor[:rank, :rank]), np.eye(rank), lower=True, check_finite=False)
    inverse = np.zeros_like(matrix)
    inverse[np.ix_(used, used)] = root.T @ root
    condition = float(np.abs(inverse).sum(axis=0).max())
    return inverse * scale * scale[:, None], condition
