"""What finite elements say of a body: displacements under each of its loads, and its natural frequencies.

Displacements are those of bricks of order 2, and once more those of Wilson's bricks on the voxels as they are. The
distance of the two is what the mesh that `build` has is off by. Frequencies are those of Wilson's bricks.
"""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import eigsh, splu

from mjframes.cache import cached
from mjframes.report.bodies import Body, all_bodies
from mjframes.report.bricks import Bricks, at_centers, bricks, nodal_load
from mjframes.report.cases import SMALL
from mjframes.report.incompatible import consistent_mass, incompatible_stiffness
from mjframes.report.reference import linear_solutions

Array = NDArray[np.float64]

MODES = 5
TOLERANCE = 1e-6  # [-] of the residual, for errors of a percent
SHIFT = 1e-10  # [-] of the stiffness a mass, added so that a free body's rigid motions have a frequency


@dataclass(frozen=True, eq=False)
class Exact:
    """loads: (c, n, 3) [N] the body's, scaled to move it by SMALL of its length at most.
    moved, coarse: (c, n, 3) [m] of the refined bricks, and of those on the voxels.  frequencies: (MODES,) [Hz].
    """

    loads: Array
    moved: Array
    coarse: Array
    frequencies: Array

    @property
    def mesh(self) -> Array:
        """(c,) relative L2 distance of the two."""
        return np.linalg.norm(self.coarse - self.moved, axis=(1, 2)) / np.linalg.norm(self.moved, axis=(1, 2))


def exact(body: Body) -> Exact:
    """Computed once, then kept."""
    loads = np.array([load.force for load in body.loads()])
    fixed = body.fixed is not None and body.fixed
    return Exact(**cached("exact", (body.volume, fixed, loads, TOLERANCE), lambda: _solve(body, loads)))


def all_exact(names: Sequence[str], progress: Callable[[str], None]) -> dict[str, Exact]:
    """Those of bodies of the full report, by name, several at once."""
    workers = min(len(os.sched_getaffinity(0)), len(names))
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as pool:
        jobs = {name: pool.submit(_named, name) for name in names}
        for name in names:
            progress(f"finite elements: {name}")
            jobs[name].result()
    return {name: job.result() for name, job in jobs.items()}


def _named(name: str) -> Exact:
    return exact(next(body for body in all_bodies(quick=False) if body.name == name))


def _solve(body: Body, loads: Array) -> dict[str, Array]:
    mesh, low, voxels = (bricks(body.grid, body.held, *level) for level in ((2, 1), (1, 2), (1, 1)))
    moved = np.array(
        [body.apart(at_centers(mesh, u)) for u in linear_solutions(mesh, low, loads, TOLERANCE)]
    )
    coarse, frequencies = _on_voxels(body, voxels, loads)
    scale = SMALL * body.length / np.abs(moved).max(axis=(1, 2), keepdims=True)
    return {"loads": scale * loads, "moved": scale * moved, "coarse": scale * coarse, "frequencies": frequencies}


def _on_voxels(body: Body, mesh: Bricks, loads: Array) -> tuple[Array, Array]:
    """By a direct solver; what carries a free body's rigid motions is so soft that it takes none of a balanced load."""
    moving = mesh.moving
    stiffness, mass = (
        sparse.csc_array(matrix[moving][:, moving])
        for matrix in (incompatible_stiffness(mesh), consistent_mass(mesh, body.grid.density))
    )
    softest = float(np.min(stiffness.diagonal() / mass.diagonal()))
    shift = SHIFT * softest
    shifted = sparse.csc_array(stiffness + shift * mass)
    factors = splu(shifted, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    found = np.zeros((len(loads), len(moving)))
    for field, load in zip(found, loads, strict=True):
        field[moving] = factors.solve(nodal_load(mesh, load).ravel()[moving])
    inverse = sparse.linalg.LinearOperator(shifted.shape, factors.solve, dtype=np.float64)
    rigid = 0 if body.fixed is not None else 6
    squares = eigsh(stiffness, k=rigid + MODES, M=mass, sigma=-shift, OPinv=inverse, return_eigenvectors=False)
    fields = np.array([body.apart(at_centers(mesh, field.reshape(-1, 3))) for field in found])
    return fields, np.sqrt(np.sort(squares)[rigid:]) / (2 * np.pi)
