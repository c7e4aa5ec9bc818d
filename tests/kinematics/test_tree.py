from __future__ import annotations

from itertools import combinations, product

import numpy as np
import pytest
from scipy import sparse

from mjframes.elasticity.regions import Regions
from mjframes.elasticity.regions import renumbered as named_anew
from mjframes.kinematics.tree import Tree, depth_first, depths, elimination_tree

CHAIN = [(i, i + 1) for i in range(8)]
NET = [(5 * a + b, 5 * a + b + 1, 5 * a + b + 5, 5 * a + b + 6) for a, b in product(range(4), range(4))]


def path(tree: Tree, i: int) -> list[int]:
    found = [i]
    while tree.parent[found[-1]] >= 0:
        found.append(int(tree.parent[found[-1]]))
    return found


@pytest.mark.parametrize(
    ("sets", "frames"),
    [
        (CHAIN, 9),
        (NET, 25),
        ([(0, 3), (1, 2)], 6),
        ([tuple(range(7))], 7),
        ([(0, i) for i in range(1, 8)], 8),
        ([(0,)], 1),
    ],
)
def test_coupled_frames_are_ancestor_and_descendant(sets, frames):
    tree = elimination_tree(sets, frames)
    for members in sets:
        for i, j in combinations(members, 2):
            assert i in path(tree, j) or j in path(tree, i)
    assert len({path(tree, i)[-1] for i in range(frames)}) == 1
    assert [len(path(tree, i)) for i in range(frames)] == depths(tree).tolist()


@pytest.mark.parametrize(("sets", "frames"), [(CHAIN, 9), (NET, 25), ([(0, 3), (1, 2)], 6)])
def test_order_is_depth_first(sets, frames):
    tree = elimination_tree(sets, frames)
    assert sorted(tree.order.tolist()) == list(range(frames))
    for previous, i in zip(tree.order[:-1], tree.order[1:], strict=True):
        assert tree.parent[i] in path(tree, int(previous))


def test_a_chain_of_nine_is_four_deep():
    assert depths(elimination_tree(CHAIN, 9)).max() == 4


def test_a_star_is_two_deep():
    tree = elimination_tree([(3, i) for i in (0, 1, 2, 4, 5)], 6)
    assert tree.parent.tolist() == [3, 3, 3, -1, 3, 3]


def test_a_net_is_much_shallower_than_a_chain():
    assert depths(elimination_tree(NET, 25)).max() <= 13
    assert np.sum(depths(elimination_tree(NET, 25)) ** 2) < 0.4 * np.sum(np.arange(1, 26) ** 2)


@pytest.mark.parametrize(
    ("sets", "frames", "squares"),
    [
        ([(i, i + 1) for i in range(16)], 17, 223),  # needs the higher price of separators
        ([(0, 3), (0, 6), (1, 3), (2, 6), (3, 4), (5, 6)], 7, 40),  # needs the lower one
        ([(0, 2), (0, 4), (0, 6), (1, 3), (3, 5), (3, 6), (4, 6)], 7, 45),  # part of a level set separates
        ([(0, 4), (0, 5), (1, 5), (2, 4), (2, 5), (3, 4), (3, 5)], 6, 36),  # minimum degree, with its fill
        ([(i, i + 1, i + 2) for i in range(15)], 17, 446),  # a band, 1785 as a chain
    ],
)
def test_factorization_is_cheap(sets, frames, squares):
    assert np.sum(depths(elimination_tree(sets, frames)) ** 2) == squares


def test_frames_without_coupling_hang_under_the_root():
    tree = elimination_tree([(0, 1)], 4)
    assert np.count_nonzero(tree.parent < 0) == 1
    assert depths(tree).max() == 2


def test_renumbering_moves_weights_regions_and_tree_alike():
    tree = Tree(parent=np.array([2, 0, -1, 2]), order=np.array([2, 0, 1, 3]))
    old = np.array([[0.1, 0.2, 0.7, 0], [0, 0, 0.4, 0.6]])
    regions = Regions(np.array([0, 1], np.int32), ((0, 1, 2), (2, 3)))
    weights, renumbered = depth_first(sparse.csr_array(old), tree)
    assert renumbered.order.tolist() == [0, 1, 2, 3]
    assert renumbered.parent.tolist() == [-1, 0, 1, 0]
    assert weights.toarray().tolist() == [[0.7, 0.1, 0.2, 0], [0.4, 0, 0, 0.6]]
    assert named_anew(regions, tree.order).frames == ((0, 1, 2), (0, 3))
