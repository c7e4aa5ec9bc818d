from __future__ import annotations

import numpy as np
from builders.shapes import MATERIALS, STIFF, bar, mixed

from mjframes.base.constants import RIGID_RATIO
from mjframes.volume.grid import voxel_grid
from mjframes.volume.volume import Volume


def test_voxels_are_listed_in_c_order_and_looked_up():
    volume = mixed()
    grid = voxel_grid(volume)
    assert np.array_equal(grid.index, np.argwhere(volume.labels))
    assert np.array_equal(grid.lookup[tuple(grid.index.T)], np.arange(len(grid.index)))
    assert np.all(grid.lookup[volume.labels == 0] == -1)


def test_centers_follow_spacing_axes_and_origin():
    volume = mixed()
    grid = voxel_grid(volume)
    first, along_y = grid.lookup[0, 0, 0], grid.lookup[0, 1, 0]
    np.testing.assert_allclose(grid.centers[along_y] - grid.centers[first], volume.axes[:, 1] * 0.013, atol=1e-15)
    np.testing.assert_allclose(grid.centers[first], volume.origin + volume.axes @ [0.005, 0.0065, 0.004])
    assert np.isclose(grid.cell_volume, 0.01 * 0.013 * 0.008)


def test_each_voxel_has_its_material():
    grid = bar(1, 3, 4)
    assert np.array_equal(grid.label, [1, 3, 4])
    assert np.allclose(grid.young, [1e3, 8e4, RIGID_RATIO * 8e4])
    assert np.allclose(grid.compliance, [1e-3, 1.25e-5, 0])
    assert np.allclose([grid.lam[1], grid.mu[1]], STIFF.lame)
    assert np.allclose(grid.density, [1000, 1300, 1900])


def test_rigid_pieces_connect_over_corners():
    labels = np.ones((6, 3, 3), int)
    labels[0, 0, 0] = labels[1, 1, 1] = labels[5, 2, 2] = 4
    grid = voxel_grid(Volume.from_labels(labels, 0.01, MATERIALS))
    assert grid.piece[grid.lookup[0, 0, 0]] == grid.piece[grid.lookup[1, 1, 1]] == 0
    assert grid.piece[grid.lookup[5, 2, 2]] == 1
    assert np.count_nonzero(grid.piece >= 0) == 3
