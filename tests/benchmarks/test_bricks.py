"""The report's finite elements, against scikit-fem and against themselves."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.solids.bricks import (
    Bricks,
    at_centers,
    bricks,
    internal_force,
    linear_stiffness,
    nodal_load,
    nodal_mass,
)
from benchmarks.solids.reference import linear_solution, nonlinear_solution
from mjframes.volume.grid import Grid, voxel_grid
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

SPACING = np.array([0.02, 0.03, 0.025])
LEVELS = [(1, 1), (1, 2), (2, 1)]


def two_layers() -> tuple[Grid, np.ndarray]:
    """A block with an inclusion 1:50, held at the first layer along x."""
    labels = np.ones((6, 3, 3), np.uint8)
    labels[2:5, 1:, :2] = 2
    grid = voxel_grid(Volume.from_labels(labels, SPACING, {1: Material(1e4, 0.3, 1000), 2: Material(5e5, 0.4, 1200)}))
    return grid, grid.index[:, 0] == 0


def load_of(grid: Grid, size: float) -> np.ndarray:
    load = np.zeros((len(grid.index), 3))
    load[grid.index[:, 0] == 5] = [0.2 * size, 0.1 * size, -size]
    return load


def mesh_of(order: int, split: int = 1) -> Bricks:
    return bricks(*two_layers(), order, split)


@pytest.mark.parametrize(("order", "split"), LEVELS)
def test_uniform_strain_has_the_exact_energy_and_rigid_motions_none(order, split):
    mesh, grid = mesh_of(order, split), two_layers()[0]
    matrix = linear_stiffness(mesh)
    slope = np.random.default_rng(0).normal(size=(3, 3))
    strain = (slope + slope.T) / 2
    moved = (mesh.nodes @ slope.T).ravel()
    exact = grid.cell_volume * np.sum(grid.lam * np.trace(strain) ** 2 + 2 * grid.mu * np.sum(strain**2))
    assert np.isclose(moved @ matrix @ moved, exact, rtol=1e-12)
    turned = np.cross([1.0, -2.0, 3.0], mesh.nodes).ravel()
    assert np.abs(matrix @ turned).max() < 1e-12 * np.abs(matrix.data).max()


@pytest.mark.parametrize(("order", "split"), LEVELS)
def test_linear_fields_loads_and_masses_keep_their_sums(order, split):
    mesh, (grid, _) = mesh_of(order, split), two_layers()
    slope = np.random.default_rng(1).normal(size=(3, 3))
    corner = mesh.nodes @ slope.T
    np.testing.assert_allclose(at_centers(mesh, corner), (grid.centers - grid.origin) @ slope.T, atol=1e-12)
    load = np.random.default_rng(2).normal(size=(len(grid.index), 3))
    work = np.sum(nodal_load(mesh, load) * corner)
    assert np.isclose(work, np.sum(load * ((grid.centers - grid.origin) @ slope.T)))
    mass = nodal_mass(mesh, grid.density * grid.cell_volume)
    assert np.isclose(mass.sum(), grid.density.sum() * grid.cell_volume)
    assert mass.min() > 0


class ScikitFem:
    """The same bricks there, and the same numbers at its degrees of freedom."""

    def __init__(self, order: int) -> None:
        fem = pytest.importorskip("skfem")
        self.grid, self.held = two_layers()
        self.mesh = bricks(self.grid, self.held, order, 1)
        lines = [np.arange(n + 1) * h for n, h in zip((6, 3, 3), SPACING, strict=True)]
        mesh = fem.MeshHex.init_tensor(*lines)
        element = fem.ElementVector(fem.ElementHex1() if order == 1 else fem.ElementHex2())
        self.basis = fem.Basis(mesh, element, intorder=2 * order + 1)
        cell = np.floor(mesh.p[:, mesh.t].mean(axis=1).T / SPACING).astype(int)
        self.voxel = self.grid.lookup[tuple(cell.T)]
        places = {tuple(np.round(p, 9)): a for a, p in enumerate(self.mesh.nodes)}
        node = np.array([places[tuple(np.round(p, 9))] for p in self.basis.doflocs.T])
        self.dof = 3 * node + np.arange(self.basis.N) % 3  # ours, for each of theirs

    def spread(self, values: np.ndarray) -> np.ndarray:
        """(…, voxels) values at their quadrature points."""
        return np.repeat(values[..., self.voxel, None], self.basis.X.shape[-1], axis=-1)

    @property
    def lame(self) -> dict[str, np.ndarray]:
        return {"lam": self.spread(self.grid.lam), "mu": self.spread(self.grid.mu)}


@pytest.mark.parametrize("order", [1, 2])
def test_the_linear_solution_is_that_of_scikit_fem(order):
    fem = pytest.importorskip("skfem")
    pytest.importorskip("pyamg")
    from skfem.helpers import ddot, sym_grad, trace

    other = ScikitFem(order)
    load = load_of(other.grid, 1.0)
    low = other.mesh if order == 1 else bricks(other.grid, other.held, 1, order)
    ours = linear_solution(other.mesh, low, load).ravel()[other.dof]

    @fem.BilinearForm
    def stiffness(u, v, w):
        strain = sym_grad(u)
        return w["lam"] * trace(strain) * trace(sym_grad(v)) + 2 * w["mu"] * ddot(strain, sym_grad(v))

    @fem.LinearForm
    def work(v, w):
        return sum(w["force"][d] * v[d] for d in range(3))

    matrix = stiffness.assemble(other.basis, **other.lame)
    right = work.assemble(other.basis, force=other.spread(load.T / other.grid.cell_volume))
    fixed = np.flatnonzero(other.basis.doflocs[0] < SPACING[0] + 1e-9)
    theirs = fem.solve(*fem.condense(matrix, right, D=fixed))
    np.testing.assert_allclose(ours, theirs, atol=1e-6 * np.abs(theirs).max())


@pytest.mark.parametrize("order", [1, 2])
def test_large_strains_give_the_force_of_scikit_fem(order):
    fem = pytest.importorskip("skfem")
    from skfem.helpers import ddot, grad, identity, mul, transpose

    other = ScikitFem(order)
    moved = 0.005 * np.random.default_rng(4).normal(size=other.mesh.nodes.shape)
    ours = internal_force(other.mesh, moved, tangent=False)[0].ravel()[other.dof]

    @fem.LinearForm
    def work(v, w):
        F = grad(w["moved"]) + identity(grad(w["moved"]))
        G = (mul(transpose(F), F) - identity(F)) / 2
        S = w["lam"] * np.einsum("ii...", G) * identity(F) + 2 * w["mu"] * G
        return ddot(mul(F, S), grad(v))  # pyright: ignore[reportArgumentType]

    basis = fem.Basis(other.basis.mesh, other.basis.elem, quadrature=_gauss(order))
    theirs = work.assemble(
        basis,
        moved=basis.interpolate(moved.ravel()[other.dof]),
        **{name: values[:, :1].repeat(basis.X.shape[-1], axis=1) for name, values in other.lame.items()},
    )
    np.testing.assert_allclose(ours, theirs, atol=1e-10 * np.abs(theirs).max())


def _gauss(order: int) -> tuple[np.ndarray, np.ndarray]:
    """The bricks' own quadrature: the forces of random large strains are no polynomials it is exact for."""
    x, w = np.polynomial.legendre.leggauss(order + 1)
    points = np.stack(np.meshgrid(x, x, x, indexing="ij")).reshape(3, -1)
    return (points + 1) / 2, np.einsum("a,b,c->abc", w, w, w).ravel() / 8


