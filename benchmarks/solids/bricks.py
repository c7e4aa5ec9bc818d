"""Bricks of order p on the voxels, each split r × r × r: the finite elements that the report measures against.

Linear: ∫ σ(u) : ε(v) dV = Σ_v f_v · mean of v over voxel v.  Geometrically nonlinear (St. Venant–Kirchhoff, total
Lagrangian): ∫ P(F) : ∇v dV with P = F S, S = λ tr(G) I + 2 μ G, G = (FᵀF − I)/2.
The nodes form a lattice, p + 1 of them along each edge of a brick; the nodes of fixed voxels do not move. The index
axes are those of the coordinates.

Indices: e brick, q quadrature point, a, b node of a brick, i, j direction of force, k, l derivative.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mjframes.volume.grid import Grid

Array = NDArray[np.float64]
Nodes = NDArray[np.int64]

BLOCK = 512  # [bricks] whose tangents are computed at a time


@dataclass(frozen=True, eq=False)
class Bricks:
    """c bricks of order `order`, (order + 1)³ nodes each, `split`³ a voxel.

    voxel: (c,) the voxel of each.
    element: (c, a) its nodes.
    nodes: (N, 3) [m] from the first corner.
    free: (N,) whether a node may move.
    size: (3,) of a brick [m].
    lam, mu: (c,) [Pa].
    mirrored: whether it is half of a body, the other half its mirror image in the plane y = 0.
    """

    order: int
    split: int
    voxel: Nodes
    element: Nodes
    nodes: Array
    free: NDArray[np.bool_]
    size: Array
    lam: Array
    mu: Array
    mirrored: bool = False

    @cached_property
    def rule(self) -> tuple[Array, Array]:
        """Return ∇N_a (q, a, 3) [1/m] and dV (q,) [m³] at Gauss's points: exact for affine bricks of this order."""
        x, w = np.polynomial.legendre.leggauss(self.order + 1)
        x, w = (x + 1) / 2, w / 2
        value, slope = lagrange(self.order, x)
        points = len(x)
        gradient = np.empty((points**3, (self.order + 1) ** 3, 3))
        for d in range(3):
            parts = [slope if d == axis else value for axis in range(3)]
            gradient[:, :, d] = _tensor(*parts) / self.size[d]
        return gradient, _tensor(*(w[None],) * 3).ravel() * np.prod(self.size)

    @property
    def moving(self) -> NDArray[np.bool_]:
        """Return which degrees of freedom (3N,) may move."""
        moving = np.repeat(self.free, 3)
        if self.mirrored:
            moving[1::3] &= self.nodes[:, 1] > 0
        return moving


