"""Figure 8's kind of test, in mj_step: a bar's tip under the bar's own weight, against converged voxel FEM.

The bar is 0.4 m long from the face that is held: the layer of voxels that holds it lies outside. It comes to rest with
a tip a tenth of its length lower, so the reference is that of large displacements.
"""

from __future__ import annotations

from functools import cache

import mujoco
import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.linalg import spsolve

import mjframes as mf
from benchmarks.solids.bricks import bricks, internal_force, nodal_load
from mjframes.volume.grid import voxel_grid

LENGTH, WIDTH, ACROSS = 0.4, 0.1, 12  # [m], [m], [voxels]
YOUNG, DENSITY, GRAVITY = 1e6, 1000.0, 9.81
LINEAR = {0.0: 0.03954, 0.3: 0.03926, 0.45: 0.03828}  # [m] small displacements, finite elements that have converged
BOUNDS = [(2, "affine", 0.35), (3, "affine", 0.10), (5, "affine", 0.04), (9, "affine", 0.05), (2, "quadratic", 0.10)]


@cache
def reference(poisson: float) -> float:
    """[m] St. Venant and Kirchhoff's material with 4 voxels across; what it is lower by than its own first step, the
    linear one, does not depend on the voxels (0.56 %, with 6 across as well)."""
    labels = np.ones((17, 4, 4), int)
    grid = voxel_grid(mf.Volume.from_labels(labels, WIDTH / 4, {1: mf.Material(YOUNG, poisson, DENSITY)}))
    mesh = bricks(grid, grid.index[:, 0] == 0, 1, 1)
    weight = np.zeros((len(grid.index), 3))
    weight[grid.index[:, 0] > 0, 2] = -GRAVITY * DENSITY * grid.cell_volume
    load, free, tip = nodal_load(mesh, weight), mesh.moving, mesh.nodes[:, 0] > mesh.nodes[:, 0].max() - 1e-9
    share = np.bincount(mesh.element.ravel())[tip]
    moved = np.zeros_like(mesh.nodes)
    sags = []
    for _ in range(6):
        force, tangent = internal_force(mesh, moved)
        assert tangent is not None
        moved.ravel()[free] += np.asarray(
            spsolve(sparse.csc_array(tangent[free][:, free]), (load - force).ravel()[free])
        )
        sags.append(-np.average(moved[tip, 2], weights=share))
    assert abs(sags[-1] - sags[-2]) < 1e-9
    return LINEAR[poisson] * sags[-1] / sags[0]


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
    body = mf.build(volume, at=at, frame_type=frame_type, weights="linear", supports=fixed)
    spec = mujoco.MjSpec()
    spec.option.timestep = 0.01
    mf.attach(spec, body, "bar", contact=False)
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
