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
from scipy.sparse.linalg import LinearOperator, eigsh, splu

from mjframes.cache import cached
from mjframes.report.bodies import Body, all_bodies
from mjframes.report.bricks import Bricks, at_centers, bricks, linear_stiffness, nodal_load, nodal_mass
from mjframes.report.cases import SMALL
from mjframes.report.incompatible import consistent_mass, incompatible_stiffness
from mjframes.report.reference import linear_solutions

Array = NDArray[np.float64]

MODES = 5
TOLERANCE = 1e-6  # [-] of the residual, for errors of a percent
MOST_NODES = 22_000  # [nodes] that are factorized: 1 GB
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
    mesh, voxels = (bricks(body.grid, body.held, order, 1) for order in (2, 1))
    density, cell = body.grid.density, body.grid.cell_volume
    if len(mesh.nodes) > MOST_NODES:
        low = bricks(body.grid, body.held, 1, 2)
        moved = np.array([at_centers(mesh, u) for u in linear_solutions(mesh, low, loads, TOLERANCE)])
    else:
        mass = sparse.diags_array(np.repeat(nodal_mass(mesh, density * cell), 3), format="csr")
        moved = Factors(body, mesh, linear_stiffness(mesh), mass).solved(loads)
    factors = Factors(body, voxels, incompatible_stiffness(voxels), consistent_mass(voxels, density))
    scale = SMALL * body.length / np.abs(moved).max(axis=(1, 2), keepdims=True)
    found = {"loads": loads, "moved": moved, "coarse": factors.solved(loads)}
    return {name: scale * fields for name, fields in found.items()} | {"frequencies": factors.frequencies()}


class Factors:
    """A stiffness (3N, 3N), factorized; that of a free body with so little of its mass that loads do not feel it."""

    def __init__(self, body: Body, mesh: Bricks, stiffness: sparse.csr_array, mass: sparse.csr_array) -> None:
        moving = mesh.moving
        self.body, self.mesh = body, mesh
        self.stiffness, self.mass = (sparse.csc_array(some[moving][:, moving]) for some in (stiffness, mass))
        softest = float(np.min(self.stiffness.diagonal() / self.mass.diagonal()))
        self.shift = SHIFT * softest if body.fixed is None else 0.0
        self.shifted = sparse.csc_array(self.stiffness + self.shift * self.mass)
        self.factors = splu(
            self.shifted, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
        )

    def solved(self, loads: Array) -> Array:
        """Displacements (c, n, 3) [m] of the voxels under `loads` (c, n, 3) [N]."""
        moving, found = self.mesh.moving, np.empty_like(loads)
        for field, load in zip(found, loads, strict=True):
            nodes = np.zeros(len(moving))
            nodes[moving] = self.factors.solve(nodal_load(self.mesh, load).ravel()[moving])
            field[:] = self.body.apart(at_centers(self.mesh, nodes.reshape(-1, 3)))
        return found

    def frequencies(self) -> Array:
        """(MODES,) [Hz] the lowest, without rigid motions."""
        rigid = 6 if self.body.fixed is None else 0
        inverse = LinearOperator(self.shifted.shape, self.factors.solve, dtype=np.float64)
        squares = eigsh(
            self.stiffness, k=rigid + MODES, M=self.mass, sigma=-self.shift, OPinv=inverse, return_eigenvectors=False
        )
        return np.sqrt(np.sort(squares)[rigid:]) / (2 * np.pi)