def bricks(grid: Grid, fixed: NDArray[np.bool_], order: int, split: int, mirrored: bool = False) -> Bricks:
    """Return the bricks of a grid; fixed: (n,) the voxels that do not move."""
    index = grid.index.astype(np.int64) - grid.index.min(axis=0)
    part = np.stack(np.meshgrid(*(np.arange(split),) * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    cell = (index[:, None] * split + part).reshape(-1, 3)
    voxel = np.repeat(np.arange(len(index)), split**3)
    corner = np.stack(np.meshgrid(*(np.arange(order + 1),) * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    lattice = cell[:, None] * order + corner
    extent = tuple(lattice.reshape(-1, 3).max(axis=0) + 1)
    number, element = np.unique(np.ravel_multi_index(tuple(np.moveaxis(lattice, -1, 0)), extent), return_inverse=True)
    element = element.reshape(len(cell), -1)
    free = np.ones(len(number), bool)
    free[element[fixed[voxel]]] = False
    size = grid.spacing / split
    return Bricks(
        order=order,
        split=split,
        voxel=voxel,
        element=element,
        nodes=np.stack(np.unravel_index(number, extent), axis=1) * size / order,
        free=free,
        size=size,
        lam=grid.lam[voxel],
        mu=grid.mu[voxel],
        mirrored=mirrored,
    )


def linear_stiffness(mesh: Bricks) -> sparse.csr_array:
    """Return (3N, 3N) with natural boundaries; degree of freedom 3a + xyz."""
    gradient, volume = mesh.rule
    a = gradient.shape[1]
    pairs = np.einsum("q,qak,qbl->akbl", volume, gradient, gradient)  # ∫ ∂N_a/∂x_k ∂N_b/∂x_l
    by_lam = pairs.reshape(3 * a, 3 * a)
    by_mu = (pairs.transpose(0, 3, 2, 1) + np.einsum("akbk,ij->aibj", pairs, np.eye(3))).reshape(3 * a, 3 * a)
    blocks = mesh.lam[:, None] * by_lam.ravel() + mesh.mu[:, None] * by_mu.ravel()
    return assembled(mesh, mesh.element, blocks)


def nodal_load(mesh: Bricks, load: Array) -> Array:
    """Return (N, 3) [N] of forces `load` (n, 3) [N] spread evenly over the voxels."""
    share = _mean_of_shapes(mesh.order)
    force = load[mesh.voxel][:, None] * share[:, None] / mesh.split**3
    total = np.zeros_like(mesh.nodes)
    np.add.at(total, mesh.element, force)
    return total


def nodal_mass(mesh: Bricks, mass: Array) -> Array:
    """Return (N,) [kg] of voxels' masses (n,): lumped, the row sums of the consistent matrix."""
    share = _mean_of_shapes(mesh.order)
    total = np.zeros(len(mesh.nodes))
    np.add.at(total, mesh.element, mass[mesh.voxel][:, None] * share / mesh.split**3)
    return total


def at_centers(mesh: Bricks, moved: Array) -> Array:
    """Return (n, 3) nodal values `moved` (N, 3) at the centres of the voxels."""
    half = mesh.split // 2
    value, _ = lagrange(mesh.order, np.array([mesh.split / 2 - half]))
    chosen = mesh.element[half * (mesh.split**2 + mesh.split + 1) :: mesh.split**3]
    return np.einsum("a,vai->vi", _tensor(value, value, value)[0], moved[chosen])


def at_points(mesh: Bricks, points: Array) -> sparse.csr_array:
    """Return the shape functions (n, N) at points (n, 3) of the material, from the mesh's first corner [m]."""
    cells = np.round(mesh.nodes[mesh.element[:, 0]] / mesh.size).astype(np.int64)
    extent = tuple(cells.max(axis=0) + 1)
    brick = np.full(extent, -1)
    brick[tuple(cells.T)] = np.arange(len(cells))
    place = points / mesh.size
    cell = np.clip(np.floor(place).astype(np.int64), 0, np.array(extent) - 1)
    value = np.ones((len(points), 1))
    for axis in range(3):
        one = lagrange(mesh.order, place[:, axis] - cell[:, axis])[0]
        value = (value[:, :, None] * one[:, None, :]).reshape(len(points), -1)
    chosen = mesh.element[brick[tuple(cell.T)]]
    rows = np.repeat(np.arange(len(points)), chosen.shape[1])
    return sparse.csr_array((value.ravel(), (rows, chosen.ravel())), shape=(len(points), len(mesh.nodes)))


def deformations(mesh: Bricks, moved: Array, some: slice | Nodes) -> Array:
    """Return F (e, q, 3, 3) of some bricks where the nodes are `moved` (N, 3) [m]."""
    return np.eye(3) + np.einsum("eai,qak->eqik", moved[mesh.element[some]], mesh.rule[0], optimize=True)


def internal_force(mesh: Bricks, moved: Array, tangent: bool = True) -> tuple[Array, sparse.csr_array | None]:
    """Return f (N, 3) and its derivative (3N, 3N) where the nodes are `moved` (N, 3), St. Venant–Kirchhoff."""
    gradient, volume = mesh.rule
    a = gradient.shape[1]
    total = np.zeros_like(mesh.nodes)
    blocks = np.empty((len(mesh.element), 9 * a * a)) if tangent else None
    eye = np.eye(3)
    for start in range(0, len(mesh.element), BLOCK):
        some = slice(start, start + BLOCK)
        lam, mu = mesh.lam[some, None], mesh.mu[some, None]
        F = deformations(mesh, moved, some)
        G = (np.einsum("eqik,eqil->eqkl", F, F) - eye) / 2
        trace = np.trace(G, axis1=2, axis2=3)
        S = (lam * trace)[..., None, None] * eye + 2 * mu[..., None, None] * G
        P = F @ S
        np.add.at(total, mesh.element[some], np.einsum("q,eqik,qak->eai", volume, P, gradient, optimize=True))
        if blocks is None:
            continue
        h = np.einsum("eqik,qak->eqai", F, gradient, optimize=True)  # F ∇N_a
        root = np.sqrt(volume)[None, :, None, None]
        hq = (h * root).reshape(len(F), len(volume), -1)
        result = lam[..., None] * (hq.transpose(0, 2, 1) @ hq)  # λ (F∇N_a) ⊗ (F∇N_b)
        result = result.reshape(-1, a, 3, a, 3)
        B = np.einsum("eqik,eqjk->eqij", F, F)
        near = np.einsum("q,qak,qbk->qab", volume, gradient, gradient)
        result += mu[:, :, None, None, None] * np.einsum("qab,eqij->eaibj", near, B, optimize=True)
        for i in range(3):
            for j in range(3):  # μ (F∇N_b)_i (F∇N_a)_j
                one = (h[..., j] * root[..., 0]).transpose(0, 2, 1)
                result[:, :, i, :, j] += mu[:, :, None] * (one @ (h[..., i] * root[..., 0]))
        pull = np.einsum("q,eqkl,qak,qbl->eab", volume, S, gradient, gradient, optimize=True)
        result += pull[:, :, None, :, None] * eye[:, None, :]
        blocks[some] = result.reshape(len(F), -1)
    return total, None if blocks is None else assembled(mesh, mesh.element, blocks)


def assembled(mesh: Bricks, element: Nodes, blocks: Array) -> sparse.csr_array:
    """Return the sum (3N, 3N) of blocks (c, …), 9a² numbers each, of elements with nodes (c, a) of the mesh."""
    dof = (3 * element[:, :, None] + np.arange(3)).reshape(len(element), -1).astype(np.int32)
    m = dof.shape[1]
    at = (np.repeat(dof, m, axis=1).ravel(), np.tile(dof, (1, m)).ravel())
    size = 3 * len(mesh.nodes)
    return sparse.csr_array(sparse.coo_array((blocks.ravel(), at), shape=(size, size)))


def lagrange(order: int, x: Array) -> tuple[Array, Array]:
    """Return Lagrange's polynomials (q, a) on evenly spaced nodes of [0, 1], and their derivatives, at x (q,)."""
    nodes = np.linspace(0, 1, order + 1)
    value, slope = np.empty((2, len(x), order + 1))
    for a, node in enumerate(nodes):
        polynomial = np.poly1d(np.delete(nodes, a), r=True)
        polynomial = polynomial / polynomial(node)
        value[:, a], slope[:, a] = polynomial(x), polynomial.deriv()(x)
    return value, slope


def _tensor(x: Array, y: Array, z: Array) -> Array:
    """(qqq, aaa) products of one-dimensional values (q, a)."""
    return np.einsum("pa,qb,rc->pqrabc", x, y, z).reshape(len(x) * len(y) * len(z), -1)


def _mean_of_shapes(order: int) -> Array:
    """(a,) mean of each shape function over its brick."""
    x, w = np.polynomial.legendre.leggauss(order + 1)
    value, _ = lagrange(order, (x + 1) / 2)
    mean = (w / 2) @ value
    return _tensor(*(mean[None],) * 3)[0]
