"""Trilinear displacements on the cells of a voxel grid, each cell q × q × q voxels with a stiffness of their own.

With s ∈ [0, 1]³ the place in a cell, N_a(s) = Σ_p n_ap s^p and ∂N_a/∂x_d = Σ_p t_adp s^p over the eight monomials
s^p, p ∈ {0, 1}³. So every integral over a cell follows from moments of the cell's voxels: Σ_v V λ_v s^e with
e ∈ {0, 1, 2}³ for the stiffness, Σ_v s^p u_v for the product of a nodal function, or its gradient, with a field u.

The quadratic form is condensed by eliminating the nodes plane by plane along the longest axis, a block tridiagonal
Cholesky factorization with dense blocks.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import qr, solve_triangular

Array = NDArray[np.float64]

CORNERS = np.array(list(product((0, 1), repeat=3)))  # of a cell, and the exponents p of the eight monomials
_EXPONENTS = np.array(list(product((0, 1, 2), repeat=3)))  # of their products
_PRODUCT = (CORNERS[:, None] + CORNERS) @ (9, 3, 1)  # (8, 8) the place of each product in _EXPONENTS
# 1 − s and s, and their derivatives, for a corner at 0 or 1: coefficients of 1 and s
_SHAPE, _SLOPE = np.array([[1.0, -1.0], [0.0, 1.0]]), np.array([[-1.0, 0.0], [1.0, 0.0]])


def _coefficients(factors: list[Array]) -> Array:
    """(8, 8) coefficients of the eight monomials in each corner's product of three linear functions."""
    x, y, z = (factor[CORNERS[:, d]][:, CORNERS[:, d]] for d, factor in enumerate(factors))
    return x * y * z


VALUES = _coefficients([_SHAPE, _SHAPE, _SHAPE])  # n_ap
GRADIENTS = np.stack(
    [_coefficients([_SLOPE if d == axis else _SHAPE for d in range(3)]) for axis in range(3)], axis=1
)  # t_adp of a cell of edge 1


@dataclass(frozen=True, eq=False)
class CellGrid:
    """c cells with N nodes around some voxels.

    voxel_cell: (n,) the cell of each voxel.  place: (n, 3) of its centre in the cell, s ∈ (0, 1).
    cell_nodes: (c, 8).  nodes: (N, 3) [m] from the first corner, sorted by plane.  plane: (N,) along the longest axis.
    slopes: (8, 3, 8) t_adp in volume coordinates [1/m].  factor: q.
    """

    voxel_cell: NDArray[np.int64]
    place: Array
    cell_nodes: NDArray[np.int64]
    nodes: Array
    plane: NDArray[np.int64]
    slopes: Array
    factor: int


def cell_grid(index: NDArray[np.integer], spacing: Array, axes: Array, factor: int) -> CellGrid:
    """Cells of `factor`³ voxels that hold the voxels at `index` (n, 3); spacing (3,) [m] along the columns of axes."""
    index = (index - index.min(axis=0)).astype(np.int64)
    cell = index // factor
    size = cell.max(axis=0) + 1
    cells, voxel_cell = np.unique(np.ravel_multi_index(tuple(cell.T), tuple(size)), return_inverse=True)
    corner = np.stack(np.unravel_index(cells, tuple(size)), axis=1)[:, None, :] + CORNERS
    longest = np.argsort(-size, kind="stable")
    numbers = np.ravel_multi_index(tuple(corner[..., a] for a in longest), tuple(size[longest] + 1))
    nodes, cell_nodes = np.unique(numbers, return_inverse=True)
    at = np.empty((len(nodes), 3), np.int64)
    at[:, longest] = np.stack(np.unravel_index(nodes, tuple(size[longest] + 1)), axis=1)
    edges = factor * spacing
    return CellGrid(
        voxel_cell=voxel_cell.ravel(),
        place=(index - cell * factor + 0.5) / factor,
        cell_nodes=cell_nodes.reshape(-1, 8),
        nodes=at * edges @ axes.T,
        plane=at[:, longest[0]],
        slopes=np.einsum("ed,adp->aep", axes / edges, GRADIENTS),
        factor=factor,
    )


