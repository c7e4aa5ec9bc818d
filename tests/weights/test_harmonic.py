from __future__ import annotations

import numpy as np
import pytest
from builders.shapes import MATERIALS, bar, block, check_kernel, mixed, thread_of_three_arms
from scipy import sparse
from scipy.sparse.linalg import spsolve

from mjframes.base.constants import NEGLIGIBLE_WEIGHT
from mjframes.frames.placement import place_frames
from mjframes.volume.grid import voxel_grid
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume
from mjframes.weights import harmonic
from mjframes.weights.harmonic import harmonic_weights


def test_bar_of_three_materials_has_the_ideal_weights():
    grid = bar(*[1] * 7, *[3] * 5, *[4] * 3, *[2] * 9)
    step = (grid.compliance[1:] + grid.compliance[:-1]) / 2
    ideal = 1 - np.concatenate([[0], np.cumsum(step)]) / step.sum()  # equation (5)
    ideal[np.abs(ideal) < NEGLIGIBLE_WEIGHT] = 0
    weights = harmonic_weights(grid, place_frames(grid, at=grid.centers[[0, -1]])).toarray()
    np.testing.assert_allclose(weights, np.stack([ideal, 1 - ideal], axis=1), atol=1e-6)


@pytest.mark.parametrize("direct", [0, 10**9])
def test_heat_balance_at_every_free_voxel(direct, monkeypatch: pytest.MonkeyPatch):
    if not direct:
        pytest.importorskip("pyamg")
    monkeypatch.setattr(harmonic, "DIRECT", direct)
    labels = np.ones((14, 8, 5), np.uint8)
    labels[5:9, 2:6] = 3
    spacing = np.array([0.01, 0.013, 0.008])
    grid = voxel_grid(Volume.from_labels(labels, spacing, MATERIALS))
    ends = [grid.lookup[0].ravel(), grid.lookup[13, :4].ravel(), grid.lookup[13, 4:].ravel()]
    weights = harmonic_weights(grid, place_frames(grid, 0, cores=ends)).toarray()
    flow = np.zeros_like(weights)
    image = grid.lookup
    for axis in range(3):
        ahead = np.moveaxis(image, axis, 0)
        u, v = ahead[:-1].ravel(), ahead[1:].ravel()
        face = grid.cell_volume / spacing[axis]
        modulus = 2 * grid.young[u] * grid.young[v] / (grid.young[u] + grid.young[v])
        through = (face * modulus / spacing[axis])[:, None] * (weights[v] - weights[u])
        np.add.at(flow, u, through)
        np.add.at(flow, v, -through)
    free = np.setdiff1d(np.arange(len(flow)), np.concatenate(ends))
    # Dropping negligible weights is the only error.
    assert np.abs(flow[free]).max() < 1e-5 * np.abs(flow).max()


def test_all_load_paths_count():
    """A dead end hangs between two threads to frame 0 and one to frame 1, all equally long: twice the load there."""
    labels = np.zeros((41, 5, 1), np.uint8)
    labels[20:, 2] = labels[:20, [0, 4]] = labels[20, :] = 1
    grid = voxel_grid(Volume.from_labels(labels, 0.01, MATERIALS))
    ends = [grid.lookup[0, [0, 4], 0], grid.lookup[[40], 2, 0]]
    weights = harmonic_weights(grid, place_frames(grid, 0, cores=ends)).toarray()
    # 22 steps from frame 0, two ways at once, and 20 to frame 1
    np.testing.assert_allclose(weights[grid.lookup[20, 2, 0], 0], 20 / (20 + 11), atol=1e-6)


def test_voxels_that_touch_at_edges_only_are_connected():
    grid, at, arm, a, b, _ = thread_of_three_arms()
    weights = harmonic_weights(grid, place_frames(grid, at=at[:2])).toarray()
    fork = arm[0][0]
    np.testing.assert_allclose(weights[fork, 0], b / (a + b), atol=1e-6)
    np.testing.assert_allclose(weights[arm[0][1:]], np.tile(weights[fork], (len(arm[0]) - 1, 1)), atol=1e-6)


