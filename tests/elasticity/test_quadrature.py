from __future__ import annotations

from itertools import product
from typing import get_args

import numpy as np
import pytest
from builders.harness import region
from builders.shapes import block, mixed
from scipy import sparse

from mjframes.base.errors import MjframesError
from mjframes.elasticity.law_table import LAWS
from mjframes.elasticity.laws import law_parameters
from mjframes.elasticity.moments import inside, mean_monomials, rule
from mjframes.elasticity.quadrature import Quadrature, Strain, quadrature
from mjframes.elasticity.regions import split_regions
from mjframes.elasticity.stiffness import region_stiffness
from mjframes.frames.placement import place_frames
from mjframes.kinematics.control import control_points, points_of
from mjframes.kinematics.gradients import control_gradients
from mjframes.kinematics.monomials import exponents, monomials
from mjframes.kinematics.shape_functions import ShapeFunctions
from mjframes.kinematics.tree import elimination_tree
from mjframes.volume.grid import Grid, voxel_grid
from mjframes.weights.voronoi import voronoi_weights


class Model:
    """All stages up to the quadrature."""

    def __init__(self, grid: Grid, frames: int, samples: int, kind: str = "affine", linear: bool = False) -> None:
        self.grid = grid
        if linear:  # along the whole of a box, two frames
            t = (grid.index[:, 0] + 0.5) / grid.lookup.shape[0]
            self.weights = sparse.csr_array(np.stack([1 - t, t], axis=1))
        else:
            self.weights = voronoi_weights(grid, place_frames(grid, frames))
        self.control = control_points(grid, self.weights, (kind,) * frames)
        self.regions = split_regions(grid, self.weights, samples)
        self.tree = elimination_tree(self.regions.frames, frames)
        self.arguments = (grid, ShapeFunctions(self.weights, self.control), self.regions, self.tree)
        self.degree_of_f = 2 if kind == "quadratic" else 1  # linear weights

    def quadrature(self, strain: Strain) -> Quadrature:
        return quadrature(*self.arguments, strain=strain)


MODELS = {
    "three materials": Model(voxel_grid(mixed()), 5, 8),
    "quadratic": Model(voxel_grid(mixed()), 3, 4, "quadratic"),
    "plate": Model(block(15, 9, 1, label=2), 4, 12),
    "linear": Model(block(30, 6, 6), 2, 1, linear=True),
}
TABLE_1 = {"corotational": 2, "green_lagrange": 4}  # degree of f, over that of F


@pytest.fixture(params=MODELS, ids=str)
def model(request: pytest.FixtureRequest) -> Model:
    return MODELS[request.param]


@pytest.mark.parametrize("strain", get_args(Strain))
def test_polynomials_are_integrated_exactly_in_every_material_of_every_region(model: Model, strain: Strain) -> None:
    rng = np.random.default_rng(0)
    made = model.quadrature(strain)
    varying = 0
    for e in range(len(model.regions.frames)):
        for material in np.unique(model.grid.material[model.regions.label == e]):
            voxels = np.flatnonzero((model.regions.label == e) & (model.grid.material == material))
            some = made.material[e] == material
            # a rule of one point is where F is constant
            full = TABLE_1[strain] * model.degree_of_f
            degree = {1: 1, 4: 2, 12: 4, 14: 4}.get(int(some.sum()), full)
            varying += degree == full
            powers = exponents(degree)
            coefficients = rng.normal(size=len(powers))
            centers = model.grid.points(voxels)
            middle, size = centers.mean(axis=0), np.ptp(centers, axis=0).max() + model.grid.spacing.max()
            exact = 0.0
            nodes, shares = np.polynomial.legendre.leggauss(5)  # in each voxel
            for where in product(range(5), repeat=3):
                step = model.grid.axes @ (0.5 * nodes[list(where)] * model.grid.spacing)
                share = model.grid.cell_volume * np.prod(0.5 * shares[list(where)])
                exact += share * (coefficients @ monomials((centers + step - middle) / size, powers)).sum()
            values = coefficients @ monomials((made.position[e][some] - middle) / size, powers)
            found = made.volume[e][some] @ values
            assert abs(found - exact) < 1e-12 * np.abs(coefficients).sum() * len(voxels) * model.grid.cell_volume
    assert varying > 0


