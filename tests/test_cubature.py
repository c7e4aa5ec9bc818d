from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from mjframes import relaxation
from mjframes.control import control_points
from mjframes.cubature import DEGREE, POINTS, cubature
from mjframes.grid import Grid, voxel_grid
from mjframes.material import Material
from mjframes.placement import place_frames
from mjframes.regions import split_regions
from mjframes.stiffness import region_stiffness
from mjframes.tree import elimination_tree
from mjframes.volume import Volume
from mjframes.voronoi import voronoi_weights

HALF = 0.5 / 3**0.5


@pytest.fixture
def index() -> np.ndarray:
    """A ragged thick plate far from the origin: 30 × 18 × 4 voxels, a third of them missing."""
    inside = np.random.default_rng(0).random((30, 18, 4)) < 2 / 3
    return (np.argwhere(inside) + np.array([500, 20, 7])).astype(np.int32)


@pytest.mark.parametrize("offsets", [np.zeros((1, 3)), np.array([[0, -HALF, 0], [0, HALF, 0]])])
def test_all_moments_up_to_the_degree(index, offsets):
    points, weights = cubature(index, offsets)
    assert len(points) == POINTS == 84
    low, high = index.min(axis=0), index.max(axis=0)
    every = ((index[:, None] + offsets).reshape(-1, 3) - (low + high) / 2) / (high - low)
    nodes = (points - (low + high) / 2) / (high - low)
    for powers in product(range(DEGREE + 1), repeat=3):
        if sum(powers) > DEGREE:
            continue
        exact = (every**powers).prod(axis=1) / len(offsets)
        error = weights @ (nodes**powers).prod(axis=1) - exact.sum()
        assert abs(error) < 1e-13 * np.abs(exact).sum() + 1e-14 * len(index)


def test_one_degree_more_is_not_exact(index):
    points, weights = cubature(index, np.zeros((1, 3)))
    middle, size = (index.min(axis=0) + index.max(axis=0)) / 2, np.ptp(index, axis=0)
    a, b = ((x - middle)[:, 0] / size[0] for x in (points, index))
    assert abs(weights @ a**8 - np.sum(b**8)) > 1e-5 * np.sum(b**8)


@pytest.mark.parametrize("types", [("affine",) * 3, ("affine", "quadratic", "quadratic")])
def test_stiffness_is_that_of_the_sum_over_all_voxels(types, monkeypatch: pytest.MonkeyPatch):
    grid: Grid = voxel_grid(Volume.from_labels(np.ones((33, 12, 6), np.uint8), 0.01, {1: Material(1e5, 0.4, 1000)}))
    weights = voronoi_weights(grid, place_frames(grid, 3))
    regions = split_regions(grid, weights, 4)
    control, tree = control_points(grid, weights, types), elimination_tree(regions.frames, 3)
    few = region_stiffness(grid, weights, control, regions, tree)
    monkeypatch.setattr(relaxation, "POINTS", 10**9)
    every = region_stiffness(grid, weights, control, regions, tree)
    for a, b in zip(few.matrix, every.matrix, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-10 * np.abs(b).max())
    for a, b in zip(few.gradient, every.gradient, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-12 * np.abs(b).max())
