from __future__ import annotations

import numpy as np

from mjframes.base.linear import ZERO, inverse_root, nonzero_eigenvectors, pseudo_inverse, scaled_eigenvectors

SIZES = 10.0 ** np.array([0, -3, 4, 2, -5, 0])  # of degrees of freedom, in units that differ


def matrix(rank: int = 4) -> np.ndarray:
    """Positive semi-definite, of that rank, of degrees of freedom of those sizes."""
    root = SIZES[:, None] * np.random.default_rng(0).normal(size=(len(SIZES), rank))
    return root @ root.T


def test_a_pseudo_inverse_is_one_whatever_the_units() -> None:
    some = matrix()
    inverse = pseudo_inverse(some)
    size = np.outer(SIZES, SIZES)
    np.testing.assert_allclose(some @ inverse @ some / size, some / size, atol=1e-9)
    np.testing.assert_allclose((inverse @ some @ inverse) * size, inverse * size, atol=1e-9)
    np.testing.assert_allclose(inverse_root(some) @ inverse_root(some).T * size, inverse * size, atol=1e-9)
    assert inverse_root(some).shape == (6, 4)


def test_what_has_nothing_on_the_diagonal_is_zero() -> None:
    some = np.diag([1.0, 0.0, 1e-20, 4.0])
    np.testing.assert_allclose(pseudo_inverse(some), np.diag([1, 0, 0, 0.25]), atol=1e-15)
    value, vector = scaled_eigenvectors(some)
    assert np.linalg.matrix_rank(vector) == 4
    assert np.count_nonzero(value > ZERO) == 2


def test_zero_has_no_inverse() -> None:
    assert np.array_equal(pseudo_inverse(np.zeros((3, 3))), np.zeros((3, 3)))
    assert nonzero_eigenvectors(np.zeros((0, 0)))[0].shape == (0,)


def test_a_tolerance_says_what_is_dependent() -> None:
    some = np.array([[1.0, 1 - 1e-7], [1 - 1e-7, 1.0]])
    assert inverse_root(some).shape == (2, 2)
    assert inverse_root(some, zero=1e-6).shape == (2, 1)
