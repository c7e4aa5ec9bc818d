"""Quadrature points of the regions, for laws that are evaluated at run time (the paper, §5.3 and Table 1).

A region's voxels of one material make a cell. In a cell the frames' weights are linear: their mean and their mean slope
over its voxels. Then F = Σ_j x_j ∇W_jᵀ, ∇W_j = φ_j ∇w_i + w_i ∇φ_j, is a polynomial, of degree n − 1 for frames of
order n, and one more where weights vary. The cell's points integrate polynomials of the degree of Table 1's column f
exactly: 2 or 4 times that of F. Hence 1 point where F is constant, 4 for affine frames and small strains, 12 for all of
Green and Lagrange's. Since Σ_i w_i = 1, uniform deformations are exact at every point: the patch test.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mjframes.base.choices import COROTATIONAL
from mjframes.base.errors import MjframesError
from mjframes.base.rows import members_of
from mjframes.base.threads import in_parallel
from mjframes.elasticity.laws import LawParameters, law_parameters
from mjframes.elasticity.moments import inside, mean_monomials, rule
from mjframes.elasticity.regions import Regions
from mjframes.kinematics.control import ControlPoints, points_of
from mjframes.kinematics.gradients import product_rule
from mjframes.kinematics.shape_functions import ShapeFunctions
from mjframes.kinematics.tree import Tree
from mjframes.volume.grid import Grid
from mjframes.weights.weights import weight_gradients, weights_at

Array = NDArray[np.float64]
Strain = Literal["corotational", "green_lagrange"]

SHARE = 1 << 15  # [voxels] that one thread sums up at a time
CONSTANT = 1e-9  # [-] change of weights across a cell below which they count as constant
SQUARES = [9, 6, 4]  # places of x², y², z² among the monomials of degree ≤ 2
ENERGY_ORDER: dict[Strain, int] = {"corotational": 2, "green_lagrange": 4}  # Table 1: degree of f over that of F


@dataclass(frozen=True, eq=False)
class Quadrature:
    """The quadrature of r regions; m is the number of a region's control points and q that of its quadrature points.

    points: (m,) control points of each, ancestors in the tree first.
    position: (q, 3) volume coordinates [m].
    volume: (q,) [m³].
    gradient: (q, m, 3) ∇W_j [1/m].
    material: (q,) place in the grid's table.
    """

    points: tuple[NDArray[np.int64], ...]
    position: tuple[Array, ...]
    volume: tuple[Array, ...]
    gradient: tuple[Array, ...]
    material: tuple[NDArray[np.int64], ...]


@dataclass(frozen=True, eq=False)
class _Cell:
    """Voxels of one material in a region.

    frames: of the region, ancestors first.
    """

    region: int
    material: int
    frames: NDArray[np.int64]
    voxels: NDArray[np.int32]


def quadrature(
    grid: Grid,
    shapes: ShapeFunctions,
    regions: Regions,
    tree: Tree,
    strain: Strain = "corotational",
) -> Quadrature:
    """Return the quadrature points of every region.

    strain: whose energy they integrate exactly. "corotational": quadratic in F, that is, what any law is for small
    strains; "green_lagrange": quartic.
    Raise MjframesError for other strains.
    """
    if strain not in ENERGY_ORDER:
        raise MjframesError(f"strain is {strain!r}; it must be one of {', '.join(map(repr, ENERGY_ORDER))}.")
    weights, control = shapes.weights, shapes.control
    rank = np.argsort(tree.order)
    frames = [np.array(members)[np.argsort(rank[list(members)])] for members in regions.frames]
    cells = [
        _Cell(e, int(material), frames[e], voxels[grid.material[voxels] == material])
        for e, voxels in enumerate(members_of(regions.label, len(frames)))
        for material in np.unique(grid.material[voxels])
    ]
    fits = _linear_weights(grid, weights, regions, cells)

    def place(k: int) -> tuple[Array, Array, Array]:
        return _points_of_cell(grid, control, cells[k], *fits[k], ENERGY_ORDER[strain])

    made = list(in_parallel(place, range(len(cells))))
    of_region = [[k for k, cell in enumerate(cells) if cell.region == e] for e in range(len(frames))]
    return Quadrature(
        points=tuple(points_of(control, members)[0] for members in frames),
        position=tuple(np.concatenate([made[k][0] for k in some]) for some in of_region),
        volume=tuple(np.concatenate([made[k][1] for k in some]) for some in of_region),
        gradient=tuple(np.concatenate([made[k][2] for k in some]) for some in of_region),
        material=tuple(
            np.repeat([cells[k].material for k in some], [len(made[k][1]) for k in some]) for some in of_region
        ),
    )


def parameters(law: str, grid: Grid) -> tuple[LawParameters, ...]:
    """Return the law's constants for each material of the grid's table; none for the corotational law.

    Raise MjframesError for constants that the law cannot have.
    """
    return () if law == COROTATIONAL else tuple(law_parameters(law, material) for material in grid.table)


def _linear_weights(
    grid: Grid, weights: sparse.csr_array, regions: Regions, cells: list[_Cell]
) -> list[tuple[Array, Array, Array]]:
    """Of each cell the mean index (3,), the mean weights (f,) and their mean slopes (f, 3) [1/m]."""

    def work(share: tuple[int, NDArray[np.int32]]) -> tuple[Array, Array, Array]:
        cell, some = cells[share[0]], share[1]
        slope = weight_gradients(grid, weights, some, cell.frames, regions.label)
        index = grid.index[some].sum(axis=0, dtype=np.float64)
        return index, weights_at(weights, some, cell.frames).sum(axis=0), slope.sum(axis=0)

    shares = [
        (k, cell.voxels[start : start + SHARE])
        for k, cell in enumerate(cells)
        for start in range(0, len(cell.voxels), SHARE)
    ]
    sums = [(np.zeros(3), np.zeros(len(c.frames)), np.zeros((len(c.frames), 3))) for c in cells]
    for (k, _), found in zip(shares, in_parallel(work, shares), strict=True):
        for total, part in zip(sums[k], found, strict=True):
            total += part
    for cell, (index, value, slope) in zip(cells, sums, strict=True):
        for total in (index, value, slope):
            total /= len(cell.voxels)
        value /= value.sum()
        slope -= value[:, None] * slope.sum(axis=0)  # frames with all the weight: Σ_i ∇w_i = 0 but for rounding
    return sums


def _points_of_cell(
    grid: Grid, control: ControlPoints, cell: _Cell, center: Array, value: Array, slope: Array, energy_order: int
) -> tuple[Array, Array, Array]:
    """position (q, 3), volume (q,) and gradient (q, m, 3) of a cell's points; center: mean index of its voxels."""
    extent = (np.ptp(grid.index[cell.voxels], axis=0) + 1) * grid.spacing
    varies = np.abs(slope).max() * np.linalg.norm(extent) > CONSTANT
    points, _ = points_of(control, cell.frames)
    order = 2 if control.basis[points, 4:].any() else 1
    degree = energy_order * (order - 1 + int(varies))
    deviation = np.sqrt(mean_monomials(grid.index, cell.voxels, center, np.ones(3), 2)[SQUARES])
    measured = (grid.index, cell.voxels, center, deviation)
    found = rule(mean_monomials(*measured, degree), degree, lambda: inside(*measured))
    if found is None:
        raise MjframesError(
            f"no quadrature of degree {degree} fits the shape of region {cell.region}; change the number of samples."
        )
    offset = (found[0] * deviation * grid.spacing) @ grid.axes.T
    position = grid.origin + (center + 0.5) * grid.spacing @ grid.axes.T + offset
    weight = value + offset @ slope.T
    slopes = np.tile(slope, (len(offset), 1, 1))
    gradient = product_rule(control, cell.frames, weight, slopes, position)[1]
    return position, found[1] * (len(cell.voxels) * grid.cell_volume), gradient
