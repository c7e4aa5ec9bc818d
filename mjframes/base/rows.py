"""Places of equal labels, and rows of lists that are alike, numbered in the order of appearance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse


def members_of(label: NDArray[np.int32], count: int) -> list[NDArray[np.int32]]:
    """Return the places of each label from 0 to count − 1, ascending; labels (n,) below 0 count as none."""
    places = np.flatnonzero(label >= 0).astype(np.int32)
    table = sparse.csr_array((np.ones(len(places), bool), (label[places], places)), shape=(count, len(label)))
    return np.split(table.indices.astype(np.int32, copy=False), table.indptr[1:-1])


def distinct_rows(start: NDArray[np.integer], item: NDArray[np.integer]) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Return the number (n,) of each row among the distinct ones, and the first row of each of these (r,), ascending.

    start: (n + 1,), item: row v is item[start[v] : start[v + 1]], and compared in that order.
    """
    length, items = np.diff(start).astype(np.int64), int(item.max(initial=0)) + 1
    label, end = length.copy(), int(length.max(initial=0))
    for place in range(end):  # labels of rows that have ended stay apart from those of longer ones
        longer = np.flatnonzero(length > place)
        pairs = label[longer] * items + item[start[longer] + place]
        label[longer] = np.unique(pairs, return_inverse=True)[1] + end + 1 + place * len(length)
    _, first, number = np.unique(label, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty(len(order), np.int32)
    rank[order] = np.arange(len(order))
    return rank[number], first[order]
