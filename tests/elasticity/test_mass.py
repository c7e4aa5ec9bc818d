"""Masses of bodies whose points are on several branches of the kinematic tree."""

from __future__ import annotations

import numpy as np

from mjframes.elasticity.mass import uncoupled

BRANCH = np.repeat([0, 0, 1, 2], 4)  # of four frames with four points each


def weights(rng: np.random.Generator) -> np.ndarray:
    """(voxels, points) as of affine frames: their sum is 1; where frames meet, some are negative."""
    middle, places = rng.normal(size=(4, 3)), rng.normal(size=(200, 3))
    frames = np.exp(-(np.linalg.norm(places[:, None] - middle, axis=2) ** 2))
    frames /= frames.sum(axis=1, keepdims=True)
    along = (places[:, None] - middle) / 0.5
    corners = np.concatenate([along, 1 - along.sum(axis=2, keepdims=True)], axis=2)
    return (frames[:, :, None] * corners).reshape(200, 16)


def difference(shares: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The consistent mass of voxels of 1 kg, and what it is beyond its row sums."""
    consistent = shares.T @ shares
    return consistent, consistent - np.diag(consistent.sum(axis=1))


def test_mass_without_couplings_of_branches_is_positive_definite_and_moves_alike() -> None:
    for seed in range(20):
        consistent, coupled = difference(weights(np.random.default_rng(seed)))
        found = uncoupled(coupled, BRANCH)
        total = found + np.diag(consistent.sum(axis=1))
        assert not total[BRANCH[:, None] != BRANCH].any()
        np.testing.assert_allclose(found.sum(axis=1), 0, atol=1e-9)
        np.testing.assert_array_equal(found, found.T)
        assert np.linalg.eigvalsh(total)[0] > 0.9 * np.linalg.eigvalsh(consistent)[0]


def test_mass_of_one_branch_stays() -> None:
    _, coupled = difference(weights(np.random.default_rng(0)))
    np.testing.assert_array_equal(uncoupled(coupled, np.zeros(16, int)), coupled)


def test_branches_that_touch_without_a_voxel_in_common_share_next_to_nothing() -> None:
    shares = weights(np.random.default_rng(0))
    first = shares[:, :4].sum(axis=1) > 0.3
    shares[first, 4:] = shares[~first, :4] = 0
    _, coupled = difference(shares)
    coupled[0, 12] = coupled[12, 0] = -1e-9
    coupled[1, 13] = coupled[13, 1] = 1e-9
    found = uncoupled(coupled, BRANCH)
    assert np.isfinite(found).all()
    np.testing.assert_allclose(found[:4, :4], coupled[:4, :4], atol=2e-9)
