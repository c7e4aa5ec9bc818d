from __future__ import annotations

import numpy as np
from builders.shapes import mixed
from scipy import sparse

from mjframes.frames.placement import place_frames
from mjframes.kinematics.frame_moments import EXPONENTS, frame_moments
from mjframes.volume.grid import voxel_grid
from mjframes.weights.voronoi import voronoi_weights


def test_moments_are_integrals_over_the_voxels():
    """Gauss's three points an axis integrate each voxel exactly up to degree 5."""
    grid = voxel_grid(mixed())
    weights = voronoi_weights(grid, place_frames(grid, 6))
    degrees = [2, 4, 2, 4, 4, 2]
    found = frame_moments(grid, weights, degrees)
    nodes, gauss = np.polynomial.legendre.leggauss(3)
    corner = np.stack(np.meshgrid(nodes, nodes, nodes, indexing="ij"), axis=-1).reshape(-1, 3) / 2
    share = np.einsum("a,b,c->abc", gauss, gauss, gauss).ravel() / 8
    points = grid.centers[:, None] + (corner * grid.spacing) @ grid.axes.T
    dense = sparse.csr_array(weights).toarray() * (grid.density * grid.cell_volume)[:, None]
    for i, degree in enumerate(degrees):
        dm = dense[:, i, None] * share
        mass = dm.sum()
        center = np.einsum("vq,vqx->x", dm, points) / mass
        offset = (points - center) @ grid.axes
        scale = np.sqrt(np.einsum("vq,vqx,vqx->", dm, offset, offset) / mass)
        np.testing.assert_allclose(found.mass[i], mass, rtol=1e-12)
        np.testing.assert_allclose(found.center[i], center, rtol=0, atol=1e-12 * scale)
        np.testing.assert_allclose(found.scale[i], scale, rtol=1e-12)
        for t, e in enumerate(EXPONENTS):
            exact = np.sum(dm * ((offset / scale) ** e).prod(axis=-1))
            np.testing.assert_allclose(
                found.power[i, t], exact if e.sum() <= degree else 0.0, rtol=0, atol=1e-11 * mass
            )
