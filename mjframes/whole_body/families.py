"""Which frames a region has: frame i and its parents pa(i), those that are coupled to i where it is eliminated.

Frames that share a voxel are coupled, and eliminating a frame couples its parents. Always that frame is eliminated next
whose region is the shortest. A region has one rotation. Where a body bends, a frame's own turn differs from it the
more, the farther the region reaches. In the order of the kinematic tree, whose first frame is in the middle, regions
reach over half of a bar, and a bar that a cable bends by 45° is a fifth too stiff.

The stiffness between frames that no region has together is only implied by others in between (`selection`). So frames
that are near each other are coupled, too, nearest first, as many as cost little more than the tree's order does. Where
all frames are coupled anyway, or short regions cost too much, as in large plates, the tree's order is taken.

Of several held frames only the first is eliminated last. A region of two held ends alone would carry all of a strap's
tension from end to end, and nothing in between would get stiffer sideways. Where more frames are held than free, as in
a running rat's flesh on its bones, short regions let go of bones that turn far: there the tree's order is taken, too.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from mjframes.kinematics.tree import components, eliminate, frame_tree, graph_of

Array = NDArray[np.float64]
Families = dict[int, tuple[int, ...]]

ALLOWED = 1.15  # [-] Σ n² of all regions of n frames, to the tree's: free steps of 5–20 frames take 1–1.16 times
ALIKE = 1e-6  # [-] of two lengths that count as one, to the longest of all: they differ by rounding


def families(coupled: Iterable[Iterable[int]], middle: Array, held: int) -> Families:
    """Return the parents pa(i), ascending, of each frame i; parents come before their children in the dictionary.

    coupled: sets of frames that share a voxel.  middle: (f, 3) of each frame.  held: how many frames, the first ones,
    are held. The first of all is eliminated last.
    """
    apart = np.linalg.norm(middle[:, None] - middle, axis=2)
    apart = np.round(apart / max(ALIKE * apart.max(), np.finfo(float).tiny))
    known = {pair for members in coupled for pair in combinations(sorted(members), 2)}
    known |= _bridges(known, apart)
    others = sorted(set(combinations(range(len(middle)), 2)) - known, key=lambda pair: (apart[pair], pair))
    tree = frame_tree(sorted(known), len(middle), held).order
    of_tree = _eliminated(known, tree[::-1].tolist())
    if (not others and held < 2) or 2 * held > len(middle):
        return of_tree
    allowed = ALLOWED * _cost(of_tree)

    def found(more: int) -> Families:
        return _shortest_first(known.union(others[:more]), apart, min(held, 1))

    more = bisect_right(range(1, len(others) + 1), allowed, key=lambda count: _cost(found(count)))
    return best if _cost(best := found(more)) <= allowed else of_tree


def _bridges(pairs: set[tuple[int, int]], apart: Array) -> set[tuple[int, int]]:
    """The nearest pairs that make one body of frames that share no voxels with the others."""
    found: set[tuple[int, int]] = set()
    while True:
        graph = graph_of(pairs | found, len(apart))
        first, *others = components(graph, set(graph))
        if not others:
            return found
        near, far = sorted(first), sorted(set(graph) - first)
        i, j = np.unravel_index(np.argmin(apart[np.ix_(near, far)]), (len(near), len(far)))
        found.add((min(near[i], far[j]), max(near[i], far[j])))


def _shortest_first(pairs: Iterable[tuple[int, int]], apart: Array, held: int) -> Families:
    """The families where always the shortest region is next, and of it the frame that is the farthest from the others.

    Of two frames the one nearer to the middle of the body stays: other regions follow the last one's shape.
    """
    left = graph_of(pairs, len(apart))

    def length(i: int) -> tuple[bool, float, float, float, int]:
        members = [i, *left[i]]
        reach = apart[np.ix_(members, members)].max()
        return i < held, reach, -apart[i, members].sum(), -apart[i].sum(), i

    lengths, found = {i: length(i) for i in left}, []
    while left:
        child = min(left, key=lengths.__getitem__)
        parents = eliminate(child, left)
        lengths.update((i, length(i)) for i in parents)
        found.append((child, tuple(sorted(parents))))
    return dict(reversed(found))


def _eliminated(pairs: Iterable[tuple[int, int]], order: Sequence[int]) -> Families:
    """The families where frames are eliminated in this order."""
    left = graph_of(pairs, len(order))
    return dict(reversed([(child, tuple(sorted(eliminate(child, left)))) for child in order]))


def _cost(some: Families) -> int:
    """Of a step, for the regions' blocks: Σ n²."""
    return sum((1 + len(parents)) ** 2 for parents in some.values())


def renamed(some: Mapping[int, Sequence[int]], order: NDArray[np.integer]) -> Families:
    """Return the same with frame order[i] called i."""
    number = np.argsort(order).tolist()
    return {number[i]: tuple(sorted(number[j] for j in parents)) for i, parents in some.items()}
