from __future__ import annotations

import numpy as np
import pytest
from builders.shapes import bar, block, mixed
from scipy import sparse

from mjframes.base.errors import MjframesError
from mjframes.elasticity.regions import Regions, split_regions
from mjframes.frames.placement import place_frames
from mjframes.volume.grid import Grid, voxel_grid
from mjframes.weights.voronoi import voronoi_weights

GRID = voxel_grid(mixed())
WEIGHTS = voronoi_weights(GRID, place_frames(GRID, 6))
SETS = {tuple(np.flatnonzero(row).tolist()) for row in WEIGHTS.toarray()}


def test_one_region_for_each_set_of_frames_but_those_of_a_single_voxel():
    rows = [tuple(np.flatnonzero(row).tolist()) for row in WEIGHTS.toarray()]
    films = {members for members in SETS if len(members) == 1 and rows.count(members) == 1}
    assert films  # the seeds of soft frames
    regions = split_regions(GRID, WEIGHTS, len(SETS) - len(films))
    assert set(regions.frames) == SETS - films
    for e, members in zip(regions.label, rows, strict=True):
        alone = len(members) == 1  # and where such voxels are thin, they are part of what lies around
        assert set(members) <= set(regions.frames[e]) if alone else members == regions.frames[e]


@pytest.mark.parametrize("samples", [1, 2, 5, 60])
def test_as_many_regions_as_samples_with_all_the_frames_of_their_voxels(samples):
    regions = split_regions(GRID, WEIGHTS, samples)
    assert len(regions.frames) == samples
    assert set(regions.label.tolist()) == set(range(samples))
    for e, frames in enumerate(regions.frames):
        used = np.flatnonzero(WEIGHTS.toarray()[regions.label == e].any(axis=0))
        assert frames == tuple(used)


def residuals(grid: Grid, weights: sparse.csr_array, regions: Regions) -> np.ndarray:
    """Σ over each region's voxels of the squared residual of the weights from a linear function (r,)."""
    found = np.zeros(len(regions.frames))
    for e, frames in enumerate(regions.frames):
        voxels = np.flatnonzero(regions.label == e)
        linear = np.column_stack([np.ones(len(voxels)), grid.centers[voxels]])
        own = weights.toarray()[voxels][:, frames]
        found[e] = np.sum((own - linear @ np.linalg.lstsq(linear, own, rcond=None)[0]) ** 2)
    return found


def test_the_worst_fit_is_split():
    coarse, fine = split_regions(GRID, WEIGHTS, len(SETS)), split_regions(GRID, WEIGHTS, len(SETS) + 1)
    total = residuals(GRID, WEIGHTS, coarse)
    changed = np.flatnonzero(fine.label != coarse.label)
    assert set(coarse.label[changed]) == {np.argmax(total)}
    assert residuals(GRID, WEIGHTS, fine).sum() < total.sum()


def test_linear_weights_are_not_split():
    grid = bar(*[1] * 30)
    weights = voronoi_weights(grid, place_frames(grid, at=grid.centers[[0, -1]]))
    regions = split_regions(grid, weights, 12)
    assert regions.frames == ((0, 1),)  # the ends, a voxel each, where one weight is 0, join what lies between
    assert residuals(grid, weights, regions).max() < 1e-11


def test_a_small_region_joins_the_one_that_gains_no_frame():
    grid = bar(*[1] * 9)
    rows = [[1, 0, 0]] * 3 + [[0.5, 0.5, 0]] * 2 + [[0, 1, 0]] + [[0, 0.5, 0.5]] * 3
    regions = split_regions(grid, sparse.csr_array(np.array(rows, float)), 3)
    assert regions.label.tolist() == [
        0,
        0,
        0,
        1,
        1,
        1,
        2,
        2,
        2,
    ]  # of both supersets the nearer, here by its smaller half
    assert regions.frames == ((0,), (0, 1), (1, 2))


def test_of_all_regions_the_one_that_gains_fewest_frames_is_joined():
    grid = bar(*[1] * 9)
    rows = [[0.25, 0.25, 0.25, 0.25]] * 4 + [[0, 0.5, 0.5, 0]] + [[0, 1, 0, 0]] * 4
    regions = split_regions(grid, sparse.csr_array(np.array(rows)), 2)
    assert regions.frames == ((0, 1, 2, 3), (1,))


def test_more_than_64_frames_are_told_apart():
    grid = bar(*[1] * 140)
    weights = sparse.csr_array(np.eye(140) * 0.5 + np.eye(140)[np.r_[1:140, 0]] * 0.5)
    regions = split_regions(grid, weights, 140)
    assert len(set(regions.frames)) == 140


def test_voxels_of_a_single_layer_can_be_split():
    grid = block(12, 8, 1)
    weights = voronoi_weights(grid, place_frames(grid, 3))
    assert len(split_regions(grid, weights, 25).frames) == 25


@pytest.mark.parametrize("samples", [0, -3, 2.5])
def test_bad_number_of_samples(samples):
    with pytest.raises(MjframesError, match=f"samples is {samples}"):
        split_regions(GRID, WEIGHTS, samples)
