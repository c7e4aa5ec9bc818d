"""Small volumes that several tests use."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.spatial.transform import Rotation

from examples.kernels import NODES, plate
from mjframes.base.constants import NEGLIGIBLE_WEIGHT
from mjframes.frames.placement import Placement, place_frames
from mjframes.volume.grid import Grid, voxel_grid
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

SOFT, FIRM, STIFF = Material(1e3, 0.45, 1000), Material(5e3, 0.3, 1100), Material(8e4, 0.2, 1300)
BONE = Material.rigid(1900)
MATERIALS = {1: SOFT, 2: FIRM, 3: STIFF, 4: BONE}


def bar(*labels: int, spacing: float = 0.01) -> Grid:
    """One row of voxels along x."""
    return voxel_grid(Volume.from_labels(np.array(labels).reshape(-1, 1, 1), spacing, MATERIALS))


def block(*shape: int, label: int = 1, spacing: float = 0.01) -> Grid:
    """A homogeneous box."""
    return voxel_grid(Volume.from_labels(np.full(shape, label), spacing, MATERIALS))


def mixed() -> Volume:
    """Three materials, two bones and a hole; voxels are no cubes, axes are turned, the origin is off."""
    labels = np.ones((16, 9, 6), np.uint8)
    labels[:, 5:, :3] = 2
    labels[6:9, :, 2:4] = 3
    labels[2:5, 2:5, 1:4] = 4
    labels[12:14, 6:9, 2:5] = 4
    labels[9:12, 3:5, :] = 0
    axes = Rotation.from_rotvec([0.3, -0.5, 0.9]).as_matrix()
    return Volume(labels, np.array([0.01, 0.013, 0.008]), np.array([0.2, -0.1, 0.4]), axes, MATERIALS)


def plate_of_figure_6() -> tuple[Grid, Placement, dict[str, np.ndarray]]:
    """A plate with an arm: the red node on the left, one to the right of the arm's foot, one at the arm's tip."""
    grid = voxel_grid(plate())
    x, y, _ = grid.index.T
    places = {
        "between the nodes": (x > 12) & (x < 28),
        "arm, foot": (x >= 30) & (x < 40) & (y >= 20) & (y < 28),
        "arm, upper half": (y >= 41) & (y < 52),
        "right end": x >= 65,
    }
    return grid, place_frames(grid, at=NODES), {name: np.flatnonzero(where) for name, where in places.items()}


def thread_of_three_arms(
    first: int = 16, second: int = 8, label: int = 1
) -> tuple[Grid, np.ndarray, tuple[np.ndarray, np.ndarray], float, float, float]:
    """Threads that meet in one voxel; two of them diagonal, so that neighbours touch at edges only.

    first, second: steps from the fork to the positions on the diagonal arms.  label: of the second arm.
    Returns the grid, a position on each arm, the third arm's voxels with their distance t from the fork, and the
    distances of the three positions from the fork [m].
    """
    size = 40
    labels = np.zeros((2 * size + 1, size + 61, 1), np.uint8)
    for step in range(1, size + 1):
        labels[size - step, size - step], labels[size + step, size - step] = 1, label
    labels[size, size:] = 1
    grid = voxel_grid(Volume.from_labels(labels, 0.01, MATERIALS))
    centers = np.array([[size - first, size - first, 0], [size + second, size - second, 0], [size, size + 60, 0]]) + 0.5
    arm = grid.lookup[size, size:, 0]
    root = 0.01 * np.sqrt(2)
    return grid, 0.01 * centers, (arm, 0.01 * np.arange(len(arm))), first * root, second * root, 0.6


def check_kernel(grid: Grid, placement: Placement, weights: sparse.csr_array) -> None:
    """A partition of unity in [0, 1], one at its own frame and zero at the others, constant in each rigid piece."""
    dense = weights.toarray()
    np.testing.assert_allclose(dense.sum(axis=1), 1, atol=1e-12)
    assert weights.data.min() >= NEGLIGIBLE_WEIGHT
    assert weights.data.max() <= 1
    for i, seed in enumerate(placement.seeds):
        np.testing.assert_array_equal(dense[seed], np.tile(np.eye(len(placement.seeds))[i], (len(seed), 1)))
    for piece in range(grid.piece.max() + 1):
        assert np.ptp(dense[grid.piece == piece], axis=0).max() == 0