@pytest.mark.parametrize(("strain", "most"), [("corotational", 4), ("green_lagrange", 12)])
def test_points_are_few_and_weights_positive(strain: Strain, most: int) -> None:
    for name in ("three materials", "plate", "linear"):
        model = MODELS[name]
        made = model.quadrature(strain)
        for e, volume in enumerate(made.volume):
            voxels = model.regions.label == e
            assert volume.min() > 0
            assert volume.sum() == pytest.approx(voxels.sum() * model.grid.cell_volume, rel=1e-12)
            assert len(volume) <= most * len(np.unique(model.grid.material[voxels])) + 2
    assert [len(v) for v in MODELS["linear"].quadrature(strain).volume] == [most]


def test_uniform_deformations_are_exact_at_every_point(model: Model) -> None:
    made = model.quadrature("green_lagrange")
    for points, gradient in zip(made.points, made.gradient, strict=True):
        F = np.einsum("jr,qja->qra", model.control.rest[points], gradient)
        assert np.abs(F - np.eye(3)).max() < 1e-11
        assert np.abs(gradient.sum(axis=1)).max() < 1e-9  # of gradients around 100 / m


def test_control_points_come_as_in_the_stiffness(model: Model) -> None:
    stiffness = region_stiffness(*model.arguments)
    for found, expected in zip(model.quadrature("corotational").points, stiffness.points, strict=True):
        np.testing.assert_array_equal(found, expected)


def test_linear_weights_give_the_stiffness_summed_over_the_voxels() -> None:
    """Small strains of any law: at rest, K is K_e up to the voxels' own extent, h²/12 in second moments."""
    model = MODELS["linear"]
    expected = region_stiffness(*model.arguments).matrix
    made = model.quadrature("corotational")
    for law in LAWS:
        materials = [law_parameters(law, material) for material in model.grid.table]
        for e, points in enumerate(made.points):
            m = len(points)
            count = m * (m + 1) // 2
            force, stiffness = np.zeros_like(model.control.rest), np.zeros((count, 3, 3))
            energy = region(
                materials, made.material[e], points, made.gradient[e], made.volume[e], np.arange(count),
                model.control.rest, force, stiffness,
            )  # fmt: skip
            blocks = np.zeros((m, m, 3, 3))
            j, k = np.tril_indices(m)
            blocks[j, k], blocks[k, j] = stiffness, stiffness.transpose(0, 2, 1)
            matrix = blocks.transpose(0, 2, 1, 3).reshape(3 * m, 3 * m)
            scale = np.abs(expected[e]).max()
            assert abs(energy) < 1e-15 * scale
            assert np.abs(force).max() < 1e-12 * scale
            # bending terms grow by 1/6² + …: a voxel is a sixth of the section
            assert np.abs(matrix - expected[e]).max() < 0.03 * scale
            uniform = (model.control.rest[points] @ np.random.default_rng(1).normal(size=(3, 3))).ravel()
            assert uniform @ matrix @ uniform == pytest.approx(uniform @ expected[e] @ uniform, rel=1e-10)


