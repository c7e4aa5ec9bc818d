"""Small bodies of every kind, and their finite elements solved directly, with the matrix assembled."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from mjframes.finite_elements.element import brick_stiffness
from mjframes.finite_elements.mesh import Mesh
from mjframes.finite_elements.solver import BodySolver, body_solver
from mjframes.volume.grid import Grid, voxel_grid
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

SPACING = (0.01, 0.012, 0.009)


@dataclass(frozen=True, eq=False)
class Solved:
    """A body's solver, and its matrix A (3N, 3N) [N/m].

    free: (3N,) whether a degree of freedom may move.  solve: from forces (3N, c) to displacements, held nodes at rest.
    """

    grid: Grid
    solver: BodySolver
    matrix: sparse.csr_array
    free: np.ndarray
    solve: Callable[[np.ndarray], np.ndarray]

    @property
    def centre(self) -> sparse.csr_array:
        """(3n, 3N) from nodes to voxels' centres."""
        return sparse.csr_array(sparse.kron(self.solver.centre.astype(float), sparse.eye_array(3)))


def grid_of(labels: np.ndarray, *materials: tuple[float, float], spacing: tuple[float, ...] = SPACING) -> Grid:
    """The grid of labels 1, 2, … made of (Young's modulus, Poisson's ratio)."""
    table = {i + 1: Material(young, poisson, 1000) for i, (young, poisson) in enumerate(materials)}
    return voxel_grid(Volume.from_labels(labels, np.array(spacing), table))


def assembled(grid: Grid, mesh: Mesh) -> sparse.csr_array:
    """A (3N, 3N) [N/m]."""
    bricks = np.array([m.young * brick_stiffness(m.poisson, grid.spacing) for m in grid.table])[mesh.material]
    dof = (3 * mesh.nodes[:, :, None] + np.arange(3)).reshape(-1, 24)
    rows, columns = np.repeat(dof, 24, axis=1).ravel(), np.tile(dof, (1, 24)).ravel()
    return sparse.csr_array((bricks.ravel(), (rows, columns)), shape=(3 * len(mesh.position),) * 2)


def rigid(points: np.ndarray) -> np.ndarray:
    """(3s, 6) the rigid motions of points (s, 3), not those of the project."""
    turns = [np.cross(axis, points - points.mean(axis=0)) for axis in np.eye(3)]
    moves = [np.tile(axis, (len(points), 1)) for axis in np.eye(3)]
    return np.stack([field.ravel() for field in (*moves, *turns)], axis=1)


def solved(grid: Grid, *held: np.ndarray) -> Solved:
    """A grid whose pieces `held`, masks (n,), do not move."""
    solver = body_solver(grid, [np.flatnonzero(mask) for mask in held])
    mesh = solver.mesh
    matrix = assembled(grid, mesh)
    free = np.repeat(mesh.held_by < 0, 3)
    scale = 1 / np.sqrt(matrix.diagonal()[free])
    system = sparse.csc_array(sparse.diags_array(scale) @ matrix[free][:, free] @ sparse.diags_array(scale))
    motions = np.zeros((len(scale), 0))
    if not held:  # multipliers keep the rigid motions out
        motions = np.linalg.qr(rigid(mesh.position * grid.spacing))[0] * scale[:, None]
        system = sparse.csc_array(sparse.block_array([[system, motions], [motions.T, None]]))
    factors = splu(system)

    def solve(forces: np.ndarray) -> np.ndarray:
        right = np.vstack([forces[free] * scale[:, None], np.zeros((motions.shape[1], forces.shape[1]))])
        found = factors.solve(right)
        found += factors.solve(right - system @ found)
        moved = np.zeros_like(forces)
        moved[free] = found[: len(scale)] * scale[:, None]
        return moved

    return Solved(grid, solver, matrix, free, solve)


def random_blocks(contrast: float) -> np.ndarray:
    return np.repeat(np.repeat(np.repeat(np.random.default_rng(3).integers(1, 3, (6, 5, 4)), 2, 0), 2, 1), 2, 2)


def _block(young: float = 1e4, poisson: float = 0.3, other: float = 1e4) -> Grid:
    return grid_of(random_blocks(other), (young, poisson), (other, poisson))


def _sheet() -> Grid:
    return grid_of(np.ones((24, 16, 1), int), (1e4, 0.3))


def _sheets() -> Grid:
    """Two sheets of one voxel, one voxel apart, that are joined along an edge."""
    labels = np.ones((22, 12, 3), int)
    labels[2:, :, 1] = 0
    return grid_of(labels, (1e4, 0.3))


def _strand() -> Grid:
    return grid_of(np.ones((90, 1, 1), int), (1e4, 0.3))


def _edges() -> Grid:
    """Three blocks, of which two touch along an edge and two at a corner, of two materials."""
    labels = np.zeros((12, 12, 12), int)
    labels[:6, :6, :6] = 1
    labels[6:, 6:, :6] = 2
    labels[:6, :6, :6][3:, 3:, 3:] = 2
    labels[:6, 6:, 6:] = 1
    labels[:6, 6:, 6:][:, 0, 0] = 2
    return grid_of(labels, (1e4, 0.3), (3e4, 0.4))


def _stair() -> Grid:
    """Voxels in a row that touch along edges only."""
    labels = np.zeros((40, 40, 3), int)
    labels[np.arange(40), np.arange(40)] = 1
    return grid_of(labels, (1e4, 0.3))


def _ends(grid: Grid) -> list[np.ndarray]:
    return [grid.index[:, 0] < 2]


def _several(grid: Grid, count: int) -> list[np.ndarray]:
    x, y = grid.index[:, :2].T
    masks = [x < 2, x > x.max() - 2, (abs(x - x.max() / 2) < 2) & (y < 2)]
    return masks[:count]


def _touching(grid: Grid) -> list[np.ndarray]:
    """Two pieces that share a face."""
    x, y = grid.index[:, :2].T
    return [(x < 2) & (y < 4), (x < 2) & (y >= 4)]


BODIES: dict[str, Callable[[], tuple[Grid, list[np.ndarray]]]] = {
    "block": lambda: (grid := _block(), _ends(grid)),
    "composite 1:1e4": lambda: (grid := _block(other=1e8), _ends(grid)),
    "composite 1:1e9": lambda: (grid := _block(other=1e13), _ends(grid)),
    "nearly incompressible": lambda: (grid := _block(poisson=0.499), _ends(grid)),
    "sheet": lambda: (grid := _sheet(), _ends(grid)),
    "two sheets": lambda: (grid := _sheets(), _ends(grid)),
    "strand": lambda: (grid := _strand(), _ends(grid)),
    "edges and a corner": lambda: (grid := _edges(), _ends(grid)),
    "stair": lambda: (grid := _stair(), _ends(grid)),
    "free": lambda: (_block(other=1e6), []),
    "free sheet": lambda: (_sheet(), []),
    "two pieces": lambda: (grid := _block(other=1e6), _several(grid, 2)),
    "three pieces": lambda: (grid := _block(), _several(grid, 3)),
    "touching pieces": lambda: (grid := _block(), _touching(grid)),
}


@cache
def body(name: str) -> Solved:
    grid, held = BODIES[name]()
    return solved(grid, *held)