CASES = {
    "mixed": (voxel_grid(mixed()), 6),
    "plate": (block(20, 12, 1), 5),
    "single frame": (block(5, 4, 3), 1),
    "all frames": (bar(1, 4, 4, 1, 1), 4),
}


@pytest.mark.parametrize("name", CASES)
def test_partition_of_unity_interpolating_and_constant_in_rigid_pieces(name):
    grid, frames = CASES[name]
    placement = place_frames(grid, frames)
    weights = harmonic_weights(grid, placement)
    check_kernel(grid, placement, weights)


def test_a_single_voxel_is_no_core_in_three_dimensions():
    grid = block(21, 11, 11)
    weights = harmonic_weights(grid, place_frames(grid, at=[[0.025, 0.055, 0.055], [0.185, 0.055, 0.055]])).toarray()
    core = np.flatnonzero(weights[:, 0] == 1)
    assert len(core) > 20
    assert grid.lookup[2, 5, 5] in core
    middle = weights[grid.lookup[10, 5, 5], 0]
    assert np.isclose(middle, 0.5, atol=1e-3)


def test_multigrid_agrees_with_factorization():
    pytest.importorskip("pyamg")
    rng = np.random.default_rng(0)
    grid = block(14, 13, 12)
    near = [(u, v) for u, v in zip(grid.lookup[:-1].ravel(), grid.lookup[1:].ravel(), strict=True)]
    near += [(u, v) for u, v in zip(grid.lookup[:, :-1].ravel(), grid.lookup[:, 1:].ravel(), strict=True)]
    first, second = np.array(near).T
    value = 10 ** rng.uniform(-2, 2, len(first))
    n = len(grid.index)
    link = sparse.coo_array((value, (first, second)), shape=(n, n)).tocsr()
    link = link + link.T
    matrix = sparse.csr_array(sparse.diags_array(link.sum(axis=1) + (np.arange(n) % 97 == 0)) - link)
    b = rng.standard_normal(n)
    exact = np.asarray(spsolve(matrix.tocsc(), b))
    harmonic_direct = harmonic.DIRECT
    try:
        harmonic.DIRECT = 0
        found = harmonic._solver(matrix)(b)
        again = harmonic._solver(matrix)(b)
    finally:
        harmonic.DIRECT = harmonic_direct
    np.testing.assert_allclose(found, exact, atol=1e-5 * np.abs(exact).max())
    assert np.array_equal(found, again)


@pytest.mark.parametrize("pattern", ["threads", "seven materials", "sheets"])
def test_multigrid_converges_at_a_contrast_of_a_million(pattern, monkeypatch: pytest.MonkeyPatch):
    """Soft corners in material of which a third is 1e6 times as stiff, about where it begins to hang together."""
    pytest.importorskip("pyamg")
    n, rng = 24, np.random.default_rng(2)
    labels = {
        "threads": 1 + 6 * (rng.random((n, n, n)) < 0.31),
        "seven materials": rng.integers(1, 8, (n, n, n)),
        "sheets": 1 + 6 * (np.indices((n, n, n))[0] % 3 == 0),
    }[pattern].astype(np.uint8)
    labels[:4, :4, :4] = labels[-4:, -4:, -4:] = 1
    materials = {i: Material(10.0 ** (2 + i), 0.3, 1000) for i in range(1, 8)}
    grid = voxel_grid(Volume.from_labels(labels, 0.005, materials))
    assert grid.young.max() == 1e6 * grid.young.min()
    placement = place_frames(grid, at=[[0.0075] * 3, [0.1125] * 3])
    monkeypatch.setattr(harmonic, "DIRECT", 10**9)
    exact = harmonic_weights(grid, placement).toarray()
    monkeypatch.setattr(harmonic, "DIRECT", 0)
    monkeypatch.setattr(harmonic, "ITERATIONS", 60)
    np.testing.assert_allclose(harmonic_weights(grid, placement).toarray(), exact, atol=1e-5)
    assert np.ptp(exact[:, 0]) > 0.9
