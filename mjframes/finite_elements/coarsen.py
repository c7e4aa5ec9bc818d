"""Coarser and coarser nodes for a body's mesh: what is apart, or apart but for soft material, stays apart.

A node at place x (three integers) depends on the coarse nodes at ⌊x/2⌋ and ⌈x/2⌉ along each axis: it is the mean of
its one to eight parents (trilinear). So rigid motions are kept: exactly, but for nodes that depend on two places in
just the same way, which are merged into one. There may be several coarse nodes at one place: take the nodes that depend
on the place, and connect those that share a cell (a set of nodes that interact, at first those of a brick). Every
connected part gets a coarse node of its own. So two sheets with a gap are never glued.

A cell connects only nodes around which nothing is much stiffer than itself. So neither are two bones glued by a soft
joint, nor is flesh to the bone in it: a coarse function that moves the bone strains one fine layer of flesh, no more.
This keeps the number of iterations small however different the materials are.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import sparse

from mjframes.base.rows import distinct_rows
from mjframes.volume.grid import root_of

Ints = NDArray[np.int32]

WEAK = 0.06  # [-] to the stiffest modulus around a node: softer cells do not connect it


class Rows(NamedTuple):
    """A list of integers for each row: those of row i are item[start[i]:start[i + 1]]."""

    start: NDArray[np.int64]
    item: Ints


class LevelCells(NamedTuple):
    """Sets of nodes that interact.

    node: (c lists).
    modulus: (c,) of the stiffest inside [-].
    place: (c, 3).
    """

    node: Rows
    modulus: NDArray[np.float64]
    place: Ints


class Coarsening(NamedTuple):
    """From a level of N nodes in c cells to the next one of N'.

    parent: (N lists) ascending, none for a held node.
    weight: of each parent, in the same order; a node's sum to 1.
    child: (N' lists) ascending.
    position: (N', 3).
    cells: of the coarse level.
    into: (c,) the coarse cell that holds each cell, −1 for none.
    """

    parent: Rows
    weight: NDArray[np.float64]
    child: Rows
    position: Ints
    cells: LevelCells
    into: Ints


def coarsened(position: Ints, cells: LevelCells, held: NDArray[np.bool_], weak: float = WEAK) -> Coarsening:
    """Return the next coarser level of nodes at `position` (N, 3) ≥ 0, of which those where `held` (N,) do not move.

    weak: [-] to the stiffest modulus around a node, the least of a cell that connects it.
    """
    parent, weight, coarse = _parents(position, cells, held, weak)
    order = np.lexsort((cells.place // 2).T[::-1])
    place = cells.place[order] // 2
    new_place = np.append(True, (place[1:] != place[:-1]).any(axis=1))
    into, count = np.full(len(order), -1, np.int32), np.zeros(2, np.int64)
    most = int(np.sum(np.diff(parent.start)[cells.node.item]))
    start, item = np.zeros(len(order) + 1, np.int64), np.empty(most, np.int32)
    modulus, coarse_place = np.zeros(len(order)), np.empty_like(place)
    _merge_cells(
        order.astype(np.int32),
        new_place,
        place,
        *cells.node,
        cells.modulus,
        *parent,
        into,
        count,
        start,
        item,
        modulus,
        coarse_place,
    )
    c, total = count
    node = Rows(start[: c + 1].copy(), item[:total].copy())
    coarse_cells = LevelCells(node, modulus[:c].copy(), coarse_place[:c].copy())
    return Coarsening(parent, weight, transposed(parent, len(coarse)), coarse, coarse_cells, into)


def transposed(rows: Rows, count: int) -> Rows:
    """Return for each of `count` items the rows that have it, ascending."""
    pattern = _pattern(rows, count).tocsc()
    return Rows(pattern.indptr.astype(np.int64), pattern.indices.astype(np.int32))


def neighbours(cells: LevelCells, count: int) -> Rows:
    """Return for each of `count` nodes those that share a cell with it, itself too, ascending."""
    pattern = _pattern(cells.node, count)
    shared = sparse.csr_array(pattern.T @ pattern)
    shared.sort_indices()
    return Rows(shared.indptr.astype(np.int64), shared.indices.astype(np.int32))


def _pattern(rows: Rows, count: int) -> sparse.csr_array:
    return sparse.csr_array(
        (np.ones(len(rows.item), np.int32), rows.item, rows.start), shape=(len(rows.start) - 1, count)
    )


def _parents(
    position: Ints, cells: LevelCells, held: NDArray[np.bool_], weak: float
) -> tuple[Rows, NDArray[np.float64], Ints]:
    """The parents of each node, their weights, and the positions of the coarse nodes (N', 3)."""
    touch = transposed(cells.node, len(position))
    stiffest = np.zeros(len(position))
    np.maximum.at(stiffest, cells.node.item, np.repeat(cells.modulus, np.diff(cells.node.start)))
    size = position.max(axis=0) // 2 + 2
    number = np.where(held, 0, np.prod(1 + position % 2, axis=1))
    start = np.concatenate([[0], np.cumsum(number)])
    first = np.zeros(np.prod(size) + 1, np.int64)
    member, parent, root = (np.empty(start[-1], np.int32) for _ in range(3))
    place = np.empty((start[-1], 3), np.int32)
    _list_members(position, held, size, first, member)
    seen = np.full(len(cells.modulus), -1, np.int32)
    count = _split_places(
        first, member, size, *touch, cells.modulus, weak * stiffest, seen, root, start[:-1].copy(), parent, place
    )
    return _distinct(Rows(start, parent), place[:count])


def _distinct(parent: Rows, place: Ints) -> tuple[Rows, NDArray[np.float64], Ints]:
    """Parents, weights and positions without coarse nodes on which just the same nodes depend as on an earlier one.

    The nodes of a thin part depend on two layers of coarse nodes alike: one of them would make the matrix singular. The
    weight of those that go is added to the ones that stay.
    """
    child = transposed(parent, len(place))
    same, kept = distinct_rows(child.start, child.item)
    pattern = _pattern(Rows(parent.start, same[parent.item]), len(kept))
    share = 1 / np.maximum(np.diff(parent.start), 1)
    pattern.sum_duplicates()  # in place, `parent.start` too
    distinct = Rows(pattern.indptr.astype(np.int64), pattern.indices.astype(np.int32))
    return distinct, pattern.data * np.repeat(share, np.diff(distinct.start)), place[kept]


@njit(cache=True, nogil=True)
def _list_members(position: Ints, held: NDArray[np.bool_], size: Ints, first: NDArray[np.int64], member: Ints) -> None:
    """List the nodes that depend on each coarse place p: member[first[p]:first[p + 1]], ascending."""
    for filling in range(2):
        for node in range(len(position)):
            i = len(position) - 1 - node  # backwards, as lists are filled from their ends
            if held[i]:
                continue
            a, b, c = position[i, 0], position[i, 1], position[i, 2]
            for x in range(a // 2, (a + 1) // 2 + 1):
                for y in range(b // 2, (b + 1) // 2 + 1):
                    for z in range(c // 2, (c + 1) // 2 + 1):
                        p = (x * size[1] + y) * size[2] + z
                        if filling:
                            first[p] -= 1
                            member[first[p]] = i
                        else:
                            first[p] += 1
        if not filling:
            for p in range(1, len(first)):
                first[p] += first[p - 1]


@njit(cache=True, nogil=True)
def _split_places(
    first: NDArray[np.int64],
    member: Ints,
    size: Ints,
    touch_start: NDArray[np.int64],
    touch: Ints,
    modulus: NDArray[np.float64],
    least: NDArray[np.float64],
    seen: Ints,
    root: Ints,
    filled: NDArray[np.int64],
    parent: Ints,
    place: Ints,
) -> int:
    """Give each connected part of each place's members a coarse node; return how many there are.

    least: (N,) the modulus from which on a cell connects a node.  seen: (c,) the last member that a cell has connected.
    root: of each member.  filled: (N,) how far each node's list of parents is filled.
    """
    count = 0
    for p in range(len(first) - 1):
        for t in range(first[p], first[p + 1]):
            root[t] = t
            i = member[t]
            for s in range(touch_start[i], touch_start[i + 1]):
                e: int = touch[s]
                if modulus[e] < least[i]:
                    continue
                if seen[e] >= first[p]:
                    one, other = root_of(root, seen[e]), root_of(root, t)
                    root[max(one, other)] = min(one, other)
                seen[e] = t
        for t in range(first[p], first[p + 1]):  # roots come before the rest of their part
            if root[t] == t:
                place[count, 0] = p // (size[1] * size[2])
                place[count, 1] = p // size[2] % size[1]
                place[count, 2] = p % size[2]
                root[t] = count
                count += 1
            else:
                root[t] = root[root[t]]
            parent[filled[member[t]]] = root[t]
            filled[member[t]] += 1
    return count


@njit(cache=True, nogil=True)
def _merge_cells(
    order: Ints,
    new_place: NDArray[np.bool_],
    place: Ints,
    start: NDArray[np.int64],
    node: Ints,
    modulus: NDArray[np.float64],
    parent_start: NDArray[np.int64],
    parent: Ints,
    into: Ints,
    count: NDArray[np.int64],
    begin: NDArray[np.int64],
    item: Ints,
    stiffest: NDArray[np.float64],
    places: Ints,
) -> None:
    """Fill the coarse cells: the sets of parents of the cells' nodes, equal ones of a place once."""
    first, cells, total = 0, 0, 0
    for o in range(len(order)):
        e = order[o]
        if new_place[o]:
            first = cells
        length = 0
        for s in range(start[e], start[e + 1]):
            for t in range(parent_start[node[s]], parent_start[node[s] + 1]):
                at = total + length
                while at > total and item[at - 1] > parent[t]:
                    at -= 1
                if at == total or item[at - 1] != parent[t]:
                    for q in range(total + length, at, -1):
                        item[q] = item[q - 1]
                    item[at] = parent[t]
                    length += 1
        if length == 0:
            continue
        same = cells
        for c in range(first, cells):
            equal = begin[c + 1] - begin[c] == length
            for q in range(length if equal else 0):
                equal = equal and item[begin[c] + q] == item[total + q]
            if equal:
                same = c
        if same == cells:
            cells += 1
            total += length
            begin[cells] = total
            for d in range(3):
                places[same, d] = place[o, d]
        into[e] = same
        stiffest[same] = max(stiffest[same], modulus[e])
    count[0], count[1] = cells, total
