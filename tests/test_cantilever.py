"""Figure 8's kind of test, in mj_step: a bar's tip under the bar's own weight, against converged voxel FEM.

The bar is 0.4 m long from the face that is held: the layer of voxels that holds it lies outside. It comes to rest with
a tip a tenth of its length lower, so the reference is that of large displacements.
"""

from __future__ import annotations

from functools import cache
from itertools import product

import mujoco
import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.linalg import spsolve

import mjframes as mf
from mjframes.grid import Grid, voxel_grid
from mjframes.voxel_fem import CORNERS, cell_grid

LENGTH, WIDTH, ACROSS = 0.4, 0.1, 12  # [m], [m], [voxels]
YOUNG, DENSITY, GRAVITY = 1e6, 1000.0, 9.81
LINEAR = {0.0: 0.03954, 0.3: 0.03926, 0.45: 0.03828}  # [m] small displacements, as in test_relaxation.py
BOUNDS = [(2, "affine", 0.35), (3, "affine", 0.10), (5, "affine", 0.04), (9, "affine", 0.05), (2, "quadratic", 0.10)]


@cache
def reference(poisson: float) -> float:
    """[m] St. Venant and Kirchhoff's material with 4 voxels across; what it is lower by than its own first step, the
    linear one, does not depend on the voxels (0.56 %, with 6 across as well)."""
    labels = np.ones((16, 4, 4), int)
    grid = voxel_grid(mf.Volume.from_labels(labels, WIDTH / 4, {1: mf.Material(YOUNG, poisson, DENSITY)}))
    cells = cell_grid(grid.index, grid.spacing, grid.axes, 1)
    corners, nodes = cells.cell_nodes, cells.nodes
    dof = (3 * corners[:, :, None] + np.arange(3)).reshape(-1, 24)
    load = np.zeros_like(nodes)
    load[:, 2] = -GRAVITY * DENSITY * grid.cell_volume / 8 * np.bincount(corners.ravel())
    free, tip = np.flatnonzero(np.repeat(nodes[:, 0] > 1e-9, 3)), nodes[:, 0] > LENGTH - 1e-9
    share = np.bincount(corners.ravel())[tip]
    moved = np.zeros_like(nodes)
    sags = []
    for _ in range(6):
        force, stiffness = _large_strains(grid, moved[corners])
        rest = load.ravel() - np.bincount(dof.ravel(), force.ravel())
        at = (np.repeat(dof, 24, axis=1).ravel(), np.tile(dof, (1, 24)).ravel())
        matrix = sparse.csc_array(sparse.coo_array((stiffness.ravel(), at)))
        moved.ravel()[free] += np.asarray(spsolve(matrix[free][:, free], rest[free]))
        sags.append(-np.average(moved[tip, 2], weights=share))
    assert abs(sags[-1] - sags[-2]) < 1e-9
    return LINEAR[poisson] * sags[-1] / sags[0]


def _large_strains(grid: Grid, moved: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Forces (c, 24) and stiffness (c, 24, 24) of trilinear cells, corners displaced by moved (c, 8, 3)."""
    force, stiffness = np.zeros((len(moved), 24)), np.zeros((len(moved), 24, 24))
    for s in product((0.5 - 0.5 / 3**0.5, 0.5 + 0.5 / 3**0.5), repeat=3):
        value, slope = np.where(CORNERS, s, 1 - np.array(s)), np.where(CORNERS, 1, -1)
        gradient = np.stack([np.where(np.arange(3) == d, slope, value).prod(axis=1) for d in range(3)], axis=1)
        gradient /= grid.spacing
        F = np.eye(3) + np.einsum("cai,aj->cij", moved, gradient)
        strain = (np.einsum("cki,ckj->cij", F, F) - np.eye(3)) / 2
        stress = 2 * grid.mu[0] * strain
        stress += grid.lam[0] * np.trace(strain, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        change = np.einsum("cik,al->caikl", F, gradient).reshape(-1, 24, 3, 3)
        change = (change + change.swapaxes(2, 3)) / 2
        response = 2 * grid.mu[0] * change
        response += grid.lam[0] * np.trace(change, axis1=2, axis2=3)[..., None, None] * np.eye(3)
        geometric = np.einsum("ak,ckl,bl->cab", gradient, stress, gradient)
        volume = grid.cell_volume / 8
        force += volume * np.einsum("cik,ckl,al->cai", F, stress, gradient).reshape(-1, 24)
        stiffness += volume * np.einsum("cpkl,cqkl->cpq", change, response)
        stiffness += volume * np.einsum("cab,ij->caibj", geometric, np.eye(3)).reshape(-1, 24, 24)
    return force, stiffness


def sag(poisson: float, frames: int, frame_type: str) -> float:
    """Mean deflection of the end face [m] once mj_step has brought the bar to rest; the held layer is a frame too."""
    voxel = WIDTH / ACROSS
    labels = np.ones((4 * ACROSS + 1, ACROSS, ACROSS), int)
    volume = mf.Volume.from_labels(labels, voxel, {1: mf.Material(YOUNG, poisson, DENSITY)}, origin=(-voxel, 0, 0))
    at = np.full((frames - 1, 3), WIDTH / 2)
    at[:, 0] = np.linspace(0, LENGTH, frames)[1:]
    at[-1, 0] -= voxel / 2  # inside the last layer
    held = np.zeros(labels.shape, bool)
    held[0] = True
    fixed = [mf.Fixed(held)]
    body = mf.build(volume, at=at, samples=frames - 1, frame_type=frame_type, weights="linear", fixed=fixed)
    spec = mujoco.MjSpec()
    spec.option.timestep = 0.01
    mf.attach(spec.worldbody, body, name="bar", contact=False)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=1500)
    assert np.abs(data.qvel).max() < 1e-8  # [m/s]: the implicit step's own damping has brought it to rest
    moved = body.skin.weights @ mf.soft(model, data, "bar").control_positions - body.skin.vertices
    end = body.skin.vertices[:, 0] > LENGTH - 1e-6
    return -float(moved[end, 2].mean())


@pytest.mark.parametrize("poisson", LINEAR)
@pytest.mark.parametrize(("frames", "frame_type", "bound"), BOUNDS)
def test_deflection_under_own_weight(poisson: float, frames: int, frame_type: str, bound: float) -> None:
    found = sag(poisson, frames, frame_type) / reference(poisson) - 1
    assert abs(found) < bound
