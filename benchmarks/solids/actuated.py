"""Bricks that tendons pull at, geometrically non-linear: the least of E(u) = ∫ ψ(F) dV − Σ_t F_t ℓ_t(u).

    corotational   ψ = μ |F − R|² + λ/2 (tr RᵀF − 3)²,   R the rotation of F       at every point of the material
    neo-hookean    ψ = μ/2 (|F|² − 3 − 2 ln J) + λ/2 (ln J)²

The first is what `law="corotational"` of a body stands for, which has it region by region; at small strain both are
linear elasticity. Newton's method with the exact tangent, the forces in increments. Indices as in `bricks`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from benchmarks.solids.bricks import Bricks, assembled, deformations
from benchmarks.solids.lengths import PERMUTATION, Length
from benchmarks.solids.reference import preconditioner, solve
from mjframes.base.errors import MjframesError

Array = NDArray[np.float64]
Law = Callable[[Array, Array, Array], tuple[Array, Array]]  # F (…, 3, 3), λ, μ → P (…, 3, 3), ∂P/∂F (…, 3, 3, 3, 3)

TOLERANCE = 1e-4  # [-] of the residual, to the forces on the nodes
CLOSE = 1e-3  # [-] of the residual of linear systems
ITERATIONS = 20  # of Newton's method
BLOCK = 64  # [bricks] at a time: what is known of them stays in the processor's caches
INCREMENT = 0.5  # of the forces, at most
EYE = np.eye(3)


def corotational(F: Array, lam: Array, mu: Array) -> tuple[Array, Array]:
    """Return P and ∂P/∂F; R turns by ω = (tr S 1 − S)⁻¹ axial(Rᵀ dF), S = RᵀF."""
    left, _, right = np.linalg.svd(F)
    left[..., 2] *= np.sign(np.linalg.det(left) * np.linalg.det(right))[..., None]
    R = left @ right
    S = R.swapaxes(-1, -2) @ F
    trace = np.trace(S, axis1=-2, axis2=-1)
    lam, mu = lam[..., None, None], mu[..., None, None]
    P = 2 * mu * (F - R) + lam * (trace - 3)[..., None, None] * R
    inverse = np.linalg.inv(trace[..., None, None] * EYE - S)
    turns = (-R @ PERMUTATION.transpose(1, 0, 2).reshape(3, 9)).reshape(*F.shape[:-2], 3, 3, 3)  # R [e_c]×, [i, c, k]
    turns = turns.swapaxes(-3, -2).reshape(*F.shape[:-2], 3, 9)
    turned = (turns.swapaxes(-1, -2) @ inverse @ turns).reshape(*F.shape, 3, 3)
    along = R[..., :, :, None, None] * R[..., None, None, :, :]
    by_turn = lam * (trace - 3)[..., None, None] - 2 * mu
    same = np.einsum("ij,kl->ikjl", EYE, EYE)
    return P, 2 * mu[..., None, None] * same + lam[..., None, None] * along + by_turn[..., None, None] * turned


def neo_hookean(F: Array, lam: Array, mu: Array) -> tuple[Array, Array]:
    """Return P = μ (F − F⁻ᵀ) + λ ln J F⁻ᵀ and ∂P/∂F."""
    back = np.linalg.inv(F).swapaxes(-1, -2)
    grown = lam * np.log(np.linalg.det(F)) - mu
    P = mu[..., None, None] * F + grown[..., None, None] * back
    same = np.einsum("ij,kl->ikjl", EYE, EYE)
    lam, mu, grown = (some[..., None, None, None, None] for some in (lam, mu, grown))
    crossed = back[..., :, None, None, :] * back.swapaxes(-1, -2)[..., None, :, :, None]
    return P, mu * same + lam * back[..., :, :, None, None] * back[..., None, None, :, :] - grown * crossed


LAWS: dict[str, Law] = {"corotational": corotational, "neo-hookean": neo_hookean}


def internal_force(mesh: Bricks, law: Law, moved: Array) -> tuple[Array, sparse.csr_array]:
    """Return f (N, 3) [N] and its derivative (3N, 3N) where the nodes are `moved` (N, 3) [m]."""
    gradient, volume = mesh.rule
    q, a = gradient.shape[:2]
    weighted = (gradient * volume[:, None, None]).transpose(1, 0, 2).reshape(a, 3 * q)
    total, blocks = np.zeros_like(mesh.nodes), np.empty((len(mesh.element), 9 * a * a))
    for start in range(0, len(mesh.element), BLOCK):
        some = slice(start, start + BLOCK)
        F = deformations(mesh, moved, some)
        P, slope = law(F, *(np.repeat(one[some, None], q, axis=1) for one in (mesh.lam, mesh.mu)))
        inner = weighted @ P.transpose(0, 1, 3, 2).reshape(len(F), 3 * q, 3)
        np.add.at(total, mesh.element[some], inner)
        moving = slope.reshape(len(F), q, 27, 3) @ gradient.transpose(0, 2, 1)  # ∂P_ik/∂u_bj at q
        moving = moving.reshape(len(F), q, 3, 3, 3, a).transpose(0, 1, 3, 2, 5, 4)
        blocks[some] = (weighted @ moving.reshape(len(F), 3 * q, -1)).reshape(len(F), -1)
    return total, assembled(mesh, mesh.element, blocks)


def equilibria(
    mesh: Bricks, low: Bricks, law: Law, pulls: Sequence[tuple[Length, float]], shares: Sequence[float]
) -> list[Array]:
    """Return where the nodes have moved (N, 3) [m] under the forces on lengths times each of `shares`, ascending.

    low: bricks of order 1 with the same nodes.
    Raise MjframesError where Newton's method does not come to rest.
    """
    known, found = [(0.0, np.zeros_like(mesh.nodes))], []
    for goal in shares:
        last = known[-1][0]
        for share in np.linspace(last, goal, 1 + int(np.ceil((goal - last) / INCREMENT)))[1:]:
            moved = _equilibrium(mesh, low, law, pulls, float(share), _ahead(known, float(share)))
            known = [*known[-2:], (float(share), moved)]
        found.append(known[-1][1])
    return found


def _ahead(known: Sequence[tuple[float, Array]], share: float) -> Array:
    """What the last solutions, of shares of the forces, let expect at another share: Lagrange's polynomial."""
    total = np.zeros_like(known[0][1])
    for own, moved in known:
        total += moved * np.prod([(share - other) / (own - other) for other, _ in known if other != own])
    return total


def _equilibrium(
    mesh: Bricks, low: Bricks, law: Law, pulls: Sequence[tuple[Length, float]], share: float, moved: Array
) -> Array:
    """The equilibrium under a share of the forces, from `moved` (N, 3) on."""
    moving, inverse = mesh.moving, None
    for _ in range(ITERATIONS):
        inner, tangent = internal_force(mesh, law, moved)
        outer = np.zeros_like(inner)
        for length, force in pulls:
            _, slope, curvature = length.at(mesh, moved)
            outer += share * force * slope
            tangent = sparse.csr_array(tangent - share * force * curvature)
        residual = (outer - inner).ravel()[moving]
        if np.linalg.norm(residual) < TOLERANCE * np.linalg.norm(outer):
            return moved
        if inverse is None:
            rough = tangent if low is mesh else internal_force(low, law, moved)[1]
            inverse = preconditioner(sparse.csr_array(rough[moving][:, moving]), mesh)
        step = np.zeros(len(moving))
        step[moving] = solve(sparse.csr_array(tangent[moving][:, moving]), inverse, residual, CLOSE)
        moved = moved + step.reshape(-1, 3)
    raise MjframesError("the finite elements did not come to rest; make the forces smaller.")
