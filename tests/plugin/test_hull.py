"""The hull of voxels against SciPy's triangulation of the same centres."""

from __future__ import annotations

import time

import numpy as np
import pytest
from builders.shapes import MATERIALS
from scipy.spatial import Delaunay

from mjframes.base.errors import MjframesError
from mjframes.volume.hull import in_convex_hull
from mjframes.volume.volume import LARGEST_LABEL, Volume, require_connected


@pytest.mark.parametrize("seed", range(4))
def test_hull_of_scattered_voxels(seed: int) -> None:
    inside = np.random.default_rng(seed).random((17, 13, 11)) < 0.02
    inside[:, -1] = False
    centers = np.argwhere(np.ones_like(inside))
    expected = Delaunay(np.argwhere(inside)).find_simplex(centers, tol=1e-9) >= 0
    assert 400 < expected.sum() < inside.size
    np.testing.assert_array_equal(in_convex_hull(inside).ravel(), expected)


def test_a_box_is_its_own_hull_and_a_plate_has_none() -> None:
    box = np.zeros((6, 7, 8), bool)
    box[1:5, 2:6, 3:7] = True
    np.testing.assert_array_equal(in_convex_hull(box), box)
    plate = np.zeros((6, 7, 8), bool)
    plate[2, ::3, ::3] = True
    np.testing.assert_array_equal(in_convex_hull(plate), plate)


def test_a_hull_of_many_facets_takes_no_time() -> None:
    a, b, c = np.ogrid[:240, :240, :240]
    ball = (a - 120) ** 2 + (b - 120) ** 2 + (c - 120) ** 2 < 115**2
    in_convex_hull(ball[::20, ::20, ::20])  # compiled now
    start = time.perf_counter()
    hull = in_convex_hull(ball)
    assert time.perf_counter() - start < 5.0  # [s]; 18 where every column asks every facet
    np.testing.assert_array_equal(hull, ball)


def test_filling_joins_what_is_apart() -> None:
    labels = np.zeros((12, 5, 5), np.uint8)
    labels[:3], labels[9:, 1:4, 1:4] = 1, 4
    volume = Volume.from_labels(labels, 0.01, {1: MATERIALS[1], 4: MATERIALS[4]})
    filled = volume.filled(MATERIALS[2])
    require_connected(filled)
    np.testing.assert_array_equal(filled.labels[labels > 0], labels[labels > 0])
    assert set(np.unique(filled.labels).tolist()) == {0, 1, 4, 5}
    assert filled.materials[5] == MATERIALS[2]
    assert (filled.labels == 5)[6].sum() == 9  # a pyramid's middle
    np.testing.assert_array_equal(filled.origin, volume.origin)


def test_no_label_is_left_for_the_filling() -> None:
    labels = np.array([[[1, LARGEST_LABEL]]], np.uint32)
    volume = Volume.from_labels(labels, 0.01, {1: MATERIALS[1], LARGEST_LABEL: MATERIALS[2]})
    with pytest.raises(MjframesError, match="highest label is 4294967295"):
        volume.filled(MATERIALS[3])
