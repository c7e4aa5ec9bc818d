"""Finite elements that tendons pull at: exact slopes, beam theory, the law at small strain, and the command's table."""

from __future__ import annotations

import csv
from functools import cache

import numpy as np
import pytest

from benchmarks.accuracy import actuation
from benchmarks.solids.actuated import LAWS, equilibria, internal_force
from benchmarks.solids.bricks import Bricks, at_points, bricks, linear_stiffness
from benchmarks.solids.lengths import Field, Length, Path, walls
from mjframes.volume.grid import Grid, voxel_grid
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

EDGE, YOUNG = 0.002, 1e5
SHAPE = (7, 3, 5)


def hollow() -> np.ndarray:
    labels = np.ones(SHAPE, np.uint8)
    labels[2:5, :2, 2:4] = 0
    return labels


def grid_of(labels: np.ndarray, poisson: float = 0.4) -> Grid:
    return voxel_grid(Volume.from_labels(labels, EDGE, {1: Material(YOUNG, poisson, 1000)}))


@cache
def half(order: int) -> Bricks:
    grid = grid_of(hollow())
    return bricks(grid, grid.index[:, 0] == 0, order, 1, mirrored=True)


def lengths(mesh: Bricks) -> dict[str, Length]:
    path = np.array([(0.001, 0, 0.001), (0.006, 0.001, 0.001), (0.0131, 0, 0.002)])
    field = Field(np.arange(10), np.tile([0.6, 0, 0.8], (10, 1)))
    return {"volume": walls(mesh, hollow() == 0), "path": Path(path), "muscle": field}


def states(mesh: Bricks, size: float = 1e-4) -> tuple[np.ndarray, np.ndarray]:
    """Displacements, and a way on from them; both leave the middle plane in itself."""
    moved, way = size * np.random.default_rng(0).normal(size=(2, *mesh.nodes.shape))
    moved[mesh.nodes[:, 1] == 0, 1] = way[mesh.nodes[:, 1] == 0, 1] = 0
    return moved, way


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("name", ["volume", "path", "muscle"])
def test_slopes_and_curvatures_of_lengths_are_those_of_differences(name: str, order: int) -> None:
    mesh, step = half(order), 1e-3
    length, (moved, way) = lengths(mesh)[name], states(mesh)
    (after, slope_after, _), (before, slope_before, _) = (length.at(mesh, moved + e * way) for e in (step, -step))
    _, slope, curvature = length.at(mesh, moved)
    assert (after - before) / (2 * step) == pytest.approx((slope * way).sum(), rel=1e-6)
    change = curvature @ way.ravel()
    np.testing.assert_allclose((slope_after - slope_before).ravel() / (2 * step), change, atol=1e-6 * abs(change).max())


def test_a_cavitys_volume_at_rest_is_that_of_its_voxels_and_its_pressure_pushes_nothing_away() -> None:
    closed = np.ones((5, 5, 5), np.uint8)
    closed[1:4, 2:4, 1:3] = 0
    grid = grid_of(closed)
    mesh = bricks(grid, np.zeros(len(grid.index), bool), 2, 1)
    volume, slope, _ = walls(mesh, closed == 0).at(mesh, 0 * mesh.nodes)
    assert volume == pytest.approx((closed == 0).sum() * EDGE**3, rel=1e-12)
    assert np.abs(slope.sum(axis=0)).max() < 1e-12 * np.abs(slope).sum()
    assert np.abs(np.cross(mesh.nodes, slope).sum(axis=0)).max() < 1e-12 * np.abs(slope).sum()