def elimination_cost(size: NDArray[np.integer], factor: int, columns: int) -> float:
    """Upper bound [flop] of `condense` for cells of `factor`³ voxels in a box of `size` (3,) voxels."""
    nodes = np.sort(-(-size // factor) + 1)
    rows = 3.0 * nodes[0] * nodes[1]
    return float(nodes[2] * rows * (2.4 * rows**2 + 3 * rows * columns + columns**2))


def cell_stiffness(grid: CellGrid, lam: Array, mu: Array) -> sparse.csr_array:
    """(3N, 3N) ∫ ε : C ε with natural boundaries, degrees of freedom 3a + xyz; lam, mu: (n,) V times Lamé's [Pa m³]."""
    moments = np.zeros((2, len(grid.cell_nodes), len(_EXPONENTS)))
    # Each voxel's own extent makes the integrals exact, and one voxel a cell the standard eight-node brick.
    _add_moduli(grid.voxel_cell, grid.place, lam, mu, 1 / (12 * grid.factor**2), moments)
    pairs = np.zeros((8, 3, 8, 3, len(_EXPONENTS)))
    for p, q in product(range(8), repeat=2):
        pairs[..., _PRODUCT[p, q]] += np.multiply.outer(grid.slopes[:, :, p], grid.slopes[:, :, q])
    by_mu = pairs.transpose(0, 3, 2, 1, 4) + np.einsum("afbfk,de->adbek", pairs, np.eye(3))
    blocks = moments[0] @ pairs.reshape(576, -1).T + moments[1] @ by_mu.reshape(576, -1).T
    dof = (3 * grid.cell_nodes[:, :, None] + np.arange(3)).reshape(-1, 24)
    at = (np.repeat(dof, 24, axis=1).ravel(), np.tile(dof, (1, 24)).ravel())
    size = 3 * len(grid.nodes)
    return sparse.csr_array((blocks.ravel(), at), shape=(size, size))


def at_nodes(grid: CellGrid, moments: Array, coefficients: Array) -> Array:
    """(N, u) Σ over the cells of a node: coefficients (8, 8) of s^p in its corner's function, moments (8, c, u)."""
    _, c, u = moments.shape
    parts = (coefficients @ moments.reshape(8, -1)).reshape(8 * c, u)
    gather = sparse.csr_array(
        (np.ones(8 * c), (grid.cell_nodes.T.ravel(), np.arange(8 * c))), shape=(len(grid.nodes), 8 * c)
    )
    return gather @ parts


def rigid_motions(nodes: Array) -> Array:
    """(3N, 6) translations, and rotations about the mean node scaled to size 1."""
    motion = np.zeros((len(nodes), 3, 6))
    offset = nodes - nodes.mean(axis=0)
    offset /= np.abs(offset).max()
    for a, axis in enumerate(np.eye(3)):
        motion[:, a, a] = 1
        motion[:, :, 3 + a] = np.cross(axis, offset)
    return motion.reshape(-1, 6)


def condense(grid: CellGrid, stiffness: sparse.csr_array, columns: Array) -> Array:
    """Bᵀ K⁺ B for columns B (3N, b), K⁺ the inverse of K with six degrees of freedom held."""
    held = _six_supports(grid.nodes)
    plane = np.repeat(grid.plane, 3)
    plane[held] = -1
    order = np.argsort(plane, kind="stable")[len(held) :]
    ends = np.searchsorted(plane[order], np.arange(plane.max() + 2))
    matrix = sparse.csr_array(sparse.csr_array(stiffness[order])[:, order])
    right = columns[order]
    total = np.zeros((columns.shape[1],) * 2)
    diagonal, rhs = matrix[: ends[1], : ends[1]].toarray(), right[: ends[1]]
    for p in range(len(ends) - 1):
        here, after = slice(ends[p], ends[p + 1]), slice(ends[p + 1], ends[min(p + 2, len(ends) - 1)])
        root = np.linalg.cholesky(diagonal)
        width = after.stop - after.start
        solved = np.hstack([matrix[here, after].toarray(), rhs])
        solved = solve_triangular(root, solved, lower=True, overwrite_b=True, check_finite=False)
        beyond, own = solved[:, :width], solved[:, width:]
        total += own.T @ own
        diagonal = matrix[after, after].toarray() - beyond.T @ beyond
        rhs = right[after] - beyond.T @ own
    return total


def _six_supports(nodes: Array) -> NDArray[np.int64]:
    """Six degrees of freedom, of three nodes far from each other and from one line, that hold the rigid motions."""
    first = int(np.argmax(np.sum((nodes - nodes.mean(axis=0)) ** 2, axis=1)))
    second = int(np.argmax(np.sum((nodes - nodes[first]) ** 2, axis=1)))
    third = int(np.argmax(np.sum(np.cross(nodes[second] - nodes[first], nodes - nodes[first]) ** 2, axis=1)))
    candidates = np.array([3 * a + d for a in (first, second, third) for d in range(3)])
    *_, pivots = qr(rigid_motions(nodes)[candidates].T, pivoting=True, mode="economic")
    return candidates[pivots[:6]]


@njit(cache=True, nogil=True)
def add_moments(cell, place, fields, total):
    """Add Σ s^p u to total (8, c, u) over points in cells (n,) at s = place (n, 3), for fields u (n, u)."""
    count = fields.shape[1]
    flat, sloped = np.zeros(count), np.zeros(count)  # Σ u and Σ z u over the points of a row, where only z varies
    for v in range(len(cell)):
        z = place[v, 2]
        for u in range(count):
            flat[u] += fields[v, u]
            sloped[u] += z * fields[v, u]
        if (
            v + 1 < len(cell)
            and cell[v + 1] == cell[v]
            and place[v + 1, 0] == place[v, 0]
            and place[v + 1, 1] == place[v, 1]
        ):
            continue
        for p in range(4):
            power = (place[v, 0] if p & 2 else 1.0) * (place[v, 1] if p & 1 else 1.0)
            low, high = total[2 * p, cell[v]], total[2 * p + 1, cell[v]]
            for u in range(count):
                low[u] += power * flat[u]
                high[u] += power * sloped[u]
        flat[:] = 0.0
        sloped[:] = 0.0


@njit(cache=True, nogil=True)
def _add_moduli(cell, place, lam, mu, extent, total):
    for v in range(len(cell)):
        x, y, z = place[v]
        at = 0
        for a in (1.0, x, x * x + extent):
            for b in (a, a * y, a * (y * y + extent)):
                for c in (b, b * z, b * (z * z + extent)):
                    total[0, cell[v], at] += lam[v] * c
                    total[1, cell[v], at] += mu[v] * c
                    at += 1
