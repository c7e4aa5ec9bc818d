"""How the pull of a chamber grows as pressure widens it, by finite elements of second order.

Under a pressure p nodes move by u = p u₁ + p² u₂ + … and frames by x = x̄ + p x₁ + p² x₂ + …, with

    A u₁ = V',   A u₂ = V'' u₁ − ½ E'''(u₁, u₁)

for the volume V within the walls and the elements' energy E. Frames come to x if they are pulled by K x₁ + p s,
s = K x₂ + ½ E_f'''(x₁, x₁) with their own energy E_f. So that ℓ₀, which pulls by K x₁ at rest (tendon_slopes.py), does

    ℓ(x) = ℓ₀(x) + (ℓ₀(x) − ℓ̄) Σ_ij b_ij (|x_i − x_j| − |x̄_i − x̄_j|),
    Σ_j b_ij e_ij = (r − ½ (r · x₁) K x₁ / v)_i / v,   r = s − ℓ₀'' x₁,   v = x₁ · K x₁

Far from rest the plugin bounds the sum B, to B / √(1 + 4 B²). Both energies are corotational, also of hyperelastic
bodies, whose frames so come near that place only. With the symmetric and the skew part e and w of ∇u, the stress of
second order is μ (e w + w e − w²) + λ (tr e w − ½ tr w² 1). It is taken at the centres of the bricks, where their modes
of bending have no slopes. Index letters: i, j control point; f face of a wall; a its corner.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mjframes.elasticity.corotational import CorotationalRegion
from mjframes.finite_elements.element import CORNERS
from mjframes.finite_elements.solver import BodySolver
from mjframes.scene.tendon_slopes import Elements
from mjframes.volume.grid import Grid

Array = NDArray[np.float64]

STRAIN = 1e-4  # [-] of differences: large for what rounding leaves, small for terms of third order
GAUSS = (1 + np.array([-1, 1]) / np.sqrt(3)) / 2  # exact for the areas of bilinear faces


@dataclass(frozen=True, eq=False)
class Walls:
    """The faces of voxels around a cavity.

    node: (f, 4) their corners, counter-clockwise seen from the voxel, −1 for a held one.
    at: (f, 4, 3) these at rest, along the index axes [m].
    nodes: how many there are in the mesh.
    """

    node: NDArray[np.int32]
    at: Array
    nodes: int

    def load(self) -> Array:
        """Return V' (N, 3) at rest [m²], along the index axes."""
        return self._total(_face_forces(self.at))

    def change(self, moved: Array) -> Array:
        """Return V'' u (N, 3) [m²] of nodes that move by u (N, 3) [m]: V' is of second degree in u."""
        u = np.vstack([moved, np.zeros(3)])[self.node]
        return self._total((_face_forces(self.at + u) - _face_forces(self.at - u)) / 2)

    def _total(self, forces: Array) -> Array:
        total = np.zeros((self.nodes + 1, 3))
        np.add.at(total, self.node, forces)
        return total[:-1]


def walls_around(grid: Grid, solver: BodySolver, cavity: NDArray[np.bool_]) -> Walls:
    """Return the walls of a cavity, a mask (nx, ny, nz)."""
    node, at = [], []
    for axis, way in itertools.product(range(3), (-1, 1)):
        beside = np.roll(np.pad(cavity, 1), way, axis)[1:-1, 1:-1, 1:-1]
        voxel = grid.lookup[beside & (grid.lookup >= 0)]
        corner = CORNERS[CORNERS[:, axis] == (way < 0)][[0, 2, 3, 1]]
        if np.cross(corner[1] - corner[0], corner[3] - corner[0])[axis] != way:
            corner = corner[::-1]
        number = np.asarray(corner @ np.array([4, 2, 1]), np.int64)
        node.append(solver.node[voxel[:, None], number])
        at.append((grid.index[voxel][:, None] + corner) * grid.spacing)
    return Walls(np.concatenate(node), np.concatenate(at), len(solver.mesh.position))


def growth(
    elements: Elements, walls: Walls, moved: Array, x: Array, rest: Array, slopes: Callable[[Array], Array]
) -> Array | None:
    """Return Σ_j b_ij e_ij (k, 3), or None where pressure moves no frame, or where any frame is rigid or a point.

    moved, x: u₁ (N, 3), along the index axes, and x₁ (k, 3).  rest: of the control points (k, 3) [m].
    slopes: gives ∂ℓ₀/∂x (k, 3) for control points at x (k, 3).
    """
    body = elements.body
    pull = elements.pull(x)
    work = float((x * pull).sum())
    if not work > 0 or set(body.types[body.held :]) & {"rigid", "point"}:
        return None
    step = STRAIN * float(np.ptp(rest, axis=0).max()) / float(np.abs(x).max())
    curvature = (slopes(rest + step * x) - slopes(rest - step * x)) / (2 * step)
    second = elements.motion(walls.change(moved) - _second_force(elements, moved))[1]
    left = (elements.pull(second) + _second_pull(elements, x, step) - curvature) / work
    return left - 0.5 * float((left * x).sum()) / work * pull


def _face_forces(x: Array) -> Array:
    """∂V/∂x (f, 4, 3) [m²] of bilinear faces with corners x (f, 4, 3)."""
    total = np.zeros_like(x)
    for s, t in itertools.product(GAUSS, GAUSS):
        shape = np.array([(1 - s) * (1 - t), s * (1 - t), s * t, (1 - s) * t])
        along = np.array([t - 1, 1 - t, t, -t]) @ x, np.array([s - 1, -s, s, 1 - s]) @ x
        total += 0.25 * shape[:, None] * np.cross(*along)[:, None]
    return total


def _second_force(elements: Elements, moved: Array) -> Array:
    """½ E'''(u, u) (N, 3) of nodes that move by u (N, 3), with 0 for those that are held."""
    grid, mesh = elements.grid, elements.solver.mesh
    slope = (2 * CORNERS - 1) / (4 * grid.spacing)
    gradient = np.einsum("eai,aj->eij", moved[mesh.nodes], slope)
    e, w = (gradient + gradient.swapaxes(1, 2)) / 2, (gradient - gradient.swapaxes(1, 2)) / 2
    lam, mu = (grid.per_material(name)[mesh.material][:, None, None] for name in ("lam", "mu"))
    trace, turn = (np.trace(some, axis1=1, axis2=2)[:, None, None] for some in (e, w @ w))
    stress = mu * (e @ w + w @ e - w @ w) + lam * (trace * w - turn / 2 * np.eye(3))
    total = np.zeros_like(moved)
    np.add.at(total, mesh.nodes, grid.cell_volume * np.einsum("eij,aj->eai", stress, slope))
    total[mesh.held_by >= 0] = 0
    return total


def _second_pull(elements: Elements, x: Array, step: float) -> Array:
    """½ E_f'''(x, x) (k, 3) of frames that move by x (k, 3), by differences of `step` times that."""
    stiffness, rest = elements.body.stiffness, elements.body.control.rest
    total = np.zeros_like(x)
    for points, gradient, matrix in zip(stiffness.points, stiffness.gradient, stiffness.matrix, strict=True):
        region = CorotationalRegion(points, rest[points], gradient, matrix)
        forces = [region.response(rest[points] + sign * step * x[points])[0] for sign in (1, -1)]
        total[points] -= sum(forces) / (2 * step**2)
    return total
