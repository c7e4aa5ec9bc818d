"""Families of frames: all that are coupled are in one, they are short, and the first held frame comes first."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
import pytest

from mjframes.kinematics.tree import frame_tree
from mjframes.whole_body.families import ALLOWED, families, renamed

ROW = np.arange(9.0)[:, None] * (1, 0, 0)
PAIRS = np.array([(x, y, 0.0) for x in range(6) for y in range(2)])
PLATE = np.array([(x, y, 0.0) for x in range(8) for y in range(8)])
RING = np.array([(np.cos(a), np.sin(a), 0) for a in np.linspace(0, 2 * np.pi, 8, endpoint=False)])


def near(middle: np.ndarray, reach: float) -> list[tuple[int, ...]]:
    """Each two frames that are closer than `reach`."""
    pairs = combinations(range(len(middle)), 2)
    return [(i, j) for i, j in pairs if np.linalg.norm(middle[i] - middle[j]) < reach]


def mixed(middle: np.ndarray) -> np.ndarray:
    return np.random.default_rng(0).permutation(middle)


@pytest.mark.parametrize("held", [0, 2])
@pytest.mark.parametrize(("middle", "reach"), [(ROW, 1.1), (mixed(ROW), 2.1), (mixed(PAIRS), 1.5), (RING, 1.0)])
def test_what_elimination_couples_is_in_one_family(middle: np.ndarray, reach: float, held: int) -> None:
    found = families(near(middle, reach), middle, held)
    place = {i: number for number, i in enumerate(found)}
    assert sorted(found) == list(range(len(middle)))
    assert held == 0 or next(iter(found)) == 0
    for i, parents in found.items():
        assert all(place[j] < place[i] for j in parents)
        for j, k in combinations(parents, 2):
            assert j in found[k] or k in found[j]
    for i, j in near(middle, reach):
        assert i in found[j] or j in found[i]


def of_the_tree(pairs: Sequence[tuple[int, ...]], frames: int) -> list[set[int]]:
    """Each frame and its ancestors in the kinematic tree that elimination couples it to."""
    order = frame_tree(pairs, frames).order[::-1].tolist()
    left = {i: {i, *(j for pair in pairs if i in pair for j in pair)} for i in order}
    found = []
    for place, i in enumerate(order):
        found.append(left[i])
        for j in left[i] - set(order[: place + 1]):
            left[j] |= left[i] - set(order[: place + 1])
    return found


@pytest.mark.parametrize(("middle", "reach", "shorter"), [(ROW, 1.1, 0.6), (PAIRS, 1.5, 0.8)])
def test_regions_are_short_at_little_cost(middle: np.ndarray, reach: float, shorter: float) -> None:
    """In whatever order the frames come; the kinematic tree couples the ends of a half to its middle."""
    middle = mixed(middle)
    pairs = near(middle, reach)
    found = [{i, *parents} for i, parents in families(pairs, middle, 0).items()]
    others = of_the_tree(pairs, len(middle))
    mean, before = (np.mean([np.ptp(middle[list(some)], axis=0).max() for some in each]) for each in (found, others))
    assert mean < shorter * before
    assert sum(len(some) ** 2 for some in found) <= ALLOWED * sum(len(some) ** 2 for some in others)


@pytest.mark.parametrize(("middle", "reach"), [(mixed(PLATE), 1.1), (mixed(PLATE), 1.5), (mixed(PAIRS), 1.1)])
def test_they_never_cost_much_more_than_the_trees(middle: np.ndarray, reach: float) -> None:
    pairs = near(middle, reach)
    cost = sum((1 + len(parents)) ** 2 for parents in families(pairs, middle, 0).values())
    assert cost <= ALLOWED * sum(len(some) ** 2 for some in of_the_tree(pairs, len(middle)))


def test_frames_that_share_no_voxels_are_bridged() -> None:
    """A body is one piece, whatever its frames share."""
    found = families([(0, 1), (2, 3)], ROW[[0, 1, 3, 4]], 0)
    assert 2 in found[1] or 1 in found[2]
    assert list(families([], ROW[:1], 0).items()) == [(0, ())]


def test_of_one_set_the_farthest_goes_first() -> None:
    """What remains of it is shorter."""
    middle = np.array([(0.0, 0, 0), (3.0, 0, 0), (1.0, 0, 0), (2.0, 0, 0), (-1.0, 0, 0)])
    found = families([(0, 1, 2, 3), (0, 4)], middle, 1)
    assert {i: parents for i, parents in found.items() if i != 4} == {0: (), 2: (0,), 3: (0, 2), 1: (0, 2, 3)}


def test_where_all_are_coupled_the_order_is_the_trees() -> None:
    order = frame_tree([tuple(range(9))], 9).order
    found = families([tuple(range(9))], mixed(ROW), 0)
    assert list(found) == order.tolist()
    assert all(parents == tuple(sorted(order[:place])) for place, parents in enumerate(found.values()))


def test_between_two_held_frames_each_follows_its_neighbours() -> None:
    """A strap that is pulled by its ends: the pull goes from frame to frame, and not through a region of both ends."""
    ends_first = ROW[[0, 8, *range(1, 8)]]
    found = families(near(ends_first, 1.1), ends_first, 2)
    assert max(np.ptp(ends_first[[i, *parents], 0]) for i, parents in found.items()) < 4
    assert not any({0, 1} <= {i, *parents} for i, parents in found.items())


def test_names_follow_the_tree() -> None:
    assert list(renamed({2: (), 0: (2,), 1: (0, 2)}, np.array([1, 2, 0])).items()) == [(1, ()), (2, (1,)), (0, (1, 2))]