def test_gradients_are_those_of_linear_weights() -> None:
    """At the mean of a cell's voxels and as a mean over them, where weights are linear."""
    model = MODELS["linear"]
    made = model.quadrature("green_lagrange")
    for e, members in enumerate(model.regions.frames):
        voxels, frames = np.flatnonzero(model.regions.label == e), np.array(members)
        rank = np.argsort(model.tree.order)
        frames = frames[np.argsort(rank[frames])]
        inner = voxels[(np.abs(model.grid.index[voxels] - model.grid.index[voxels].mean(axis=0)) < 2).all(axis=1)]
        at_voxels = control_gradients(model.grid, model.weights, model.control, inner, frames)
        # ∇W is linear in p: fit it to the quadrature points, evaluate it at the voxels
        ones = np.ones((len(made.position[e]), 1))
        fit = np.linalg.lstsq(np.hstack([ones, made.position[e]]), made.gradient[e].reshape(len(ones), -1), rcond=None)[
            0
        ]
        centers = model.grid.points(inner)
        found = np.hstack([np.ones((len(inner), 1)), centers]) @ fit
        assert len(points_of(model.control, frames)[0]) == made.gradient[e].shape[1]
        assert np.abs(found.reshape(at_voxels.shape) - at_voxels).max() < 1e-9 * np.abs(at_voxels).max()


def test_constant_deformation_takes_one_point() -> None:
    made = Model(block(6, 5, 4), 1, 1).quadrature("green_lagrange")
    assert [len(volume) for volume in made.volume] == [1]


@pytest.mark.parametrize("degree", [2, 4, 8])
@pytest.mark.parametrize("kind", ["one", "row", "plate", "box", "corner", "two parts", "dust", "shell", "fork"])
def test_a_rule_fits_every_shape(kind: str, degree: int) -> None:
    rng = np.random.default_rng(7)
    index = np.stack(np.meshgrid(*map(np.arange, (24, 10, 8)), indexing="ij"), axis=-1).reshape(-1, 3).astype(np.int32)
    x, y, z = index.T
    voxels = np.flatnonzero(
        {
            "one": np.arange(len(index)) == 100,
            "row": (y == 0) & (z == 0),
            "plate": z == 0,
            "box": x >= 0,
            "corner": x + y + z < 8,
            "two parts": (x < 4) | (x > 20),
            "dust": rng.random(len(index)) < 0.05,
            "shell": (index == 0).any(axis=1) | (index == [23, 9, 7]).any(axis=1),
            "fork": (x < 4) | (x > 19) | (z < 2),
        }[kind]
    ).astype(np.int32)
    center = index[voxels].mean(axis=0)
    deviation = np.sqrt(index[voxels].var(axis=0) + 1 / 12)
    mean = mean_monomials(index, voxels, center, deviation, degree)
    found = rule(mean, degree, lambda: inside(index, voxels, center, deviation))
    assert found is not None
    points, weights = found
    assert len(weights) <= {2: 4, 4: 14, 8: 165}[degree]
    assert weights.min() > 0
    assert np.abs(monomials(points, exponents(degree)) @ weights - mean).max() < 1e-12 * np.abs(mean).max()
    offset = 0.5 * 0.6**0.5 * np.array(list(product((-1, 0, 1), repeat=3)))  # Gauss's points, exact to degree 5
    share = np.prod(np.where(offset == 0, 8, 5) / 18, axis=1)
    if degree <= 4:
        dense = ((index[voxels][:, None] + offset - center) / deviation).reshape(-1, 3)
        exact = monomials(dense, exponents(degree)) @ np.tile(share, len(voxels)) / len(voxels)
        assert np.abs(mean - exact).max() < 1e-12 * np.abs(exact).max()


def test_the_same_volume_gives_the_same_points_to_the_bit() -> None:
    first, second = (MODELS["three materials"].quadrature("green_lagrange") for _ in range(2))
    for name in ("position", "volume", "gradient", "material"):
        for a, b in zip(getattr(first, name), getattr(second, name), strict=True):
            np.testing.assert_array_equal(a, b)


def test_an_unknown_strain_is_named() -> None:
    with pytest.raises(MjframesError, match="'hencky'"):
        quadrature(*MODELS["plate"].arguments, strain="hencky")  # pyright: ignore[reportArgumentType]
