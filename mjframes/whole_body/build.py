"""The stages of the whole body's stiffness, in order.

mesh and solver → superelement → covariance selection → regions → control weights that follow the body → modes → error
→ strains → cells, for hyperelastic laws
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mjframes.elasticity.laws import LawParameters
from mjframes.elasticity.regions import frame_sets
from mjframes.elasticity.shares import groups
from mjframes.elasticity.stiffness import Stiffness
from mjframes.finite_elements.batch import Progress, averages
from mjframes.finite_elements.displacements import displacements
from mjframes.finite_elements.solver import BodySolver, body_solver
from mjframes.kinematics.shape_functions import ShapeFunctions
from mjframes.volume.grid import Grid
from mjframes.whole_body.blocks import blocks_of
from mjframes.whole_body.cells import Cells, cells
from mjframes.whole_body.error import BodyError, LoadCases, coordinates, load_cases, measured, reaches
from mjframes.whole_body.far_bends import bends, far_bends
from mjframes.whole_body.modes import Lifting, displaced, lifting
from mjframes.whole_body.probes import Answers, Probes, answers, probed, probes
from mjframes.whole_body.pushes import free_surface
from mjframes.whole_body.regions import bone_frames, regions_of
from mjframes.whole_body.selection import select
from mjframes.whole_body.strains import Strains, motions, strains
from mjframes.whole_body.superelement import Superelement, superelement
from mjframes.whole_body.weight_correction import assembled, compliance, correction

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FiniteElements:
    """What does not depend on the frames.

    solver: of the voxels.
    held: how many pieces are.
    cases: loads.
    exact: (n, 3, c) float32, how they move the voxels [m], in volume coordinates.
    reach: (c,) how far at most, to the length of the body [-].
    probes: small pushes.
    """

    solver: BodySolver
    held: int
    cases: LoadCases
    exact: NDArray[np.float32]
    reach: Array
    probes: Probes


@dataclass(frozen=True, eq=False)
class Condensed:
    """The body condensed to its frames.

    stiffness: of the regions.
    region: (n,) of each voxel.
    shapes: weights that follow the body.
    lifting: what the body moves beyond them.
    strains: how it strains.
    error: against the finite elements.
    where: (n,) its root mean square over the load cases, to that of the displacements [-].
    cells: where a hyperelastic law is evaluated, None for the corotational one.
    answers: to pushes, for the dents.
    """

    stiffness: Stiffness
    region: NDArray[np.int32]
    shapes: ShapeFunctions
    lifting: Lifting
    strains: Strains
    error: BodyError
    where: Array
    cells: Cells | None
    answers: Answers


def finite_elements(
    grid: Grid, cores: Sequence[NDArray[np.integer]], progress: Callable[[str], None]
) -> FiniteElements:
    """Return the finite elements on the voxels, of which `cores` are held. progress: called with what is being done."""
    progress("solving the finite elements")
    surface = free_surface(grid, cores)
    solver, cases = body_solver(grid, cores), load_cases(grid, cores, surface)
    small, pushed = probes(grid, cores, surface)
    axes = grid.axes.astype(np.float32)
    force = np.einsum("ba,vbc->vac", axes, np.concatenate([cases.force, small], axis=2))
    moved = displacements(solver, force, _counted("solving the finite elements", progress))
    exact = np.einsum("ab,vbc->vac", axes, moved)
    count = cases.force.shape[2]
    of_probes = probed(grid, small, pushed, exact[:, :, count:])
    own = exact[:, :, :count].copy()
    return FiniteElements(solver, len(cores), cases, own, reaches(grid, cases, own), of_probes)


def whole_body(
    grid: Grid,
    finite: FiniteElements,
    shapes: ShapeFunctions,
    parents: Mapping[int, Sequence[int]],
    types: Sequence[str],
    links: Sequence[str],
    laws: Sequence[LawParameters],
    progress: Callable[[str], None],
) -> Condensed:
    """Return what finite elements on the voxels make of frames with the weights `shapes`.

    parents: of each frame, see `families`.  types: (f,) of the frames.  links: the bodies that hold the first ones.
    laws: of each material of the grid's table, none for the corotational law.
    progress: called with what is being done.
    """
    held, control = len(links), shapes.control
    progress("condensing the whole body")
    label, sets = frame_sets(shapes.weights)
    frames_of = [np.flatnonzero(row).tolist() for row in sets]
    blocks = blocks_of(grid, label, finite.solver.node[:, 0] < 0)
    report = _counted("condensing the whole body", progress)
    bones = bone_frames(grid, shapes.weights, types, held)
    types = tuple("rigid" if i in bones else kind for i, kind in enumerate(types))
    element = superelement(
        grid, shapes.weights, control, types, held, finite.solver, blocks, report, groups(grid.table)
    )
    parts = select(element.matrix, control, parents, element.shares)
    stiffness, region = regions_of(grid, label, frames_of, control, parts, links, bones)
    matrix = assembled(stiffness, len(control.frame))
    covariance = compliance(matrix, control, types, held)
    progress("refitting the weights")
    plain = shapes.at_voxels(grid)
    change, lifted = _followed(grid, shapes, plain, element, covariance, stiffness, region, blocks)
    corrected = sparse.csr_array(plain + change)
    x = coordinates(plain, corrected, covariance, finite.cases)
    moved = (corrected @ x.reshape(len(control.frame), -1)).reshape(finite.exact.shape)
    answered = answers(grid, finite.probes, corrected, covariance)
    moved += displaced(lifted, stiffness, region, x)
    error, where = measured(grid, finite.cases, finite.exact, moved)
    del moved
    exact = _at_places(grid, finite.exact, blocks)
    known = motions(matrix, covariance, control, held, element, x, exact, finite.cases.weights)
    strained = strains(grid, finite.solver.held, blocks, control, known, stiffness, region)
    some = None
    if laws:
        progress("placing the cells")
        some = cells(grid, control, types, held, element, stiffness, region, blocks, laws, len(bones))
    linear = some.remainder if some else stiffness.matrix
    firmness = float(grid.young.sum()) * grid.cell_volume
    points = x.reshape(len(control.frame), 3, -1)
    bent = bends(finite.reach, finite.cases.weights, float(grid.density.sum()) * grid.cell_volume)
    far = far_bends(control, stiffness, linear, covariance, points, finite.reach, bent, firmness)
    error = replace(error, bends=far)
    shapes = ShapeFunctions(shapes.weights, control, change)
    return Condensed(stiffness, region, shapes, lifted, strained, error, where, some, answered)


def _followed(
    grid: Grid,
    shapes: ShapeFunctions,
    plain: sparse.csr_array,
    element: Superelement,
    covariance: Array,
    stiffness: Stiffness,
    region: NDArray[np.int32],
    blocks: NDArray[np.integer],
) -> tuple[sparse.csr_array, Lifting]:
    """ΔW (n, k) and the modes of the voxels, fitted at the element's places. plain: (n, k) w_i φ_j."""
    mean = averages(blocks)
    weights, functions = (sparse.csr_array(mean @ some) for some in (shapes.weights, plain))
    weights.sort_indices()
    change = correction(weights, functions, shapes.control, grid.axes, element, covariance)
    first = np.unique(blocks, return_index=True)[1]
    lifted = lifting(functions + change, shapes.control, grid.axes, element, covariance, stiffness, region[first])
    return sparse.csr_array(change[blocks]), Lifting(lifted.mode[blocks], lifted.share)


def _at_places(grid: Grid, moved: NDArray[np.float32], blocks: NDArray[np.integer]) -> NDArray[np.float32]:
    """Displacements (n, 3, c) of the voxels as those of the places (r, 3, c), along the grid's axes."""
    mean = averages(blocks).astype(np.float32) @ moved.reshape(len(moved), -1)
    return np.einsum("ba,vbc->vac", grid.axes.astype(np.float32), mean.reshape(-1, *moved.shape[1:]))


def _counted(stage: str, progress: Callable[[str], None]) -> Progress:
    """What a solver calls after each batch: it adds the part that is done to the name of the stage."""
    return lambda done, of: progress(f"{stage}: {done / of:.0%}")
