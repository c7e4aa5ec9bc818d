"""Fields at the voxels: what a saved body keeps of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from builders import shapes

from mjframes.base.packing import packed
from mjframes.body.build import build
from mjframes.body.soft_body import SoftBody
from mjframes.volume.grid import voxel_grid


@pytest.fixture(scope="module")
def body() -> SoftBody:
    return build(shapes.mixed(), 6)


def test_fields_are_numbered_as_the_body(body: SoftBody) -> None:
    grid, fields = voxel_grid(shapes.mixed()), body.fields
    assert fields.weights.shape == (len(grid.index), len(body.parent))
    for i, seeds in enumerate(fields.seeds):
        np.testing.assert_allclose(fields.weights[seeds][:, [i]].toarray(), 1, atol=1e-12)
    # the mass of a frame is what its weights gather
    mass = fields.weights.T @ (grid.density * grid.cell_volume)
    np.testing.assert_allclose(np.bincount(body.control.frame, body.control.mass), mass, rtol=1e-12)
    np.testing.assert_allclose(
        np.bincount(fields.region, minlength=len(body.stiffness.points)) * grid.cell_volume, body.stiffness.volume
    )
    for e, points in enumerate(body.stiffness.points):
        used = np.unique(fields.weights[fields.region == e].indices)
        assert set(used) <= set(body.control.frame[points])


def test_centers_are_centroids(body: SoftBody) -> None:
    grid, fields = voxel_grid(shapes.mixed()), body.fields
    for e, center in enumerate(fields.sample_centers(grid)):
        np.testing.assert_allclose(center, grid.centers[fields.region == e].mean(axis=0))
    for seeds, center in zip(fields.seeds, fields.frame_centers(grid), strict=True):
        np.testing.assert_allclose(center, grid.centers[seeds].mean(axis=0))


def test_a_saved_body_keeps_them(body: SoftBody, tmp_path: Path) -> None:
    body.save(str(tmp_path / "body.npz"))
    saved, fields = SoftBody.load(str(tmp_path / "body.npz")).fields, body.fields
    for name in ("labels", "spacing", "origin", "axes"):
        np.testing.assert_array_equal(getattr(saved.volume, name), getattr(fields.volume, name))
    assert saved.volume.materials == fields.volume.materials
    np.testing.assert_array_equal(saved.region, fields.region)
    for one, other in zip(saved.seeds, fields.seeds, strict=True):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(saved.weights.indices, fields.weights.indices)
    np.testing.assert_allclose(saved.weights.toarray(), fields.weights.toarray(), rtol=0, atol=1e-7)
    np.testing.assert_allclose(saved.weights.sum(axis=1), 1, rtol=0, atol=1e-15)
    for piece in range(2):  # rounding keeps rigid pieces rigid
        rigid = saved.weights[voxel_grid(saved.volume).piece == piece].toarray()
        np.testing.assert_array_equal(rigid, np.tile(rigid[0], (len(rigid), 1)))


def test_they_are_packed_small(body: SoftBody) -> None:
    fields = body.fields
    size = sum(array.nbytes for array in packed(fields).values())
    assert fields.correction is not None
    known = fields.volume.labels.size + 5 * fields.weights.nnz + 8 * len(fields.region)
    modes = 2 * (3 + 6) * 12 * len(fields.region)  # of displacements and strains
    assert size < known + 5 * fields.correction.nnz + modes + 60_000  # and what regions share
