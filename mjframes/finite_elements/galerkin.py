"""Stiffness of the coarse nodes: A_c = Pᵀ A P, where P are the weights of each node's parents (see `coarsen`).

The finest matrix is never assembled. Its bricks are summed per coarse cell: those whose corners all depend on just the
eight coarse corners of their block through the trilinear matrices Q, from a table Qᵀ K Q a material and octant; the
others, at surfaces and where materials meet, pair by pair of corners.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import sparse

from mjframes.finite_elements.coarsen import Coarsening, Rows, neighbours, transposed
from mjframes.finite_elements.element import CORNERS
from mjframes.finite_elements.mesh import Mesh


class Blocks(NamedTuple):
    """A sparse symmetric matrix of 3 × 3 blocks.

    column: of each row, ascending.
    value: (b, 3, 3).
    """

    column: Rows
    value: NDArray[np.floating]


def from_bricks(mesh: Mesh, stiffness: NDArray[np.float64], coarsening: Coarsening) -> Blocks:
    """Return the matrix of the first coarse level. stiffness: (m, 24, 24) of a brick of each material."""
    count = len(coarsening.position)
    column = neighbours(coarsening.cells, count)
    used = Rows(np.concatenate([[0], np.cumsum(coarsening.into >= 0)]), coarsening.into[coarsening.into >= 0])
    children = transposed(used, len(coarsening.cells.modulus))
    place = mesh.place - mesh.position.min(axis=0)
    value = np.zeros((len(column.item), 3, 3))
    most = 3 * int(np.diff(coarsening.cells.node.start).max())
    _sum_bricks(
        *children,
        *coarsening.cells.node,
        mesh.nodes,
        mesh.material,
        place % 2 @ (4, 2, 1),
        stiffness,
        _octants(stiffness),
        *coarsening.parent,
        coarsening.weight,
        *column,
        np.empty(count, np.int32),
        np.empty((most, most)),
        value,
    )
    return Blocks(column, value)


def from_blocks(fine: Blocks, coarsening: Coarsening) -> Blocks:
    """Return the matrix of the next coarser level."""
    start, item = coarsening.parent
    weight = coarsening.weight[:, None, None] * np.eye(3)
    shape = (3 * (len(start) - 1), 3 * len(coarsening.position))
    interpolation = sparse.bsr_array((weight, item, start), shape=shape)
    matrix = sparse.bsr_array((fine.value, fine.column.item, fine.column.start), shape=(shape[0], shape[0]))
    coarse = interpolation.T @ (matrix @ interpolation)
    coarse.sort_indices()
    return Blocks(Rows(coarse.indptr.astype(np.int64), coarse.indices.astype(np.int32)), coarse.data)


def _octants(stiffness: NDArray[np.float64]) -> NDArray[np.float64]:
    """(m, 8, 24, 24) Qᵀ K Q of a brick in each octant of a coarse cell of its material."""
    tables = np.empty((len(stiffness), 8, 24, 24))
    for octant, offset in enumerate(CORNERS):
        at = (offset + CORNERS) / 2  # of the brick's corners in the coarse cell
        weights = np.prod(np.where(CORNERS[None] == 1, at[:, None], 1 - at[:, None]), axis=2)
        q = np.kron(weights, np.eye(3))
        tables[:, octant] = q.T @ stiffness @ q
    return tables


@njit(cache=True, nogil=True)
def _sum_bricks(
    child_start: NDArray[np.int64],
    child: NDArray[np.int32],
    cell_start: NDArray[np.int64],
    cell_node: NDArray[np.int32],
    nodes: NDArray[np.int32],
    material: NDArray[np.int32],
    octant: NDArray[np.integer],
    stiffness: NDArray[np.float64],
    octants: NDArray[np.float64],
    parent_start: NDArray[np.int64],
    parent: NDArray[np.int32],
    parent_weight: NDArray[np.float64],
    row_start: NDArray[np.int64],
    column: NDArray[np.int32],
    place: NDArray[np.int32],
    local: NDArray[np.float64],
    value: NDArray[np.float64],
) -> None:
    """place: (N',) of coarse nodes in their cell, and then of columns in their row.  local: a cell's own matrix."""
    for c in range(len(child_start) - 1):
        first = cell_start[c]
        count = cell_start[c + 1] - first
        for a in range(count):
            place[cell_node[first + a]] = a
        for a in range(3 * count):
            for b in range(3 * count):
                local[a, b] = 0.0
        for s in range(child_start[c], child_start[c + 1]):
            e = child[s]
            m, o = material[e], octant[e]
            parents = 0
            for p in range(8):
                parents += parent_start[nodes[e, p] + 1] - parent_start[nodes[e, p]]
            if count == 8 and parents == 27:
                for a in range(24):
                    for b in range(24):
                        local[a, b] += octants[m, o, a, b]
                continue
            for p in range(8):
                for q in range(8):
                    begin, end = parent_start[nodes[e, p]], parent_start[nodes[e, p] + 1]
                    first_other, last_other = parent_start[nodes[e, q]], parent_start[nodes[e, q] + 1]
                    for t in range(begin, end):
                        for u in range(first_other, last_other):
                            weight = parent_weight[t] * parent_weight[u]
                            a, b = 3 * place[parent[t]], 3 * place[parent[u]]
                            for i in range(3):
                                for j in range(3):
                                    local[a + i, b + j] += weight * stiffness[m, 3 * p + i, 3 * q + j]
        for a in range(count):
            row = cell_node[first + a]
            for t in range(row_start[row], row_start[row + 1]):
                place[column[t]] = t - row_start[row]
            for b in range(count):
                t = row_start[row] + place[cell_node[first + b]]
                for i in range(3):
                    for j in range(3):
                        value[t, i, j] += local[3 * a + i, 3 * b + j]
