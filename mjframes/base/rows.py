"""Places of equal labels, by a counting sort; rows of lists that are alike, numbered in the order of appearance by a
hash table with open addressing.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray


def members_of(label: NDArray[np.int32], count: int) -> list[NDArray[np.int32]]:
    """Return the places of each label from 0 to count − 1, ascending; labels (n,) below 0 count as none."""
    end = np.zeros(count + 1, np.int64)
    places = np.empty(np.count_nonzero(label >= 0), np.int32)
    _sort_by_label(label, end, places)
    return np.split(places, end[:-2])


@njit(cache=True, nogil=True)
def _sort_by_label(label: NDArray[np.int32], end: NDArray[np.int64], places: NDArray[np.int32]) -> None:
    """Counting sort: label i's places become places[end[i − 1]:end[i]]."""
    for v in range(len(label)):
        if label[v] >= 0:
            end[label[v] + 1] += 1
    for i in range(1, len(end)):
        end[i] += end[i - 1]
    for v in range(len(label)):
        if label[v] >= 0:
            places[end[label[v]]] = v
            end[label[v]] += 1


def distinct_rows(start: NDArray[np.integer], item: NDArray[np.integer]) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Return the number (n,) of each row among the distinct ones, and the first row of each of these (r,), ascending.

    start: (n + 1,), item: row v is item[start[v] : start[v + 1]], and compared in that order.
    """
    label = np.empty(len(start) - 1, np.int32)
    # SciPy chooses the integers by the size: of one type they are compiled for once
    return label, _number(start.astype(np.int64), item.astype(np.int32), label)


@njit(cache=True, nogil=True)
def _number(start: NDArray[np.int64], item: NDArray[np.int32], label: NDArray[np.int32]) -> NDArray[np.int64]:
    """Fill the number of each row; return the first row of each number."""
    slots = 1024
    while slots < 2 * len(label):
        slots *= 2
    number = np.full(slots, -1, np.int32)
    first, count = np.empty(len(label), np.int64), 0
    for v in range(len(label)):
        low, high = start[v], start[v + 1]
        if v > 0 and _same(item, start[v - 1], start[v], low, high):
            label[v] = label[v - 1]
            continue
        at = _hash(item, low, high) & (slots - 1)
        while number[at] >= 0 and not _same(item, start[first[number[at]]], start[first[number[at]] + 1], low, high):
            at = (at + 1) & (slots - 1)
        if number[at] < 0:
            number[at], first[count] = count, v
            count += 1
        label[v] = number[at]
    return first[:count].copy()


@njit(cache=True, nogil=True)
def _same(item: NDArray[np.int32], low: Any, high: Any, other_low: int, other_high: int) -> bool:
    if high - low != other_high - other_low:
        return False
    k = low
    while k < high and item[k] == item[other_low + k - low]:
        k += 1
    return k == high


@njit(cache=True, nogil=True)
def _hash(item: NDArray[np.int32], low: Any, high: Any) -> np.int64:
    mixed = np.uint64(high - low)
    for k in range(low, high):
        mixed = (mixed ^ np.uint64(item[k])) * np.uint64(0x9E3779B97F4A7C15)
        mixed ^= mixed >> np.uint64(29)
    return np.int64(mixed >> np.uint64(8))
