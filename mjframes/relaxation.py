"""Stiffness of a region whose material relaxes within it: K_e = (Φ + Ψ)ᵀ K (Φ + Ψ).

The skinned field Φ x cannot show what a cross section does by itself, Poisson's strains of bending first of all; alone
it makes bars up to three times too stiff. So each region's material may leave it by a displacement v = Ψ x of its own,

    min over v of ½ ∫ ε(Φ x + v) : C ε(Φ x + v) dV   subject to, for each component of v,
    ∫ E v = 0,  ∫ w_i v = 0              no drift; the frames keep their meaning
    ∫ λ ∂v/∂x_a = ∫ μ ∂v/∂x_a = 0        uniform strain is untouched: the patch test
    ∫ E β ∇w_i · ∇v = 0, β ∈ {1, x, y, z}  frames, not v, carry stretch, bending and twist between them
    ∫ μ ∇(Φ z) · ∇v = 0                  for control weights Φ z that none of these sees

It costs nothing at run time, as v is condensed out here. v is the sum of monomials up to degree 4 and, where weights or
material vary, of trilinear functions on cells of q³ voxels (`voxel_fem`). All sums run over the same quadrature points,
so K_e is positive semi-definite and never stiffer than Φᵀ K Φ.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from mjframes.voxel_fem import VALUES, CellGrid, add_moments, at_nodes, cell_stiffness, condense, rigid_motions

Array = NDArray[np.float64]

DEGREE = 4  # of the monomials: 2 frees Poisson's strains, 4 also warps cross sections in torsion
DEPENDENT = 1e-9  # [-] singular value, to the largest, below which a constraint follows from the others
TINY = 1e-13  # [-] added to the scaled diagonal, for monomials that vanish at all points, as z² may in a plate
EQUILIBRATE = 4  # passes that scale rows and columns to one: moduli, lengths and multipliers differ by many powers

_POWERS = np.array(sorted((e for e in product(range(DEGREE + 1), repeat=3) if sum(e) <= DEGREE), key=lambda e: sum(e)))
_LOWER = int(np.sum(_POWERS.sum(axis=1) < DEGREE))  # so many monomials make up all derivatives
_NOT_TRILINEAR = _POWERS.max(axis=1) > 1  # the others are functions on the cells already


def _derivatives() -> Array:
    """(p, 3, _LOWER) coefficients of the derivatives of the monomials."""
    place = {tuple(e): t for t, e in enumerate(_POWERS[:_LOWER].tolist())}
    table = np.zeros((len(_POWERS), 3, _LOWER))
    for t, e in enumerate(_POWERS):
        for a in range(3):
            if e[a]:
                table[t, a, place[tuple((e - np.eye(3, dtype=int)[a]).tolist())]] = e[a]
    return table


_DERIVATIVES = _derivatives()


@dataclass(frozen=True, eq=False)
class Points:
    """Some quadrature points (s,) of a region with f frames and m control points.

    rows: their voxels among the region's.  offset: (3,) from the centres, in voxels.  place: (s, 3) in the region,
    from −1 to 1.  weights: (s, f) w_i.  slopes: (s, f, 3) ∇w_i [1/m].  functions: (s, m) W_j.  gradients: (s, m, 3)
    ∇W_j [1/m].  young, lam, mu: (s,) E, λ, μ times the volume of each [Pa m³].
    """

    rows: slice
    offset: Array
    place: Array
    weights: Array
    slopes: Array
    functions: Array
    gradients: Array
    young: Array
    lam: Array
    mu: Array


@dataclass(frozen=True, eq=False)
class _Sums:
    """Products over a region. Columns G: the m gradients' components, then the monomials of degree < DEGREE.

    by_young: (3m,).  by_lam, by_mu: (G, G) and means (2, G).  values: (1 + f, m + p) Σ E u and Σ w_i u, u = W_j or
    monomial.  stretch: (4f, m) Σ E β ∇w_i · ∇W_j and stretch_by: (4f, 3, lower) Σ E β ∂w_i/∂x_a · monomial.
    moments: (c, 8, …) of all that nodal functions are multiplied with, or None.
    """

    by_young: Array
    by_lam: Array
    by_mu: Array
    means: Array
    values: Array
    stretch: Array
    stretch_by: Array
    moments: Array | None


def elastic_matrix(by_lam: Array, by_mu: Array) -> Array:
    """(3m, 3m) stiffness of m functions from Σ V λ g gᵀ and Σ V μ g gᵀ over components (3m,) of their gradients."""
    swapped = by_mu.reshape(len(by_mu) // 3, 3, -1, 3)
    matrix = by_lam + swapped.transpose(0, 3, 2, 1).reshape(by_mu.shape)
    trace = np.einsum("jaka->jk", swapped)
    for a in range(3):
        matrix[a::3, a::3] += trace
    return matrix


def plain_stiffness(blocks: Iterable[Points]) -> tuple[Array, Array]:
    """Σ E ∇W_j dV (m, 3) and Φᵀ K Φ (3m, 3m) of the region whose points are in `blocks`: without relaxation."""
    mean, by_lam, by_mu = np.zeros(1), np.zeros((1, 1)), np.zeros((1, 1))
    for points in blocks:
        gradient = points.gradients.reshape(len(points.place), -1)
        mean = mean + points.young @ gradient
        by_lam, by_mu = by_lam + _gram(gradient, points.lam), by_mu + _gram(gradient, points.mu)
    return mean.reshape(-1, 3), elastic_matrix(by_lam, by_mu)


def relaxed_stiffness(
    blocks: Iterable[Points], length: float, cells: CellGrid | None, lam: Array, mu: Array
) -> tuple[Array, Array]:
    """Σ E ∇W_j dV (m, 3) and K_e (3m, 3m) of the region whose points are in `blocks`.

    length: [m] of one unit of `place`.  cells: around the region's voxels, or None for monomials only.
    lam, mu: (n,) λ and μ of the voxels times their volume [Pa m³].
    """
    use = np.ones(len(_POWERS), bool) if cells is None else _NOT_TRILINEAR
    sums = _sum(blocks, cells)
    f, m = sums.values.shape[0] - 1, sums.stretch.shape[1]
    slopes = _DERIVATIVES[use] / length
    # gradients of all functions, control weights then monomials, in the columns G: (u, 3, G)
    columns = np.zeros((m + len(slopes), 3, len(sums.by_lam)))
    columns[:m, :, : 3 * m] = np.eye(3 * m).reshape(m, 3, 3 * m)
    columns[m:, :, 3 * m :] = slopes
    spread = columns.reshape(-1, len(sums.by_lam))
    by_mu = spread @ sums.by_mu @ spread.T
    energy = elastic_matrix(spread @ sums.by_lam @ spread.T, by_mu)

    stretch = np.hstack([sums.stretch, np.einsum("rat,uat->ru", sums.stretch_by, slopes)])
    uniform = np.einsum("rg,uag->rau", sums.means, columns).reshape(6, -1)
    rows = np.vstack([sums.values[:, np.r_[np.ones(m, bool), use]], uniform, stretch])
    h1 = np.einsum("jaka->jk", by_mu.reshape(len(columns), 3, -1, 3))[:m]
    if cells is None:
        constraints = _constraints(rows, h1, m)
        return sums.by_young.reshape(m, 3), _minimum(energy, np.kron(constraints, np.eye(3)), 3 * m)

    nodal_rows, nodal_h1, coupling = _nodal(cells, sums, columns, f)
    constraints = _constraints(np.hstack([rows, nodal_rows]), np.hstack([h1, nodal_h1]), m)
    monomial, nodal = np.split(constraints, [len(slopes)], axis=1)
    # The nodes' displacement is that of K⁺ and a rigid motion; multipliers of the constraints take up the rest.
    multiplied = np.kron(nodal, np.eye(3))
    inner = condense(cells, cell_stiffness(cells, lam, mu), np.hstack([coupling, multiplied.T]))
    u = len(energy)
    motions = multiplied @ rigid_motions(cells.nodes)
    left = np.hstack([-inner[u:, :u], motions])
    left[:, 3 * m : u] += np.kron(monomial, np.eye(3))
    wide = np.zeros((u + 6, u + 6))
    wide[:u, :u] = energy - inner[:u, :u]
    return sums.by_young.reshape(m, 3), _minimum(wide, left, 3 * m, inner[u:, u:])


def _sum(blocks: Iterable[Points], cells: CellGrid | None) -> _Sums:
    total: list[Array] = []
    moments = None
    for points in blocks:
        s, f = points.weights.shape
        m = points.functions.shape[1]
        monomials = np.prod(points.place[:, None, :] ** _POWERS, axis=2)
        lower = monomials[:, :_LOWER]
        columns = np.hstack([points.gradients.reshape(s, 3 * m), lower])
        moduli = np.stack([points.lam, points.mu])
        linear = points.young[:, None] * monomials[:, :4]
        stretch = np.einsum("sia,sb->siba", points.slopes, linear).reshape(s, 4 * f, 3)
        weighted = np.hstack([points.young[:, None], points.weights])
        parts = [
            points.young @ columns[:, : 3 * m],
            _gram(columns, points.lam),
            _gram(columns, points.mu),
            moduli @ columns,
            weighted.T @ np.hstack([points.functions, monomials]),
            stretch.transpose(1, 0, 2).reshape(4 * f, -1) @ points.gradients.transpose(0, 2, 1).reshape(-1, m),
            (stretch.reshape(s, -1).T @ lower).reshape(4 * f, 3, _LOWER),
        ]
        total = [a + b for a, b in zip(total, parts, strict=True)] if total else parts
        if cells is not None:
            fields = np.hstack([moduli[0][:, None] * columns, moduli[1][:, None] * columns, weighted, moduli.T, stretch.reshape(s, -1)])
            if moments is None:
                moments = np.zeros((len(cells.cell_nodes), 8, fields.shape[1]))
            add_moments(cells, points.rows, points.offset, fields, moments)
    return _Sums(*total, moments)


def _gram(columns: Array, modulus: Array) -> Array:
    scaled = columns * np.sqrt(modulus)[:, None]
    return scaled.T @ scaled  # one factor twice: half the work, and symmetric to the bit


def _nodal(cells: CellGrid, sums: _Sums, columns: Array, f: int) -> tuple[Array, Array, Array]:
    """For nodal functions: the constraint rows (1 + f + 6 + 4f, N), μ ∇W_j · ∇v (m, N), K between v and all (3N, 3u)."""
    assert sums.moments is not None
    u, _, g = columns.shape
    ends = np.cumsum([2 * g, 1 + f, 2])
    products, values, means, stretch = np.split(sums.moments, ends, axis=2)
    by_slope = [
        [at_nodes(cells, part, cells.slopes[:, d]) for d in range(3)]
        for part in (products[..., :g], products[..., g:], means, stretch)
    ]
    by_lam, by_mu = (np.stack([part @ columns.reshape(-1, g).T for part in parts]) for parts in by_slope[:2])
    by_lam, by_mu = (part.reshape(3, -1, u, 3) for part in (by_lam, by_mu))  # (d, N, u, e)
    trace = np.einsum("fnuf->nu", by_mu)
    coupling = by_lam.transpose(1, 0, 2, 3) + by_mu.transpose(1, 3, 2, 0)
    for a in range(3):
        coupling[:, a, :, a] += trace
    uniform = np.stack(by_slope[2]).transpose(2, 0, 1).reshape(6, -1)
    along = sum(by_slope[3][a].reshape(-1, 4 * f, 3)[..., a] for a in range(3)).T
    rows = np.vstack([at_nodes(cells, values, VALUES).T, uniform, along])
    m = sums.stretch.shape[1]
    return rows, trace[:, :m].T, coupling.reshape(-1, 3 * u)


def _constraints(rows: Array, h1: Array, m: int) -> Array:
    """Orthonormal rows on v, from `rows` on the m control weights and v, and from `h1` for weights no row sees."""
    size = np.linalg.norm(rows, axis=1)
    rows = rows[size > 0] / size[size > 0, None]
    _, value, right = np.linalg.svd(rows[:, :m])
    unseen = right[np.count_nonzero(value > DEPENDENT * value[0]) :]
    rows = np.vstack([rows, unseen @ h1])[:, m:]
    size = np.linalg.norm(rows, axis=1)
    rows = rows[size > DEPENDENT * size.max()]
    rows /= np.linalg.norm(rows, axis=1, keepdims=True)
    _, value, right = np.linalg.svd(rows, full_matrices=False)
    return right[value > DEPENDENT * value[0]]


def _minimum(energy: Array, constraints: Array, held: int, give: Array | None = None) -> Array:
    """Matrix of the minimum of ½ zᵀ H z over all of z but the first `held`, where constraints C z = G μ, μ multipliers.

    energy: H (z, z).  constraints: C (c, z).  give: G (c, c), 0 unless given.
    """
    free = slice(held, None)
    c = len(constraints)
    saddle = np.block([[energy[free, free], constraints[:, free].T], [constraints[:, free], np.zeros((c, c))]])
    if give is not None:
        saddle[-c:, -c:] = -give
    load = np.vstack([energy[free, :held], constraints[:, :held]])
    scale = np.ones(len(saddle))
    for _ in range(EQUILIBRATE):
        scale /= np.sqrt(np.maximum(np.abs(saddle * scale * scale[:, None]).max(axis=1), TINY))
    saddle *= scale * scale[:, None]
    sign = np.r_[np.ones(len(saddle) - c), -np.ones(c)]
    load *= scale[:, None]
    matrix = energy[:held, :held] - load.T @ np.linalg.solve(saddle + np.diag(TINY * sign), load)
    return (matrix + matrix.T) / 2
