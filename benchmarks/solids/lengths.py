"""Lengths ℓ of tendons in bricks: a cavity's volume, a cable's length, a muscle's, with exact slopes and curvatures.

    V = Σ_faces ⅓ ∫ x · (x,ξ × x,η) dξ dη      around the origin; open at planes through the origin alone
    L = Σ_k |p_k+1 − p_k|,  p = Σ_a N_a x_a
    M = ∫ |F f| dV                               f: unit directions at rest

A force F on ℓ adds −F ℓ to the energy: a pressure on V is so one that follows the walls. Nodes are at x = X + u, from
the mesh's first corner.
Indices: a, b, c node of a face; i, j, k direction; q quadrature point.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from benchmarks.solids.bricks import Bricks, assembled, at_points, deformations, lagrange

Array = NDArray[np.float64]
Nodes = NDArray[np.int64]

PERMUTATION = np.zeros((3, 3, 3))
PERMUTATION[[0, 1, 2], [1, 2, 0], [2, 0, 1]], PERMUTATION[[0, 1, 2], [2, 0, 1], [1, 2, 0]] = 1, -1


class Length(Protocol):
    """A function of where the nodes are."""

    def at(self, mesh: Bricks, moved: Array) -> tuple[float, Array, sparse.csr_array]:
        """Return ℓ, ∂ℓ/∂u (N, 3) and ∂²ℓ/∂u² (3N, 3N) where the nodes are `moved` (N, 3) [m]."""
        ...


@dataclass(frozen=True, eq=False)
class Cavity:
    """The volume [m³] within faces.

    faces: (f, (order + 1)²) their nodes; ξ × η points out of the cavity.
    """

    faces: Nodes

    def at(self, mesh: Bricks, moved: Array) -> tuple[float, Array, sparse.csr_array]:
        constant = _face_constants(mesh.order)
        x = (mesh.nodes + moved)[self.faces]
        curvature = 2 * np.einsum("abc,ijk,fck->faibj", constant, PERMUTATION, x, optimize=True)
        slope = np.einsum("faibj,fbj->fai", curvature, x) / 2
        total = np.zeros_like(mesh.nodes)
        np.add.at(total, self.faces, slope)
        return float((slope * x).sum() / 3), total, assembled(mesh, self.faces, curvature)


@dataclass(frozen=True, eq=False)
class Path:
    """The length [m] of a cable through points of the material, or a share of it.

    points: (s, 3) at rest, from the mesh's first corner [m].
    share: what of the length counts: half where the mesh is half of a body that the cable lies in the middle of.
    """

    points: Array
    share: float = 1.0

    def at(self, mesh: Bricks, moved: Array) -> tuple[float, Array, sparse.csr_array]:
        weights = at_points(mesh, self.points)
        apart = sparse.csr_array(weights[1:] - weights[:-1])
        way = apart @ (mesh.nodes + moved)
        length = np.linalg.norm(way, axis=1)
        along = way / length[:, None]
        stiff = (np.eye(3) - along[:, :, None] * along[:, None, :]) * (self.share / length)[:, None, None]
        wide = sparse.csr_array(sparse.kron(apart, sparse.eye_array(3)))
        blocks = sparse.csr_array(sparse.block_diag(list(stiff)))
        return self.share * float(length.sum()), self.share * (apart.T @ along), wide.T @ blocks @ wide


@dataclass(frozen=True, eq=False)
class Field:
    """∫ |F f| dV [m³] over some bricks.

    bricks: (m,) which.
    direction: (m, 3) f.
    """

    bricks: Nodes
    direction: Array

    def at(self, mesh: Bricks, moved: Array) -> tuple[float, Array, sparse.csr_array]:
        gradient, volume = mesh.rule
        element = mesh.element[self.bricks]
        stretched = np.einsum("eqik,ek->eqi", deformations(mesh, moved, self.bricks), self.direction)
        length = np.linalg.norm(stretched, axis=2)
        along = stretched / length[..., None]
        slope = np.einsum("qak,ek->eqa", gradient, self.direction)
        total = np.zeros_like(mesh.nodes)
        np.add.at(total, element, np.einsum("q,eqa,eqi->eai", volume, slope, along, optimize=True))
        stiff = (np.eye(3) - along[..., :, None] * along[..., None, :]) * (volume / length)[..., None, None]
        curvature = np.einsum("eqa,eqb,eqij->eaibj", slope, slope, stiff, optimize=True)
        return float((length @ volume).sum()), total, assembled(mesh, element, curvature)


def walls(mesh: Bricks, inside: NDArray[np.bool_]) -> Cavity:
    """Return the faces of material around empty cells, a mask (nx, ny, nz) of the mesh's lattice of bricks."""
    step = mesh.order
    lattice = np.round(mesh.nodes / mesh.size * step).astype(np.int64)
    shape = tuple(np.array(inside.shape) * step + 1)
    number = np.full(shape, -1)
    number[tuple(lattice.T)] = np.arange(len(lattice))
    cell = lattice[mesh.element[:, 0]] // step
    filled = np.pad(np.zeros(inside.shape, bool), 1)
    filled[tuple(cell.T + 1)] = True
    span = np.arange(step + 1)
    faces = []
    for axis in range(3):
        xi, eta = (axis + 1) % 3, (axis + 2) % 3
        for way in (0, 1):
            beside = np.roll(filled, -1 if way else 1, axis)[1:-1, 1:-1, 1:-1]
            corner = np.argwhere(inside & beside) * step
            at = np.repeat(corner[:, None], (step + 1) ** 2, axis=1)
            at[:, :, axis] += way * step
            first, second = (grid.ravel() for grid in np.meshgrid(span, span, indexing="ij"))
            at[:, :, xi] += first if way else second
            at[:, :, eta] += second if way else first
            faces.append(number[tuple(np.moveaxis(at, -1, 0))])
    return Cavity(np.concatenate(faces))


@cache
def _face_constants(order: int) -> Array:
    """(a, b, c) D with V = ⅓ Σ D_abc x_a · (x_b × x_c) of a face: ∫ N_a N_b,ξ N_c,η, of which swaps change the sign."""
    x, w = np.polynomial.legendre.leggauss(2 * order)
    value, slope = lagrange(order, (x + 1) / 2)
    flat = (len(x) ** 2, (order + 1) ** 2)
    both, by_xi, by_eta = (
        np.einsum("pa,qb->pqab", one, two).reshape(flat)
        for one, two in ((value, value), (slope, value), (value, slope))
    )
    total = np.einsum("q,qa,qb,qc->abc", np.outer(w / 2, w / 2).ravel(), both, by_xi, by_eta, optimize=True)
    even = total + total.transpose(1, 2, 0) + total.transpose(2, 0, 1)
    return (even - even.transpose(0, 2, 1)) / 6
