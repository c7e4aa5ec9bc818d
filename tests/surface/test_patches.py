"""Patches and clusters of contact vertices."""

from __future__ import annotations

import numpy as np
import pytest
from builders.shapes import block
from scipy import sparse

from mjframes.frames.placement import place_frames
from mjframes.kinematics.control import ControlPoints, control_points
from mjframes.surface.patches import CLUSTERS, FEW, Patches, group_patches
from mjframes.weights.voronoi import voronoi_weights

NORMALS = np.array([[1, 0.1, 0], [-1, 0.2, 0], [0, 1, 0.3], [0.1, -1, 0], [0, 0, 1], [0.2, 0, -1]])


def control(frames: int) -> ControlPoints:
    grid = block(20, 3, 3)
    return control_points(grid, voronoi_weights(grid, place_frames(grid, frames)))


@pytest.fixture
def vertices() -> tuple[np.ndarray, np.ndarray, sparse.csr_array]:
    """300 random ones: centers, normals, weights on the points of one or two of four frames."""
    rng = np.random.default_rng(0)
    normals = rng.normal(size=(300, 3))
    weights = np.zeros((300, 4, 4))
    for row, (i, j) in zip(weights, rng.integers(4, size=(300, 2)), strict=True):
        row[[i, j]] = rng.random((1 if i == j else 2, 4)) + 0.1
    return rng.random((300, 3)), normals, sparse.csr_array(weights.reshape(300, 16))


def members(patches: Patches, patch: int) -> np.ndarray:
    return patches.order[patches.patch == patch]


def test_every_vertex_is_in_one_patch(vertices) -> None:
    centers, normals, weights = vertices
    patches = group_patches(centers, normals, weights, control(4))
    assert sorted(patches.order) == list(range(300))
    assert np.array_equal(np.unique(patches.patch), np.arange(patches.patch.max() + 1))
    assert np.all(np.diff(100 * patches.patch + patches.cluster) >= 0)


def test_a_patch_has_one_deepest_frame_and_faces_one_way(vertices) -> None:
    centers, normals, weights = vertices
    patches = group_patches(centers, normals, weights, control(4))
    deepest = np.array([weights[[s]].indices.max() // 4 for s in range(300)])
    axis = np.abs(normals).argmax(axis=1)
    kind = 6 * deepest + 2 * axis + (normals[np.arange(300), axis] > 0)
    for number in range(patches.patch.max() + 1):
        own = members(patches, number)
        assert len(np.unique(deepest[own])) == 1
        joined = np.unique(kind[own], return_counts=True)[1]
        assert np.sum(joined >= FEW) <= 1  # others are too few for a patch


def test_few_vertices_join_the_next_smallest_patch_of_their_frame() -> None:
    counts = [40, 30, 3, 7, 12, 1]  # facing −x, +x, −y, +y, −z, +z
    facing = np.repeat(np.arange(6), counts)
    normals = np.zeros((len(facing), 3))
    normals[np.arange(len(facing)), facing // 2] = 2.0 * (facing % 2) - 1
    centers, weights = np.random.default_rng(0).random((93, 3)), sparse.csr_array(np.full((93, 4), 0.25))
    patches = group_patches(centers, normals, weights, control(1))
    found = [np.unique(facing[members(patches, p)]).tolist() for p in range(patches.patch.max() + 1)]
    assert sorted(found) == [[0], [1], [2, 3, 5], [4]]


def test_small_patches_stay_where_all_are_small() -> None:
    facing = np.repeat(np.arange(6), 4)
    normals = NORMALS[[1, 0, 3, 2, 5, 4]][facing]
    centers, weights = np.random.default_rng(0).random((24, 3)), sparse.csr_array(np.full((24, 4), 0.25))
    assert np.bincount(group_patches(centers, normals, weights, control(1)).patch).tolist() == [4] * 6


def test_a_small_frame_keeps_faces_that_are_alike() -> None:
    """A foot of a large body: it stands on one of them."""
    counts = [60] * 6 + [7] * 6  # of a frame, then of another
    kind = np.repeat(np.arange(12), counts)
    normals = NORMALS[[1, 0, 3, 2, 5, 4]][kind % 6]
    weights = np.zeros((len(kind), 8))
    weights[np.arange(len(kind)), 4 * (kind // 6)] = 1
    centers = np.random.default_rng(0).random((len(kind), 3))
    patches = group_patches(centers, normals, sparse.csr_array(weights), control(2))
    assert np.bincount(patches.patch).tolist() == counts


def test_patches_are_in_the_order_of_their_bodies(vertices) -> None:
    centers, normals, weights = vertices
    patches = group_patches(centers, normals, weights, control(4))
    deepest = [weights[[s]].indices.max() // 4 for s in patches.order]
    assert np.all(np.diff(deepest) >= 0)


def test_clusters_are_few_numbered_and_compact() -> None:
    rng = np.random.default_rng(1)
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    centers = (corners[:, None] + 0.1 * rng.random((4, 10, 3))).reshape(-1, 3)[rng.permutation(40)]
    normals, weights = np.tile([0.0, 0, 1], (40, 1)), sparse.csr_array(np.full((40, 4), 0.25))
    patches = group_patches(centers, normals, weights, control(1))
    assert np.array_equal(np.unique(patches.cluster), np.arange(CLUSTERS))
    for cluster in range(CLUSTERS):
        assert np.ptp(centers[patches.order[patches.cluster == cluster]], axis=0).max() < 0.11


@pytest.mark.parametrize(("centers", "clusters"), [(np.zeros((5, 3)), 1), (np.diag([1.0, 2, 3])[:2], 2)])
def test_few_places_make_few_clusters(centers: np.ndarray, clusters: int) -> None:
    count = len(centers)
    normals, weights = np.tile([0.0, 0, 1], (count, 1)), sparse.csr_array(np.full((count, 4), 0.25))
    patches = group_patches(centers, normals, weights, control(1))
    assert np.array_equal(np.unique(patches.cluster), np.arange(clusters))


def test_six_directions_make_six_patches() -> None:
    weights = sparse.csr_array(np.full((6, 4), 0.25))
    assert group_patches(np.random.default_rng(0).random((6, 3)), NORMALS, weights, control(1)).patch.max() == 5
