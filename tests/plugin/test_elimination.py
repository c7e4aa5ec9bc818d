"""Elimination of matrices whose rows begin late: nothing before that is read, and what it fills in is kept."""

from __future__ import annotations

import numpy as np
import pytest
from builders.harness import harness, pointer

LANES = 8  # rows begin at multiples of these
SHAPES = {
    "full": lambda k: 0,
    "band": lambda k: max(0, k - 30),
    "chain": lambda k: max(0, k // 40 * 40 - 40),
    "bridge": lambda k: k // 40 * 40 if k < 80 else 0,  # two blocks that have to do with each other by a third only
    "apart": lambda k: k // 24 * 24,
}


@pytest.mark.parametrize("n", [1, 7, 16, 17, 100, 150])
@pytest.mark.parametrize("shape", SHAPES)
def test_it_is_the_solution(shape: str, n: int) -> None:
    rng = np.random.default_rng(n)
    begin = np.array([SHAPES[shape](k) // LANES * LANES for k in range(n)], np.int32)
    known = (np.arange(n) <= np.arange(n)[:, None]) & (np.arange(n) >= begin[:, None])
    lower = np.where(known, rng.normal(size=(n, n)), 0)
    matrix = np.tril(lower, -1) + np.tril(lower, -1).T
    matrix += np.diag(1 + np.abs(matrix).sum(axis=1))
    right = rng.normal(size=n)
    x = right.copy()
    assert harness("elimination").solve(n, pointer(np.where(known, matrix, np.nan)), pointer(begin), pointer(x))
    np.testing.assert_allclose(matrix @ x, right, rtol=0, atol=1e-12 * n)


def test_a_matrix_that_is_not_positive_definite_is_told() -> None:
    matrix = np.diag([1.0, -1.0, 1.0])
    assert not harness("elimination").solve(3, pointer(matrix), pointer(np.zeros(3, np.int32)), pointer(np.ones(3)))