@pytest.mark.parametrize("name", LAWS)
def test_laws_have_their_tangent_and_are_hookes_at_rest(name: str) -> None:
    mesh, step = half(2), 1e-3
    moved, way = states(mesh, 5e-5)
    after, before = (internal_force(mesh, LAWS[name], moved + e * way)[0] for e in (step, -step))
    change = internal_force(mesh, LAWS[name], moved)[1] @ way.ravel()
    np.testing.assert_allclose((after - before).ravel() / (2 * step), change, atol=1e-5 * abs(change).max())
    force, tangent = internal_force(mesh, LAWS[name], 0 * moved)
    assert np.abs(force).max() < 1e-9
    assert abs(tangent - linear_stiffness(mesh)).max() < 1e-9 * abs(tangent).max()


def test_a_turn_costs_nothing() -> None:
    mesh = half(1)
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    for law in LAWS.values():
        assert np.abs(internal_force(mesh, law, mesh.nodes @ (turn.T - np.eye(3)))[0]).max() < 1e-9


def solved(pull: tuple[Length, float], end: float, mesh: Bricks, low: Bricks) -> np.ndarray:
    shapes = at_points(mesh, np.array([(end, 0.0, z) for z in (0.5 * EDGE, 1.5 * EDGE)]))
    return shapes @ equilibria(mesh, low, LAWS["corotational"], [pull], [1.0])[0]


@cache
def bar() -> tuple[Bricks, Bricks]:
    """Half a bar of 16 × 2 × 2 voxels, without lateral contraction so that the clamp disturbs nothing."""
    grid = grid_of(np.ones((17, 1, 2), np.uint8), 0.0)
    high, low = (bricks(grid, grid.index[:, 0] == 0, p, s, mirrored=True) for p, s in ((2, 1), (1, 2)))
    return high, low


def test_a_weak_cable_bends_a_bar_as_beam_theory_says() -> None:
    """Tension T at e below the middle: curvature T e / E I, and shortening by T / E A."""
    length, size, below, tension = 16 * EDGE, 2 * EDGE, 0.5 * EDGE, 1e-5
    x = np.linspace(EDGE, EDGE + length, 33)
    path = Path(np.column_stack([x, 0 * x, np.full_like(x, size / 2 - below)]), share=0.5)
    end = solved((path, -tension), EDGE + length * 0.75, *bar()).mean(axis=0)
    bent = tension * below / (YOUNG * size**4 / 12) * (0.75 * length) ** 2 / 2
    assert -end[2] == pytest.approx(bent, rel=0.03)
    assert -end[0] == pytest.approx(0.75 * length * tension / (YOUNG * size**2), rel=0.05)


def test_a_muscle_shortens_a_bar_by_stress_over_youngs_modulus() -> None:
    mesh, low = bar()
    field = Field(np.arange(len(mesh.element)), np.tile([1.0, 0, 0], (len(mesh.element), 1)))
    end = solved((field, -0.1 * YOUNG), EDGE * 17, mesh, low)
    np.testing.assert_allclose(end[:, 0], -0.1 * 16 * EDGE, rtol=1e-3)


def test_the_table_in_the_clone_has_what_the_command_measures() -> None:
    with actuation.TABLE.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert tuple(rows[0]) == actuation.COLUMNS
    expected = [(case, n, force) for case in actuation.cases() for n in actuation.FRAMES for force in case.forces]
    assert len(rows) == len(expected)
    for row, (case, frames, force) in zip(rows, expected, strict=True):
        assert (row["body"], int(row["frames"]), row["unit"]) == (case.name, frames, case.unit)
        assert float(row["force"]) == pytest.approx(force)


@pytest.mark.slow
def test_a_tiny_case_of_the_command() -> None:
    """The muscle that is a whole body, coarser: what is printed is σ/E."""
    case = actuation.muscle_case("muscle", 2, upper=False)
    rows = actuation.measured(case, "corotational", False, lambda _: None)
    for name, force, unit, _, tip, exact, *_ in rows:
        assert (name, unit) == ("muscle", "Pa")
        assert tip == pytest.approx(exact, rel=0.05)
        assert exact == pytest.approx(force / 2e5 * 0.075, rel=0.1)