@pytest.mark.parametrize("order", [1, 2])
def test_the_tangent_is_the_derivative_of_the_force(order):
    mesh = mesh_of(order)
    rng = np.random.default_rng(3)
    moved, step = 0.003 * rng.normal(size=(2, *mesh.nodes.shape))
    _, tangent = internal_force(mesh, moved)
    assert tangent is not None
    after, before = (internal_force(mesh, moved + sign * 1e-5 * step, tangent=False)[0] for sign in (1, -1))
    expected = (after - before).ravel() / 2e-5
    np.testing.assert_allclose(tangent @ step.ravel(), expected, atol=1e-6 * np.abs(expected).max())
    assert abs(tangent - tangent.T).max() < 1e-12 * abs(tangent).max()


def test_at_rest_the_tangent_is_the_linear_stiffness():
    mesh = mesh_of(2)
    force, tangent = internal_force(mesh, np.zeros_like(mesh.nodes))
    assert tangent is not None
    assert np.abs(force).max() == 0
    matrix = linear_stiffness(mesh)
    assert abs(tangent - matrix).max() < 1e-12 * abs(matrix).max()


def test_large_turns_cost_nothing():
    mesh = mesh_of(1)
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    force, _ = internal_force(mesh, mesh.nodes @ turn.T - mesh.nodes, tangent=False)
    assert np.abs(force).max() < 1e-12


def test_the_nonlinear_solution_balances_the_load_and_small_ones_are_linear():
    pytest.importorskip("pyamg")
    grid, held = two_layers()
    mesh = bricks(grid, held, 1, 1)
    load = load_of(grid, 0.3)
    moved = nonlinear_solution(mesh, mesh, load)
    inner, _ = internal_force(mesh, moved, tangent=False)
    force = nodal_load(mesh, load)
    assert np.abs(inner - force)[mesh.free].max() < 1e-6 * np.abs(force).max()
    assert np.abs(moved).max() > 0.015  # an eighth of its length
    linear = linear_solution(mesh, mesh, load)
    assert np.linalg.norm(moved - linear) > 0.02 * np.linalg.norm(linear)
    small = nonlinear_solution(mesh, mesh, 1e-4 * load)
    np.testing.assert_allclose(small, 1e-4 * linear, atol=1e-3 * 1e-4 * np.abs(linear).max())
