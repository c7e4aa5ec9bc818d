"""What a tendon pulls at a soft body by finite elements, and a correction of its length that pulls the same at rest.

The frames know what is around a chamber or a fibre by smooth weights only, which miss what thin walls do. With the
forces f = ∂ℓ/∂u of a unit force on the tendon on the nodes of the finite elements, frames see the moments of how these
move, x = G⁻¹ Bᵀ A⁻¹ f (whole_body/superelement.py), and are pulled there by K x. The length becomes

    ℓ(x) = ℓ(W x) + Σ_ij c_ij (|x_i − x_j| − |x̄_i − x̄_j|),   Σ_j c_ij e_ij = (K x)_i − (∂ℓ(W x)/∂x)_i at rest

over pairs of control points of a region, e_ij from j to i, with the least Σ c². Distances do not change where all
turns, so that forces inside the body stay inside. The correction does not change as the body moves; of a chamber, whose
pull grows as its walls widen it, what of the pull is like ∂ℓ(W x)/∂x comes from a multiple of the volume's change:

    ℓ(x) = ℓ̄ + a (ℓ(W x) − ℓ̄) + …,   a = (K x)ᵀ K⁺ g / gᵀ K⁺ g,   g = ∂ℓ(W x)/∂x at rest

Index letters: i, j control point; n point that a force acts on.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import lsqr

from mjframes.body.soft_body import SoftBody
from mjframes.finite_elements import conjugate
from mjframes.finite_elements.batch import LoadBatch
from mjframes.finite_elements.element import CORNERS
from mjframes.finite_elements.solver import BodySolver, body_solver
from mjframes.volume.grid import Grid, voxel_grid
from mjframes.whole_body.superelement import degrees, frame_motions, moments
from mjframes.whole_body.weight_correction import assembled

Array = NDArray[np.float64]

TOLERANCE = 1e-3  # [-] of the solution, in the energy norm
SMALLEST = 1e-10  # [-] of moments, to the largest: smaller ones are dependent
STILL = 1e-10  # [-] stiffness, to the largest, of motions that cost nothing
CLOSE = 1e-12  # [-] of c: where to stop
APART = 1e-5  # [-] of the longest pair: the points of a quadratic frame are at one place, up to what is printed


@dataclass(frozen=True, eq=False)
class Elements:
    """The finite elements of a soft body, made when they are needed first."""

    body: SoftBody

    @cached_property
    def grid(self) -> Grid:
        return voxel_grid(self.body.fields.volume)

    @cached_property
    def solver(self) -> BodySolver:
        return body_solver(self.grid, [self.body.fields.seeds[i] for i in range(self.body.held)])

    @cached_property
    def functionals(self) -> tuple[sparse.csr_array, Array]:
        return moments(self.grid, self.body.fields.weights, self.body.control, self.solver)

    @cached_property
    def stiffness(self) -> Array:
        """(3k, 3k) K of all regions at rest."""
        return assembled(self.body.stiffness, len(self.body.control.frame))

    def load(self, voxel: NDArray[np.integer], at: Array, forces: Array) -> Array:
        """Return forces (n, 3) on points `at` (n, 3) of voxels (n,), in volume coordinates, as loads on the nodes."""
        load = np.zeros((len(self.solver.mesh.position), 3))
        place = np.clip((at - self.grid.points(voxel)) @ self.grid.axes / self.grid.spacing + 0.5, 0, 1)
        along = forces @ self.grid.axes
        for a, corner in enumerate(CORNERS):
            share = np.where(corner, place, 1 - place).prod(axis=1)
            node = self.solver.node[voxel, a]
            free = node >= 0
            np.add.at(load, node[free], share[free, None] * along[free])
        return load

    def motion(self, load: Array) -> tuple[Array, Array]:
        """Return how loads (N, 3) move the nodes (N, 3), both along the index axes, and the frames x (k, 3)."""
        body = self.body
        moved = self._solution(load)
        functionals, gram = self.functionals
        moving = np.flatnonzero(body.control.frame >= body.held)
        rest = body.control.rest @ self.grid.axes
        basis = frame_motions(body.control, body.types, rest, body.held, body.held)[degrees(moving)]
        target = (functionals[:, moving].T @ moved).ravel()
        full = np.kron(gram[np.ix_(moving, moving)], np.eye(3)) @ basis
        x = np.zeros((len(rest), 3))
        x[moving] = (basis @ np.linalg.lstsq(full, target, rcond=SMALLEST)[0]).reshape(-1, 3)
        return moved, x @ self.grid.axes.T

    def pull(self, x: Array) -> Array:
        """Return K x (k, 3) of a motion x (k, 3) of the frames."""
        return (self.stiffness @ x.ravel()).reshape(-1, 3)

    def pull_of(self, voxel: NDArray[np.integer], at: Array, forces: Array) -> Array:
        """Return K x (k, 3) of forces (n, 3) on points `at` (n, 3) of voxels (n,), in volume coordinates."""
        return self.pull(self.motion(self.load(voxel, at, forces))[1])

    def _solution(self, load: Array) -> Array:
        """A⁻¹ f (N, 3)."""
        levels = self.solver.levels
        batch = LoadBatch(levels)
        batch.residual.reshape(len(load), 3, -1)[:, :, 0] = load
        if not self.solver.held:
            self.solver.remove_rigid(batch.residual)
        conjugate.solve(levels, batch, TOLERANCE)
        if not self.solver.held:
            self.solver.remove_rigid(batch.solution)
        return batch.solution.reshape(len(load), 3, -1)[:, :, 0].astype(np.float64) / levels.unit


def likeness(elements: Elements, wanted: Array, has: Array) -> float:
    """Return a, the multiple of the slopes `has` (k, 3) that is closest to those that are wanted, in what they move."""
    body = elements.body
    moves = frame_motions(body.control, body.types, body.control.rest, body.held, body.held)
    known, goal = moves.T @ has.ravel(), moves.T @ wanted.ravel()
    moved = np.linalg.lstsq(moves.T @ elements.stiffness @ moves, known, rcond=STILL)[0]
    energy = float(known @ moved)
    return max(float(goal @ moved) / energy, 0.0) if energy > 0 else 1.0


def correction(body: SoftBody, rest: Array, wanted: Array, has: Array) -> tuple[NDArray[np.int64], Array]:
    """Return pairs (t, 2) of control points and their c_ij (t,).

    rest: (k, 3) of the control points [m].  wanted, has: (k, 3) slopes ∂ℓ/∂x of the length, and those of ℓ(W x).
    """
    pairs = np.unique(
        np.concatenate([np.sort(points[np.array(np.triu_indices(len(points), 1)).T], axis=1)
                        for points in body.stiffness.points]), axis=0,
    )  # fmt: skip
    i, j = pairs.T
    way = rest[i] - rest[j]
    length = np.linalg.norm(way, axis=1)
    apart = length > APART * length.max(initial=0)
    pairs, i, j, way = pairs[apart], i[apart], j[apart], way[apart]
    along = way / np.linalg.norm(way, axis=1)[:, None]
    columns = np.tile(np.arange(len(pairs)), 6)
    rows = np.concatenate([3 * some + axis for some in (i, j) for axis in range(3)])
    values = np.concatenate([sign * along[:, axis] for sign in (1, -1) for axis in range(3)])
    matrix = sparse.csr_array((values, (rows, columns)), shape=(rest.size, len(pairs)))
    moves = degrees(np.flatnonzero(body.control.frame >= body.held))
    found = lsqr(matrix[moves], (wanted - has).ravel()[moves], atol=CLOSE, btol=CLOSE)[0]
    return pairs, np.asarray(found, np.float64)


def pair_slopes(pairs: NDArray[np.int64], slope: Array, x: Array) -> Array:
    """Return Σ_j c_ij e_ij (k, 3) of pairs (t, 2) with c_ij (t,) where the control points are at x (k, 3)."""
    i, j = pairs.T
    way = x[i] - x[j]
    force = (slope / np.linalg.norm(way, axis=1))[:, None] * way
    total = np.zeros_like(x)
    np.add.at(total, i, force)
    np.add.at(total, j, -force)
    return total
