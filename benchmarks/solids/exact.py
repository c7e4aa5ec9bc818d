"""What finite elements say of a body: displacements under each of its loads, and its natural frequencies.

Displacements are those of bricks of order 2, and once more those of Wilson's bricks on the voxels as they are. The
distance of the two is what the mesh that `build` has is off by. Frequencies are those of Wilson's bricks.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import eigsh, splu

from benchmarks.solids import SOURCES
from benchmarks.solids.bodies import Body, all_bodies
from benchmarks.solids.bricks import Bricks, at_centers, bricks, linear_stiffness, nodal_load
from benchmarks.solids.cases import SMALL
from benchmarks.solids.incompatible import consistent_mass, incompatible_stiffness
from benchmarks.solids.processes import by_name
from benchmarks.solids.reference import linear_solutions
from mjframes.base.cache import cached

Array = NDArray[np.float64]

MODES = 5
TOLERANCE = 1e-6  # [-] of the residual, for errors of a percent
MOST_NODES = 22_000  # [nodes] that are factorized: 1 GB
SHIFT = 1e-10  # [-] that the diagonal of a free body's stiffness is larger, which balanced loads do not feel


@dataclass(frozen=True, eq=False)
class Exact:
    """The solution of finite elements for a body.

    loads: (c, n, 3) [N] the body's, scaled to move it by SMALL of its length at most.
    moved, coarse: (c, n, 3) [m] of the refined bricks, and of those on the voxels.
    frequencies: (MODES,) [Hz].
    """

    loads: Array
    moved: Array
    coarse: Array
    frequencies: Array

    @property
    def mesh(self) -> Array:
        """Return the relative L2 distance (c,) of the two."""
        return np.linalg.norm(self.coarse - self.moved, axis=(1, 2)) / np.linalg.norm(self.moved, axis=(1, 2))


def exact_solution(body: Body) -> Exact:
    """Return the solution of a body, computed once, then kept."""
    loads = np.array([load.force for load in body.loads()])
    return Exact(**cached("exact", (SOURCES, body.volume, body.fixed, loads, TOLERANCE), lambda: _solve(body, loads)))


def exact_solutions(names: Sequence[str], progress: Callable[[str], None]) -> dict[str, Exact]:
    """Return those of bodies of the full report, by name, several computed at once."""
    return by_name(_named, names, progress)


def _named(name: str) -> Exact:
    return exact_solution(next(body for body in all_bodies(quick=False) if body.name == name))


def _solve(body: Body, loads: Array) -> dict[str, Array]:
    mesh, voxels = (bricks(body.grid, body.held, order, 1) for order in (2, 1))
    if len(mesh.nodes) > MOST_NODES:
        low = bricks(body.grid, body.held, 1, 2)
        moved = np.array([at_centers(mesh, u) for u in linear_solutions(mesh, low, loads, TOLERANCE)])
    else:
        moved = _direct(body, mesh, linear_stiffness(mesh), loads)
    stiffness = incompatible_stiffness(voxels)
    scale = SMALL * body.grid.length / np.abs(moved).max(axis=(1, 2), keepdims=True)
    found = {"loads": loads, "moved": moved, "coarse": _direct(body, voxels, stiffness, loads)}
    frequencies = _frequencies(body, voxels, stiffness)
    return {name: scale * fields for name, fields in found.items()} | {"frequencies": frequencies}


def _direct(body: Body, mesh: Bricks, stiffness: sparse.csr_array, loads: Array) -> Array:
    """Displacements (c, n, 3) [m] of the voxels under `loads` (c, n, 3) [N], by a factorization."""
    moving = mesh.moving
    matrix = sparse.csc_array(stiffness[moving][:, moving])
    if body.fixed is None:
        matrix.setdiag((1 + SHIFT) * matrix.diagonal())
    factors = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    found = np.empty_like(loads)
    for field, load in zip(found, loads, strict=True):
        nodes = np.zeros(len(moving))
        nodes[moving] = factors.solve(nodal_load(mesh, load).ravel()[moving])
        field[:] = body.apart(at_centers(mesh, nodes.reshape(-1, 3)))
    return found


def _frequencies(body: Body, mesh: Bricks, stiffness: sparse.csr_array) -> Array:
    """(MODES,) [Hz] the lowest, without rigid motions."""
    moving, rigid = mesh.moving, 6 if body.fixed is None else 0
    matrix, mass = (
        sparse.csc_array(some[moving][:, moving]) for some in (stiffness, consistent_mass(mesh, body.grid.density))
    )
    ratio = np.divide(matrix.diagonal(), mass.diagonal())
    below = -1e-6 * float(ratio.min())  # [1/s²] where K − σ M is regular
    squares = eigsh(matrix, k=rigid + MODES, M=mass, sigma=below, return_eigenvectors=False)
    return np.sqrt(np.sort(squares)[rigid:]) / (2 * np.pi)
