"""The kinematic tree as the elimination tree of the frames (sparse Cholesky's, George and Liu 1981; the paper's (7)).

Frames that move the same voxels are coupled. MuJoCo's mass matrix stores ancestor–descendant pairs only and factors
them from the leaves up, without fill; in an elimination tree every coupled pair, and every pair that elimination
couples, is such a pair. The order of elimination is nested dissection by level sets or minimum degree, whichever
gives the smallest Σ_i depth_i², which is what factorization costs.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

Graph = dict[int, set[int]]

SEPARATOR_PRICES = (2, 3)  # [frames] one deepens all that hangs below it; 2 is better for nets, 3 for chains


@dataclass(frozen=True, eq=False)
class Tree:
    """One tree of f frames.

    parent: (f,) int, −1 at the root.
    order: (f,) depth first, so parents before children.
    """

    parent: NDArray[np.int64]
    order: NDArray[np.int64]


def elimination_tree(sets: Iterable[Sequence[int]], frames: int) -> Tree:
    """Return the tree of `frames` frames in which the frames of each of `sets` lie on one path from the root."""
    graph = graph_of(sets, frames)
    orders = [_minimum_degree(graph), *(_nested_dissection(graph, price) for price in SEPARATOR_PRICES)]
    trees = [_rooted(_parents(graph, order)) for order in orders]
    return min(trees, key=lambda tree: int(np.sum(depths(tree) ** 2)))


def graph_of(sets: Iterable[Sequence[int]], frames: int) -> Graph:
    """Return the neighbours of each of `frames` frames: those that are in one of `sets` with it."""
    graph: Graph = {i: set() for i in range(frames)}
    for i, j in (pair for members in sets for pair in combinations(members, 2)):
        graph[i].add(j)
        graph[j].add(i)
    return graph


def eliminate(frame: int, graph: Graph) -> set[int]:
    """Take a frame out of a graph, couple its neighbours to each other, and return them."""
    neighbours = graph.pop(frame)
    for i in neighbours:
        graph[i] |= neighbours
        graph[i] -= {frame, i}
    return neighbours


def depths(tree: Tree) -> NDArray[np.int64]:
    """Return how many frames (f,) lie on the path from the root to each, itself included."""
    depth = np.ones(len(tree.parent), np.int64)
    for i in tree.order[1:]:
        depth[i] = depth[tree.parent[i]] + 1
    return depth


def _parents(graph: Graph, order: list[int]) -> list[int]:
    """Parent of each frame: the first that is eliminated after it among those coupled to it by then; −1 for none."""
    rank = {i: r for r, i in enumerate(order)}
    coupled = {i: set(neighbours) for i, neighbours in graph.items()}
    parent = [-1] * len(order)
    for i in order:
        later = {j for j in coupled[i] if rank[j] > rank[i]}
        if later:
            parent[i] = min(later, key=lambda j: rank[j])
            coupled[parent[i]] |= later - {parent[i]}
    return parent


def _rooted(parent: list[int]) -> Tree:
    """One tree, in depth-first order; the roots of unconnected graphs hang under the first root."""
    first, *others = [i for i, p in enumerate(parent) if p < 0]
    joined = np.array(parent)
    joined[others] = first
    children = [np.flatnonzero(joined == i) for i in range(len(parent))]
    order, waiting = [], [first]
    while waiting:
        i = waiting.pop()
        order.append(i)
        waiting.extend(children[i][::-1].tolist())
    return Tree(joined, np.array(order))


def _minimum_degree(graph: Graph) -> list[int]:
    """Always the frame with the fewest couplings next, its neighbours coupled to each other thereby."""
    left = {i: set(neighbours) for i, neighbours in graph.items()}
    order = []
    while left:
        order.append(min(left, key=lambda j: (len(left[j]), j)))
        eliminate(order[-1], left)
    return order


def _nested_dissection(graph: Graph, price: int) -> list[int]:
    """The parts that a separator leaves first, each dissected in turn, then the separator."""
    order: list[int] = []
    waiting = [set(graph)]
    while waiting:  # filled from the back: separators come off first
        component = waiting.pop()
        for part in components(graph, component):
            separator = _separator(graph, part, price)
            order.extend(sorted(separator))
            if rest := part - separator:
                waiting.append(rest)
    return order[::-1]


def _separator(graph: Graph, part: set[int], price: int) -> set[int]:
    """The cheapest of the level sets around every frame, at `price` a frame plus the largest component it leaves."""
    cheapest, lowest = part, price * len(part)  # all of the part, where nothing separates it
    for start in sorted(part):
        for level, beyond in pairwise(_levels(graph, part, start)[1:]):
            separator = {i for i in level if graph[i] & beyond}
            cost = price * len(separator) + max(len(c) for c in components(graph, part - separator))
            if cost < lowest:
                cheapest, lowest = separator, cost
    return cheapest


def _levels(graph: Graph, part: set[int], start: int) -> list[set[int]]:
    levels, seen = [{start}], {start}
    while beyond := set().union(*(graph[i] for i in levels[-1])) & part - seen:
        levels.append(beyond)
        seen |= beyond
    return levels


def components(graph: Graph, part: set[int]) -> list[set[int]]:
    """Return the connected components of a part of a graph."""
    found, left = [], set(part)
    while left:
        component = set().union(*_levels(graph, left, min(left)))
        found.append(component)
        left -= component
    return found


def frame_tree(sets: Iterable[Sequence[int]], frames: int, fixed: int = 0) -> Tree:
    """Return the elimination tree of `frames` frames, the first `fixed` of which do not move and stand alone, in front.

    sets: frames that are coupled to each other. Fixed ones have no degrees of freedom: what they couple is not coupled
    by them.
    """
    tree = elimination_tree([[i - fixed for i in members if i >= fixed] for members in sets], frames - fixed)
    parent = np.where(tree.parent < 0, -1, tree.parent + fixed)
    alone = np.arange(fixed)
    return Tree(np.concatenate([np.full(fixed, -1), parent]), np.concatenate([alone, tree.order + fixed]))


def depth_first(weights: sparse.csr_array, tree: Tree) -> tuple[sparse.csr_array, Tree]:
    """Return the same with frames numbered in the tree's order, which is the order in which MuJoCo numbers bodies."""
    number = np.argsort(tree.order)
    parent = tree.parent[tree.order]
    parent = np.where(parent < 0, -1, number[parent])
    columns = sparse.csr_array(weights[:, tree.order])
    columns.sort_indices()
    return columns, Tree(parent=parent, order=np.arange(len(parent)))
