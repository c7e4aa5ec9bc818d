"""Small volumes that several tests use."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from mjframes.grid import Grid, voxel_grid
from mjframes.material import Material
from mjframes.volume import Volume

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
