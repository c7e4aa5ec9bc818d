"""Natural frequencies of a free bar, nine affine frames with consistent mass, against voxel FEM with consistent mass.

FEM: 4 and 6 voxels across, extrapolated with the square of their size; with 8 and 12 the same comes out, to 0.2 %.
"""

from __future__ import annotations

from functools import cache

import mujoco
import numpy as np
import pytest
from builders.scenes import compiled, dense_inertia
from scipy import linalg, sparse
from scipy.sparse.linalg import eigsh

import mjframes as mf
from benchmarks.solids.bricks import bricks, linear_stiffness
from mjframes.body.soft_body import SoftBody
from mjframes.scene.view import Soft, soft
from mjframes.volume.grid import voxel_grid

LENGTH, WIDTH, ACROSS = 0.4, 0.1, 12  # [m], [m], [voxels]
COUNT = {"bending": 3, "torsion": 1, "axial": 1}  # of each kind, how many are compared
SHIFT = 1e3  # [1/s²] added to ω²: rigid motions have none
MODES = 14  # enough to hold those that are compared, bending twice
WEIGHTLESS = "<mujoco><option gravity='0 0 0'/></mujoco>"


def volume(poisson: float, across: int) -> mf.Volume:
    labels = np.ones((round(LENGTH / WIDTH) * across, across, across), int)
    return mf.Volume.from_labels(labels, WIDTH / across, {1: mf.Material(1e6, poisson, 1000)})


@cache
def bar(poisson: float) -> SoftBody:
    at = [((i + 0.5) * LENGTH / 9, WIDTH / 2, WIDTH / 2) for i in range(9)]
    return mf.build(volume(poisson, ACROSS), at=at, weights="linear")


def kind(mode: np.ndarray, points: np.ndarray) -> str:
    """Which motion of rigid cross sections has most of a mode (n, 3) of points (n, 3)."""
    y, z = (points - points.mean(axis=0))[:, 1:].T
    _, section = np.unique(np.round(points[:, 0], 9), return_inverse=True)

    def mean(values: np.ndarray) -> np.ndarray:
        return np.bincount(section, values) / np.bincount(section)

    along, aside, up = (mean(u)[section] for u in mode.T)
    turn = (mean(y * mode[:, 2] - z * mode[:, 1]) / mean(y**2 + z**2))[section]
    size = {
        "axial": np.linalg.norm(along),
        "bending": np.hypot(np.linalg.norm(aside), np.linalg.norm(up)),
        "torsion": np.linalg.norm(turn * np.hypot(y, z)),
    }
    return max(size, key=lambda name: size[name])


def by_kind(frequencies: np.ndarray, modes: np.ndarray, points: np.ndarray) -> dict[str, np.ndarray]:
    """The first frequencies of each kind [Hz]; modes: (n, 3, MODES).  Bending comes in pairs, of which one is taken."""
    kinds = np.array([kind(mode, points) for mode in np.moveaxis(modes, 2, 0)])
    found = {name: frequencies[kinds == name] for name in COUNT}
    found["bending"] = found["bending"][::2]
    return {name: found[name][:count] for name, count in COUNT.items()}


@cache
def fem(poisson: float, across: int) -> dict[str, np.ndarray]:
    grid = voxel_grid(volume(poisson, across))
    mesh = bricks(grid, np.zeros(len(grid.index), bool), 1, 1)
    stiffness = linear_stiffness(mesh)
    line = np.array([[2, 1], [1, 2]]) / 6
    of_cell = np.einsum("v,ab->vab", grid.density * grid.cell_volume, np.kron(np.kron(line, line), line))
    row, column = np.repeat(mesh.element, 8, axis=1), np.tile(mesh.element, (1, 8))
    mass = sparse.kron(sparse.coo_array((of_cell.ravel(), (row.ravel(), column.ravel()))), sparse.eye_array(3))
    squares, modes = eigsh(sparse.csc_array(stiffness), k=6 + MODES, M=sparse.csc_array(mass), sigma=-SHIFT)
    order = np.argsort(squares)[6:]
    frequencies = np.sqrt(squares[order]) / (2 * np.pi)
    return by_kind(frequencies, modes[:, order].reshape(-1, 3, MODES), mesh.nodes)


def converged(poisson: float) -> dict[str, np.ndarray]:
    """f + c d² through 4 and 6 voxels across, at d = 0."""
    coarse, fine = fem(poisson, 4), fem(poisson, 6)
    return {name: fine[name] + (fine[name] - coarse[name]) * 4**2 / (6**2 - 4**2) for name in COUNT}


def spectrum(mass: np.ndarray, stiffness: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies [Hz] and modes (n, MODES) after the rigid ones; null modes have no mass, so 1/(ω² + SHIFT)."""
    inverse, modes = linalg.eigh(mass, stiffness + SHIFT * mass)
    some = slice(-7, -7 - MODES, -1)
    return np.sqrt(1 / inverse[some] - SHIFT) / (2 * np.pi), modes[:, some]


def views_matrices(view: Soft) -> tuple[np.ndarray, np.ndarray]:
    """Mass and stiffness (3k, 3k) at rest, of the control points."""
    mass, stiffness = np.diag(view.mass), np.zeros((view.rest.size, view.rest.size))
    for points, difference in view.mass_difference:
        mass[np.ix_(points, points)] += difference
    for region in view.regions:
        rows = (3 * region.points[:, None] + np.arange(3)).ravel()
        stiffness[np.ix_(rows, rows)] += region.response(view.rest[region.points])[1]
    return np.kron(mass, np.eye(3)), stiffness


def simulators_matrices(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[np.ndarray, np.ndarray]:
    """Mass and stiffness (nv, nv) of MuJoCo's coordinates: d->M is M + h² K, here of two steps h."""
    held = []
    for model.opt.timestep in (1e-3, 2e-3):
        mujoco.mj_forward(model, data)
        held.append(dense_inertia(model, data))
    stiffness = (held[1] - held[0]) / 3e-6
    return held[0] - 1e-6 * stiffness, stiffness


@pytest.mark.parametrize("poisson", [0.0, pytest.param(0.3, marks=pytest.mark.slow), 0.45])
def test_frequencies_of_the_free_bar(poisson: float) -> None:
    body = bar(poisson)
    model, data = compiled(WEIGHTLESS, (body, (0, 0, 0), (1, 0, 0, 0)), contact=False)
    mujoco.mj_forward(model, data)
    frequencies, modes = spectrum(*views_matrices(soft(model, data, "soft0")))
    moved = np.einsum("sk,kan->san", body.skin.weights.toarray(), modes.reshape(-1, 3, MODES))
    found, expected = by_kind(frequencies, moved, body.skin.vertices), converged(poisson)
    for name, count in COUNT.items():
        assert len(found[name]) == count
        np.testing.assert_allclose(found[name], expected[name], rtol=0.05, err_msg=name)
    simulated, _ = spectrum(*simulators_matrices(model, data))
    np.testing.assert_allclose(simulated, frequencies, rtol=1e-9)
