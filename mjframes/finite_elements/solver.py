"""What all loads on a body have in common: its mesh, its levels and where its voxels' centres are among the nodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mjframes.base.rigid import motion_basis
from mjframes.finite_elements.levels import Levels, body_levels
from mjframes.finite_elements.matrices import Floats
from mjframes.finite_elements.mesh import Mesh, body_mesh
from mjframes.volume.grid import Grid


@dataclass(frozen=True, eq=False)
class BodySolver:
    """A body of n voxels, ready to be loaded.

    held: the voxels of each piece that moves rigidly.
    node: (n, 8) of the voxels' corners, in the order of `element.CORNERS`, −1 for a held voxel.
    centre: (n, N) sparse C, the displacement of a voxel's centre as the mean of its corners'; 0 for a held voxel.
    """

    grid: Grid
    held: tuple[NDArray[np.integer], ...]
    mesh: Mesh
    levels: Levels
    node: NDArray[np.int32]
    centre: sparse.csr_array

    @cached_property
    def rigid(self) -> Floats:
        """Return the rigid motions of the nodes, (3N, 6) orthonormal."""
        return motion_basis(self.mesh.position * self.grid.spacing).astype(self.levels.dtype)

    def remove_rigid(self, x: Floats) -> None:
        """Take the rigid motions out of displacements (N, 3, k) of the nodes."""
        table = x.reshape(-1, self.levels.columns)
        table -= self.rigid @ (self.rigid.T @ table)


def body_solver(grid: Grid, held: Sequence[NDArray[np.integer]] = ()) -> BodySolver:
    """Return what is needed to solve for loads on a body. held: the voxel numbers of each piece that moves rigidly.

    Everything is along the index axes. Raise MjframesError for a body in several parts, for an empty piece, and for
    pieces that overlap or leave nothing free.
    """
    mesh = body_mesh(grid, held)
    known = np.flatnonzero(mesh.voxel >= 0)  # in the order of the voxels
    corners = mesh.nodes[known].ravel()
    node = np.full((len(grid.index), 8), -1, np.int32)
    node[mesh.voxel[known]] = corners.reshape(-1, 8)
    start = np.append(0, 8 * (node[:, 0] >= 0))
    eighths = np.full(len(corners), 0.125, np.float32)
    shape = (len(grid.index), len(mesh.position))
    centre = sparse.csr_array((eighths, corners, np.cumsum(start, dtype=np.int32)), shape=shape)
    return BodySolver(grid, tuple(held), mesh, body_levels(grid, mesh), node, centre)
