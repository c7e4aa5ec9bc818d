"""The paper's patch test: a uniform strain of several materials costs what Hooke's law says, whatever the frames.

With Σ_i w_i = 1 a frame that can be strained reproduces u = G p with any weights. One that cannot, only with weights
that reproduce their coordinate, and only strains along it: hats along x and G = g e_xᵀ. Of one material, as between
voxels of two the slope of a weight is shared out by their compliance, which is what other weights ask for.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from builders.shapes import MATERIALS
from scipy.spatial.transform import Rotation

from mjframes.body.build import build
from mjframes.body.options import Paper
from mjframes.body.soft_body import SoftBody
from mjframes.kinematics.control import control_weights
from mjframes.volume.grid import Grid, voxel_grid
from mjframes.volume.volume import Volume

# frame types, and whether such a frame can itself be strained
STRAINED = {"affine": True, "quadratic": True, "rigid": False, "point": False}
KERNELS = ("voronoi", "harmonic", "linear")
CASES = [(name, kernel) for name, strained in STRAINED.items() for kernel in (KERNELS if strained else ("linear",))]
TURN = Rotation.from_rotvec([0.3, -0.5, 0.9]).as_matrix()


@cache
def patch(mixed: bool = True) -> Volume:
    """Three soft materials, or one; voxels are no cubes, axes are turned, the origin is off."""
    labels = np.ones((15, 6, 5), np.uint8)
    if mixed:
        labels[:, 3:, :3] = 2
        labels[6:9, :, 2:4] = 3
    return Volume(labels, np.array([0.01, 0.013, 0.008]), np.array([0.2, -0.1, 0.4]), TURN, MATERIALS)


@cache
def patch_grid(mixed: bool = True) -> Grid:
    return voxel_grid(patch(mixed))


@cache
def patch_body(frame_type: str, kernel: str) -> SoftBody:
    at = patch_grid().centers[patch_grid().lookup[[0, 8, 14], [1, 4, 2], [2, 3, 1]]]
    volume = patch(STRAINED[frame_type])
    return build(volume, at=at, method=Paper(5), frame_type=frame_type, weights=kernel)  # pyright: ignore[reportArgumentType]


def strain(strained: bool) -> np.ndarray:
    """G (3, 3), not symmetric; of rank one along the volume's x axis for frames that cannot be strained."""
    slope = np.random.default_rng(7).normal(size=(3, 3))
    return slope if strained else np.outer(slope[0], TURN[:, 0])


def displacements(body: SoftBody, slope: np.ndarray, strained: bool) -> np.ndarray:
    """(k, 3) of the control points under u = G p; a frame that cannot be strained moves as its centre does."""
    at = body.control.rest if strained else body.fields.frame_centers(patch_grid())[body.control.frame]
    return at @ slope.T


@pytest.mark.parametrize(("name", "kernel"), CASES)
def test_uniform_strain_is_reproduced_everywhere(name: str, kernel: str) -> None:
    body, grid, slope = patch_body(name, kernel), patch_grid(STRAINED[name]), strain(STRAINED[name])
    moved = displacements(body, slope, STRAINED[name])
    found = control_weights(body.fields.weights, body.control, grid.centers) @ moved
    size = np.abs(slope @ np.ptp(grid.centers, axis=0)).max()
    np.testing.assert_allclose(found, grid.centers @ slope.T, atol=1e-10 * size)


@pytest.mark.parametrize(("name", "kernel"), CASES)
def test_uniform_strain_has_the_energy_of_hookes_law(name: str, kernel: str) -> None:
    body, grid, slope = patch_body(name, kernel), patch_grid(STRAINED[name]), strain(STRAINED[name])
    moved = displacements(body, slope, STRAINED[name])
    e = (slope + slope.T) / 2
    density = 0.5 * grid.lam * np.trace(e) ** 2 + grid.mu * np.sum(e**2)
    exact = np.bincount(body.fields.region, density * grid.cell_volume)
    parts = zip(body.stiffness.points, body.stiffness.matrix, strict=True)
    found = [0.5 * moved[points].ravel() @ matrix @ moved[points].ravel() for points, matrix in parts]
    assert len(found) > 1
    np.testing.assert_allclose(found, exact, rtol=1e-10)
