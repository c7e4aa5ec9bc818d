from __future__ import annotations

import numpy as np
import pytest
from shapes import block, mixed

from mjframes.grid import voxel_grid
from mjframes.voxel_fem import (
    CORNERS,
    VALUES,
    add_moments,
    at_nodes,
    cell_grid,
    cell_stiffness,
    condense,
    rigid_motions,
)

GRID = voxel_grid(mixed())
LAM, MU = GRID.lam * GRID.cell_volume, GRID.mu * GRID.cell_volume


@pytest.mark.parametrize("factor", [1, 2, 3])
def test_uniform_strain_has_the_exact_energy_and_rigid_motions_none(factor):
    cells = cell_grid(GRID.index, GRID.spacing, GRID.axes, factor)
    matrix = cell_stiffness(cells, LAM, MU)
    slope = np.random.default_rng(0).normal(size=(3, 3))
    strain = (slope + slope.T) / 2
    moved = (cells.nodes @ slope.T).ravel()
    exact = LAM.sum() * np.trace(strain) ** 2 + 2 * MU.sum() * np.sum(strain**2)
    assert np.isclose(moved @ matrix @ moved, exact, rtol=1e-10)
    assert np.abs(matrix @ rigid_motions(cells.nodes)).max() < 1e-10 * np.abs(matrix.data).max()


def test_bending_of_one_cell_of_many_voxels_is_that_of_one_brick():
    fine, coarse = block(4, 4, 4, spacing=0.01), block(1, 1, 1, spacing=0.04)
    matrices = [
        cell_stiffness(cell_grid(g.index, g.spacing, g.axes, q), g.lam * g.cell_volume, g.mu * g.cell_volume).toarray()
        for g, q in ((fine, 4), (coarse, 1))
    ]
    np.testing.assert_allclose(*matrices, atol=1e-12 * np.abs(matrices[0]).max())


def test_moments_carry_fields_to_the_nodes():
    cells = cell_grid(GRID.index, GRID.spacing, GRID.axes, 2)
    fields = np.random.default_rng(1).normal(size=(len(GRID.index), 3))
    total = np.zeros((8, len(cells.cell_nodes), 3))
    add_moments(cells.voxel_cell, cells.place, fields, total)
    expected = np.zeros((len(cells.nodes), 3))
    for cell, place, field in zip(cells.voxel_cell, cells.place, fields, strict=True):
        shape = np.prod(np.where(CORNERS, place, 1 - place), axis=1)
        expected[cells.cell_nodes[cell]] += np.outer(shape, field)
    np.testing.assert_allclose(at_nodes(cells, total, VALUES), expected, atol=1e-12)


def test_elimination_gives_the_inverse_under_balanced_forces():
    cells = cell_grid(GRID.index, GRID.spacing, GRID.axes, 2)
    matrix = cell_stiffness(cells, LAM, MU)
    force = matrix @ np.random.default_rng(2).normal(size=(3 * len(cells.nodes), 4))
    expected = force.T @ np.linalg.pinv(matrix.toarray(), rcond=1e-11, hermitian=True) @ force
    np.testing.assert_allclose(condense(cells, matrix, force), expected, atol=1e-8 * np.abs(expected).max())
