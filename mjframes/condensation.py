"""Stiffness of a region whose material relaxes within it: K_e = (Φ + Ψ)ᵀ K (Φ + Ψ).

The skinned field Φ x cannot show what a cross section does by itself, Poisson's strains of bending first of all; alone
it makes bars up to three times too stiff. So each region's material may leave it by a displacement v = Ψ x of its own,

    min over v of ½ ∫ ε(Φ x + v) : C ε(Φ x + v) dV   subject to, for each component of v,
    ∫ E v = 0,  ∫ w_i v = 0                no drift; the frames keep their meaning
    ∫ λ ∂v/∂x_a = ∫ μ ∂v/∂x_a = 0          uniform strain is untouched: the patch test
    ∫ ∂v_a/∂x_b = ∫ ∂v_b/∂x_a              no turning: else stiff crumbs turn back, at no cost, for all that is soft
    ∫ E β ∇w_i · ∇v = 0, β ∈ {1, x, y, z}  frames, not v, carry stretch, bending and twist between them
    ∫ μ ∇(Φ z) · ∇v = 0                    for control weights Φ z that none of these sees

It costs nothing at run time, as v is condensed out here. v is a sum of monomials up to degree 4 and, on demand, of
trilinear functions on cells of q³ voxels (`voxel_fem`). All products of Φ run over the same points, so K_e is positive
semi-definite and never stiffer than Φᵀ K Φ.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mjframes.voxel_fem import VALUES, CellGrid, add_moments, at_nodes, cell_stiffness, condense, rigid_motions

Array = NDArray[np.float64]

DEGREE = 4  # of the monomials: 2 frees Poisson's strains, 4 also warps cross sections in torsion
DEPENDENT = 1e-9  # [-] singular value, to the largest, below which a constraint follows from the others
TINY = 1e-13  # [-] added to the scaled diagonal, for monomials that vanish at all points, as z² may in a plate
EQUILIBRATE = 4  # passes that scale rows and columns to one: moduli, lengths and multipliers differ by many powers

_POWERS = np.array(sorted((e for e in product(range(DEGREE + 1), repeat=3) if sum(e) <= DEGREE), key=sum))
_LOWER = int(np.sum(_POWERS.sum(axis=1) < DEGREE))  # so many monomials make up all derivatives
_NOT_TRILINEAR = _POWERS.max(axis=1) > 1  # the others are functions on the cells already


def _derivatives() -> Array:
    """(p, 3, _LOWER) coefficients of the derivatives of the monomials."""
    place = {tuple(e): t for t, e in enumerate(_POWERS[:_LOWER].tolist())}
    table = np.zeros((len(_POWERS), 3, _LOWER))
    for t, e in enumerate(_POWERS):
        for a in np.flatnonzero(e):
            table[t, a, place[tuple((e - np.eye(3, dtype=int)[a]).tolist())]] = e[a]
    return table


_DERIVATIVES = _derivatives()


@dataclass(frozen=True, eq=False)
class Products:
    """Sums over points of one material, by volume. m control weights and p monomials are the functions u; the columns G
    are the components of the m gradients, then the monomials of degree < DEGREE, which make up those of the p.

    material: (3,) E, λ, μ [Pa].  gram: (G, G).  mean: (G,).  sums: (1 + f, u) Σ u and Σ w_i u.
    stretch: (4f, m) Σ β ∇w_i · ∇W_j.  stretch_by: (4f, 3, lower) Σ β ∂w_i/∂x_a · monomial.
    moments: (8, c, G + 1 + f + 12f) of columns, 1, w_i and β ∇w_i with the cells' monomials, or None without cells.
    """

    material: tuple[float, float, float]
    gram: Array
    mean: Array
    sums: Array
    stretch: Array
    stretch_by: Array
    moments: Array | None


def empty_products(material: tuple[float, float, float], f: int, m: int, cells: CellGrid | None) -> Products:
    """Nothing summed yet."""
    g = 3 * m + _LOWER
    return Products(
        material,
        np.zeros((g, g)),
        np.zeros(g),
        np.zeros((1 + f, m + len(_POWERS))),
        np.zeros((4 * f, m)),
        np.zeros((4 * f, 3, _LOWER)),
        None if cells is None else np.zeros((8, len(cells.cell_nodes), g + 1 + 13 * f)),
    )


def add_points(
    total: Products,
    volume: float | Array,
    place: Array,
    weights: Array,
    slopes: Array,
    functions: Array,
    gradients: Array,
    in_cells: tuple[NDArray[np.integer], Array] | None,
) -> None:
    """Add points to `total`, each of `volume` [m³], or of volumes (s,) of their own.

    place: (s, 3) in the region, from −1 to 1.  weights: (s, f) w_i, slopes: (s, f, 3) ∇w_i [1/m].  functions: (s, m)
    W_j, gradients: (s, m, 3) ∇W_j [1/m].  in_cells: the cell (s,) of each point and its place (s, 3) in it, from
    0 to 1, or None without cells.
    """
    f, m = weights.shape[1], functions.shape[1]
    g = 3 * m + _LOWER
    fields, values = _fields(_POWERS, _LOWER, place, weights, slopes, functions, gradients)
    columns, weighted, stretch = np.split(fields, [g, g + 1 + f], axis=1)
    own, factor = (columns, volume) if isinstance(volume, float) else (columns * np.reshape(volume, (-1, 1)), 1.0)
    moved, tested = own[:, : 3 * m].reshape(-1, m, 3), own[:, 3 * m :]
    total.gram[:] += factor * (own.T @ columns)  # of equal volumes the same factor twice: half the work
    total.mean[:] += factor * (weighted[:, 0] @ own)
    total.sums[:] += (weighted * np.reshape(volume, (-1, 1))).T @ values
    for a in range(3):
        by_component = stretch[:, 4 * f * a : 4 * f * (a + 1)].T
        total.stretch[:] += factor * (by_component @ moved[:, :, a])
        total.stretch_by[:, a] += factor * (by_component @ tested)
    if total.moments is not None and in_cells is not None:
        fields *= volume
        add_moments(*in_cells, fields, total.moments)


def elastic_matrix(by_lam: Array, by_mu: Array) -> Array:
    """(3m, 3m) stiffness of m functions from Σ λ g gᵀ and Σ μ g gᵀ, g (3m,) the components of their gradients."""
    m = len(by_mu) // 3
    swapped = by_mu.reshape(m, 3, m, 3)
    matrix = by_lam + swapped.transpose(0, 3, 2, 1).reshape(by_mu.shape)
    trace = np.einsum("jaka->jk", swapped)
    for a in range(3):
        matrix[a::3, a::3] += trace
    return matrix


def relaxed_matrix(parts: list[Products], length: float, cells: CellGrid | None, lam: Array, mu: Array) -> Array:
    """K_e (3m, 3m) of the region whose points are in `parts`.

    length: [m] of one unit of `place`.  cells: around the region's voxels, or None for monomials only.
    lam, mu: (n,) λ and μ of the voxels times their volume [Pa m³].
    """
    f, m = len(parts[0].sums) - 1, parts[0].stretch.shape[1]
    e, by_lam, by_mu = (np.array([part.material[k] for part in parts]) for k in range(3))
    use = np.ones(len(_POWERS), bool) if cells is None else _NOT_TRILINEAR
    slopes = _DERIVATIVES[use] / length
    g = len(parts[0].mean)
    # gradients of all functions in terms of the columns: (u, 3, G)
    columns = np.zeros((m + len(slopes), 3, g))
    columns[:m, :, : 3 * m] = np.eye(3 * m).reshape(m, 3, 3 * m)
    columns[m:, :, 3 * m :] = slopes
    spread = columns.reshape(-1, g)

    def total(factor: Array, name: str) -> Array:
        return np.sum([k * getattr(part, name) for k, part in zip(factor, parts, strict=True)], axis=0)

    gram_mu = spread @ total(by_mu, "gram") @ spread.T
    energy = elastic_matrix(spread @ total(by_lam, "gram") @ spread.T, gram_mu)
    chosen = np.r_[np.ones(m, bool), use]
    stretch_by = np.einsum("rat,uat->ru", total(e, "stretch_by"), slopes)
    rows = np.vstack(
        [
            total(e, "sums")[:1, chosen],
            total(np.ones(len(parts)), "sums")[1:, chosen],
            *((spread @ total(k, "mean")).reshape(-1, 3).T for k in (by_lam, by_mu)),
            np.hstack([total(e, "stretch"), stretch_by]),
        ]
    )
    # Seen by the shape alone: moduli that differ would see a bit of everything, and then hold next to nothing.
    one = np.ones(len(parts))
    seen = np.vstack([total(one, "sums")[:, :m], total(one, "mean")[: 3 * m].reshape(m, 3).T, total(one, "stretch")])
    unseen = _null_space(seen)
    h1 = np.einsum("jaka->jk", gram_mu.reshape(len(columns), 3, -1, 3))[:m]
    u = len(energy)
    held, free = slice(0, 3 * m), slice(3 * m, None)
    if cells is None:
        constraints = _by_component(_constraints(rows[:, m:], h1[:, m:], unseen))
        energy[free, held] -= constraints.T @ (constraints @ energy[free, held])
        return _minimum(energy, np.hstack([np.zeros((len(constraints), 3 * m)), constraints]), 3 * m)

    nodal_rows, nodal_mean, nodal_h1, coupling = _nodal(cells, parts, columns, f, m)
    constraints = _constraints(np.hstack([rows[:, m:], nodal_rows]), np.hstack([h1[:, m:], nodal_h1]), unseen)
    mean = (spread @ total(one, "mean")).reshape(-1, 3).T[:, m:]
    constraints = _without_turning(_by_component(constraints), np.hstack([mean, nodal_mean]))
    monomial, nodal = np.split(constraints, [3 * len(slopes)], axis=1)
    # What the constraints take up need not be solved for: uniform strain then loads v by zeros.
    taken = monomial @ energy[free, held] + nodal @ coupling[:, held]
    energy[free, held] -= monomial.T @ taken
    coupling[:, held] -= nodal.T @ taken
    # The nodes' displacement is K⁺ times the forces on them, plus a rigid motion.
    inner = condense(cells, cell_stiffness(cells, lam, mu), np.hstack([coupling, nodal.T]))
    motions = rigid_motions(cells.nodes)
    wide = np.zeros((u + 6, u + 6))
    wide[:u, :u] = energy - inner[:u, :u]
    wide[u:, held] = motions.T @ coupling[:, held]
    left = np.hstack([-inner[u:, :u], nodal @ motions])
    left[:, 3 * m : u] += monomial
    return _minimum(wide, left, 3 * m, inner[u:, u:])


def plain_matrix(parts: list[Products]) -> Array:
    """Φᵀ K Φ (3m, 3m) of the points in `parts`."""
    size = 3 * parts[0].stretch.shape[1]
    by_lam, by_mu = (np.sum([part.material[k] * part.gram[:size, :size] for part in parts], axis=0) for k in (1, 2))
    return elastic_matrix(by_lam, by_mu)


def _nodal(cells: CellGrid, parts: list[Products], columns: Array, f: int, m: int) -> tuple[Array, Array, Array, Array]:
    """For nodal functions v: the rows (7 + 5f, N), ∫ ∂v/∂x_a (3, N), μ ∇W_j · ∇v (m, N), and K between v and all
    others (3N, 3u).
    """
    u, _, g = columns.shape
    e, lam, mu = (np.array([part.material[k] for part in parts]) for k in range(3))
    of_columns, of_one = slice(0, g), slice(g, g + 1)
    of_weights, of_stretch = slice(g + 1, g + 1 + f), slice(g + 1 + f, None)
    moments = [part.moments for part in parts if part.moments is not None]

    def moment(factor: Array, which: slice) -> Array:
        return np.sum([k * part[:, :, which] for k, part in zip(factor, moments, strict=True)], axis=0)

    def along(moments: Array) -> Array:
        """(3, N, …) with the derivatives of the nodal functions."""
        return np.stack([at_nodes(cells, moments, cells.slopes[:, d]) for d in range(3)])

    by_lam, by_mu = (
        (along(moment(k, of_columns)) @ columns.reshape(-1, g).T).reshape(3, -1, u, 3) for k in (lam, mu)
    )  # (d, N, u, e)
    trace = np.einsum("dnud->nu", by_mu)
    coupling = by_lam.transpose(1, 0, 2, 3) + by_mu.transpose(1, 3, 2, 0)
    for a in range(3):
        coupling[:, a, :, a] += trace
    one = np.ones(len(parts))
    uniform = along(np.concatenate([moment(k, of_one) for k in (lam, mu, one)], axis=2)).transpose(2, 0, 1)
    stretch = np.einsum("dndr->rn", along(moment(e, of_stretch)).reshape(3, -1, 3, 4 * f))
    values = np.concatenate([moment(e, of_one), moment(one, of_weights)], axis=2)
    rows = np.vstack([at_nodes(cells, values, VALUES).T, uniform[:2].reshape(6, -1), stretch])
    return rows, uniform[2], trace[:, :m].T, coupling.reshape(-1, 3 * u)


def _null_space(rows: Array) -> Array:
    """(z, m) orthonormal vectors that none of the rows (r, m) sees."""
    _, value, right = np.linalg.svd(_unit_rows(rows))
    return right[np.count_nonzero(value > DEPENDENT * value[0]) :]


def _constraints(rows: Array, h1: Array, unseen: Array) -> Array:
    """Orthonormal rows that span `rows` and unseen · h1, without those that depend on others or are but rounding.

    h1: (m, v) the products of all control weights.  unseen: (z, m); without strain, as null modes are, they hold none.
    """
    held = unseen @ h1
    held = held[np.linalg.norm(held, axis=1) > DEPENDENT * np.linalg.norm(h1)]
    _, value, right = np.linalg.svd(_unit_rows(np.vstack([rows, held])), full_matrices=False)
    return right[value > DEPENDENT * value[0]]


def _without_turning(constraints: Array, mean: Array) -> Array:
    """Orthonormal constraints (c, 3v) and, as far as they do not follow from them, those against a mean rotation of v.

    mean: (3, v) ∫ ∂v/∂x_a.
    """
    turn = np.cross(np.eye(3)[:, None, :], mean.T[None]).reshape(3, -1)
    turn /= np.linalg.norm(turn)
    for _ in range(2):  # the second time takes off what rounding left
        turn -= (turn @ constraints.T) @ constraints
    _, value, right = np.linalg.svd(turn, full_matrices=False)
    return np.vstack([constraints, right[value > DEPENDENT]])


def _by_component(rows: Array) -> Array:
    """(3r, 3v) the same rows (r, v) for each of the three components."""
    return np.asarray(np.kron(rows, np.eye(3)), np.float64)


def _unit_rows(rows: Array) -> Array:
    size = np.linalg.norm(rows, axis=1)
    return rows[size > 0] / size[size > 0, None]


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


@njit(cache=True, nogil=True)
def _fields(powers, lower, place, weights, slopes, functions, gradients):
    """Columns, 1, w_i and β ∂w_i/∂x_a (s, G + 1 + f + 12f), a slowest and β fastest; all functions (s, m + p)."""
    f, m = weights.shape[1], functions.shape[1]
    end = 3 * m + lower
    fields = np.empty((len(place), end + 1 + 13 * f))
    values = np.empty((len(place), m + len(powers)))
    power = np.empty((3, powers.max() + 1))
    for s in range(len(place)):
        for a in range(3):
            power[a, 0] = 1.0
            for n in range(1, power.shape[1]):
                power[a, n] = power[a, n - 1] * place[s, a]
        for j in range(m):
            values[s, j] = functions[s, j]
            for a in range(3):
                fields[s, 3 * j + a] = gradients[s, j, a]
        for t in range(len(powers)):
            values[s, m + t] = power[0, powers[t, 0]] * power[1, powers[t, 1]] * power[2, powers[t, 2]]
        fields[s, 3 * m : end] = values[s, m : m + lower]
        fields[s, end] = 1.0
        for i in range(f):
            fields[s, end + 1 + i] = weights[s, i]
            for a in range(3):
                for b in range(4):
                    fields[s, end + 1 + f + 4 * (a * f + i) + b] = slopes[s, i, a] * values[s, m + b]
    return fields, values
