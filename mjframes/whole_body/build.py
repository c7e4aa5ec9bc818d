"""The stages of the whole body's stiffness, in order.

mesh and solver → superelement → covariance selection → regions → control weights that follow the body → modes → error
→ cells, for hyperelastic laws
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mjframes.finite_elements.displacements import displacements
from mjframes.finite_elements.solver import BodySolver, body_solver
from mjframes.grid import Grid
from mjframes.laws import LawParameters
from mjframes.regions import frame_sets
from mjframes.shape_functions import ShapeFunctions
from mjframes.stiffness import Stiffness
from mjframes.whole_body.cells import Cells, cells
from mjframes.whole_body.error import BodyError, LoadCases, coordinates, load_cases, measured
from mjframes.whole_body.following import assembled, compliance, correction
from mjframes.whole_body.lifting import Lifting, displaced, lifting
from mjframes.whole_body.regions import regions_of
from mjframes.whole_body.selection import families, select
from mjframes.whole_body.superelement import superelement

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FiniteElements:
    """What does not depend on the frames.  solver: of the voxels.  held: how many pieces are.
    cases: loads.  exact: (n, 3, c) how they move the voxels [m], in volume coordinates.
    """

    solver: BodySolver
    held: int
    cases: LoadCases
    exact: Array


@dataclass(frozen=True, eq=False)
class WholeBody:
    """stiffness: of the regions.  region: (n,) of each voxel.  shapes: weights that follow the body.
    lifting: what the body moves beyond them.  error: against the finite elements.
    where: (n,) its root mean square over the load cases, to that of the displacements [-].
    cells: where a hyperelastic law is evaluated, None for the corotational one.
    """

    stiffness: Stiffness
    region: NDArray[np.int32]
    shapes: ShapeFunctions
    lifting: Lifting
    error: BodyError
    where: Array
    cells: Cells | None


def finite_elements(grid: Grid, cores: Sequence[NDArray[np.integer]]) -> FiniteElements:
    """Return the finite elements on the voxels, of which `cores` are held."""
    solver, cases = body_solver(grid, cores), load_cases(grid, cores)
    moved = displacements(solver, np.einsum("ba,vbc->vac", grid.axes, cases.force))
    return FiniteElements(solver, len(cores), cases, np.einsum("ab,vbc->vac", grid.axes, moved))


def whole_body(
    grid: Grid,
    finite: FiniteElements,
    shapes: ShapeFunctions,
    types: Sequence[str],
    links: Sequence[str],
    laws: Sequence[LawParameters],
    progress: Callable[[str], None],
) -> WholeBody:
    """Return what finite elements on the voxels make of frames with the weights `shapes`.

    types: (f,) of the frames.  links: the bodies that hold the first ones.  laws: of each material of the grid's table,
    none for the corotational law.
    """
    held, k = len(links), len(shapes.control.frame)
    place = np.arange(len(grid.index))
    progress("condensing the whole body")
    element = superelement(grid, shapes.weights, shapes.control, types, held, finite.solver)
    sets = frame_sets(shapes.weights)[1]
    parts = select(element.matrix, shapes.control, families([np.flatnonzero(row) for row in sets], len(types)))
    stiffness, region = regions_of(grid, shapes.weights, shapes.control, parts, links)
    covariance = compliance(assembled(stiffness, k), shapes.control, types, held)
    progress("refitting the weights")
    change = correction(grid, shapes, element, covariance, place)
    following = ShapeFunctions(shapes.weights, shapes.control, change)
    functions = following.at_voxels(grid)
    lifted = lifting(grid, functions, shapes.control, element, covariance, stiffness, region, place)
    x = coordinates(shapes.at_voxels(grid), functions, covariance, finite.cases)
    found = (functions @ x.reshape(k, -1)).reshape(finite.exact.shape) + displaced(lifted, stiffness, region, x)
    error, where = measured(grid, finite.cases, finite.exact, found)
    some = None
    if laws:
        progress("placing the cells")
        some = cells(grid, shapes.control, types, held, element, stiffness, region, place, laws)
    return WholeBody(stiffness, region, following, lifted, error, where, some)
