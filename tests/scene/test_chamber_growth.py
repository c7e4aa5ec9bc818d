"""How a chamber's pull grows: the volume in its walls, elements of second order, frames that come where these go."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from builders.hollow import CAVITY, CENTRE, SHAPE, actuated, hollow_body

import mjframes as mf
from mjframes.elasticity.corotational import closest_rotation
from mjframes.finite_elements.element import CORNERS
from mjframes.scene import chamber_growth as growth
from mjframes.scene.tendon_slopes import Elements


@pytest.fixture(scope="module")
def elements() -> Elements:
    return Elements(hollow_body(10))


@pytest.fixture(scope="module")
def walls(elements: Elements) -> growth.Walls:
    cavity = np.zeros(SHAPE, bool)
    cavity[CAVITY] = True
    return growth.walls_around(elements.grid, elements.solver, cavity)


def volume(walls: growth.Walls, moved: np.ndarray) -> float:
    """V, twelve triangles around the middle of each face: bilinear faces have as much."""
    x = walls.at + np.vstack([moved, np.zeros(3)])[walls.node]
    total = 0.0
    for a, b, c in ((0, 1, 2), (0, 2, 3), (0, 1, 3), (1, 2, 3)):  # the mean of both ways to halve a face
        total += float((x[:, a] * np.cross(x[:, b], x[:, c])).sum() / 12)
    return total


def test_the_load_of_walls_is_the_slope_of_their_volume(elements: Elements, walls: growth.Walls) -> None:
    rng = np.random.default_rng(0)
    still = np.zeros((walls.nodes, 3))
    assert volume(walls, still) == pytest.approx(np.ones(SHAPE)[CAVITY].sum() * elements.grid.cell_volume)
    moved, other = (1e-3 * rng.normal(size=still.shape) for _ in range(2))
    slope = (volume(walls, moved) - volume(walls, -moved)) / 2
    third = (volume(walls, 2 * moved) - volume(walls, -2 * moved)) / 2 - 2 * slope  # six times V's cubic term
    assert (walls.load() * moved).sum() == pytest.approx(slope - third / 6, rel=1e-9)
    curvature = (volume(walls, moved + other) - volume(walls, moved - other)) / 2
    curvature -= (volume(walls, other - moved) - volume(walls, -moved - other)) / 2
    assert 2 * (walls.change(moved) * other).sum() == pytest.approx(curvature, rel=1e-9)


def test_forces_of_second_order_are_those_of_the_corotational_energy(elements: Elements) -> None:
    """Beside μ |F − R|² + λ/2 (tr RᵀF − 3)² at the bricks' centres, whose even part of the slope is ½ E'''(u, u)."""
    grid, mesh = elements.grid, elements.solver.mesh
    rng = np.random.default_rng(1)
    moved = rng.normal(size=(len(mesh.position), 3))
    moved[mesh.held_by >= 0] = 0
    slope = (2 * CORNERS - 1) / (4 * grid.spacing)

    def forces(step: float) -> np.ndarray:
        total = np.zeros_like(moved)
        for brick, nodes in enumerate(mesh.nodes):
            F = np.eye(3) + step * moved[nodes].T @ slope
            R = closest_rotation(F)
            lam, mu = (grid.per_material(name)[mesh.material[brick]] for name in ("lam", "mu"))
            P = 2 * mu * (F - R) + lam * (np.trace(R.T @ F) - 3) * R
            total[nodes] += grid.cell_volume * slope @ P.T
        total[mesh.held_by >= 0] = 0
        return total

    step = 1e-4 * grid.spacing.min()
    even = (forces(step) + forces(-step)) / (2 * step**2)
    found = growth._second_force(elements, moved)
    assert np.abs(found - even).max() < 1e-5 * np.abs(even).max()


@pytest.mark.parametrize(
    ("frames", "types"),
    [
        (5, "affine"),
        pytest.param(10, "affine", marks=pytest.mark.slow),
        pytest.param(3, "quadratic", marks=pytest.mark.slow),
    ],
)
def test_frames_come_where_elements_of_second_order_go(walls: growth.Walls, frames: int, types: str) -> None:
    """Of the ways under p and −p half the sum is p² x₂; without growth it is another one."""
    elements = Elements(hollow_body(frames, types=types))
    moved, first = elements.motion(walls.load())
    second = elements.motion(walls.change(moved) - growth._second_force(elements, moved))[1]
    pressure = 0.1 * elements.grid.spacing.max() / np.abs(first).max()
    spec = actuated(elements.body, {"air": mf.Chamber(CENTRE)})
    model = spec.compile()
    data = mujoco.MjData(model)
    view = mf.soft(model, data, "bar", elements.body)
    ways = []
    for sign in (1, -1):
        mujoco.mj_resetData(model, data)
        data.ctrl[0] = sign * pressure
        mujoco.mj_forward(model, data)
        start = view.control_positions
        mujoco.mj_step(model, data, nstep=8000)
        assert np.abs(data.qvel).max() < 1e-10
        mujoco.mj_forward(model, data)
        ways.append(view.control_positions - start)
    one, two = (ways[0] - ways[1]) / 2, (ways[0] + ways[1]) / 2
    assert np.abs(one - pressure * first).max() < 0.01 * np.abs(one).max()
    assert np.abs(two - pressure**2 * second).max() < 0.01 * np.abs(two).max()


def test_chambers_whose_pressure_moves_no_frame_can_be_attached() -> None:
    """One is within what is held, a lidded one touches no material."""
    labels = np.ones((16, 6, 6), np.uint8)
    labels[1:4, 2:4, 2:4] = 0
    labels[14:, 4:, 4:] = 0
    alone = np.zeros(labels.shape, bool)
    alone[15, 5, 5] = True
    held = np.zeros(labels.shape, bool)
    held[:6] = True
    volume = mf.Volume.from_labels(labels, 0.01, {1: mf.Material(2e5, 0.4, 1000)})
    body = mf.build(volume, 2, supports=mf.Fixed(held & (labels > 0)))
    for chamber in (mf.Chamber((0.025, 0.03, 0.03)), mf.Chamber(alone, lid=True)):
        spec = actuated(body, {"air": chamber})
        model = spec.compile()
        data = mujoco.MjData(model)
        data.ctrl[0] = 100
        mujoco.mj_step(model, data, nstep=20)
        assert np.abs(data.qvel).max() < 1e-6
