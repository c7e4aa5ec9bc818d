"""Hyperelastic laws: energy density ψ(F), first Piola stress P = ∂ψ/∂F and ∂P/∂F made positive semi-definite (§5.2).

Each is a function of I₁ = tr C, I₂ = ½ (I₁² − tr C²) and J = det F, C = Fᵀ F, finite for every F,

    ψ = f(I₁) + c₂ (I₂ − 3) − d (J − 1) + κ/2 (J − 1)²

where ∂ψ/∂F = 0 at rest and Hooke's law with shear modulus μ and bulk modulus K near it ask for

    2 f'(3) + 4 c₂ = d,   2 f'(3) + 2 c₂ = μ,   4 f''(3) − 2 f'(3) + κ = K − 2/3 μ.

The plugin has the same laws (plugin/laws), which says more on each; this is what its results are compared with.
Index letters: q deformation gradient; r, s its rows; a, b its columns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from numpy.typing import NDArray

from mjframes.base.choices import LAWS, Law
from mjframes.base.errors import MjframesError
from mjframes.volume.material import Material

Array = NDArray[np.float64]

CONSTANTS: dict[Law, tuple[str, ...]] = {
    "green_lagrange": ("mu", "bulk"),
    "neo_hookean": ("mu", "bulk"),
    "mooney_rivlin": ("c10", "c01", "bulk"),
    "arruda_boyce": ("mu", "segments", "bulk"),
}
SEGMENTS = 8.0  # [-] N of arruda_boyce unless given: chains are straight at a stretch of 2.8 and more
LEAST_VOLUME = 1e-6  # [-] least |J| that Cauchy's stress is divided by
COLLAPSING = 1.5  # [-] I₁ below which ρ departs from it; at 0.9 it would leave a second minimum for ν = 0
REACH = 1.0  # [-] of F along an eigenvector of ∂P/∂F: the longest Newton step; strains below it are not affected
CHAINS = (1 / 2, 1 / 20, 11 / 1050, 19 / 7000, 519 / 673750)  # Arruda and Boyce's series


@dataclass(frozen=True)
class LawParameters:
    """Constants of one law for one material: mu, c10, c01, bulk [Pa], segments [-]; 0 where the law has no such."""

    law: Law
    mu: float = 0.0
    c10: float = 0.0
    c01: float = 0.0
    segments: float = 0.0
    bulk: float = 0.0

    @property
    def constants(self) -> tuple[float, float, float]:
        """Return what the plugin reads: (μ, 0, K), (μ, 0, K), (c₁₀, c₀₁, K) or (μ, N, K)."""
        if self.law == "mooney_rivlin":
            return self.c10, self.c01, self.bulk
        return self.mu, self.segments, self.bulk

    def scaled(self, factor: float) -> LawParameters:
        """Return those of a material with `factor` times the moduli."""
        moduli = {name: factor * getattr(self, name) for name in ("mu", "c10", "c01", "bulk")}
        return replace(self, **moduli)

    @property
    def hooke(self) -> tuple[float, float]:
        """Return Young's modulus [Pa] and Poisson's ratio [-] of small strains."""
        mu = self.mu or 2 * (self.c10 + self.c01)
        young = 9 * self.bulk * mu / (3 * self.bulk + mu)
        return young, max(0.0, young / (2 * mu) - 1)


def law_parameters(law: Law, material: Material) -> LawParameters:
    """Return the law's constants for a material: its own, the others from its Young's modulus and Poisson's ratio.

    Mooney and Rivlin's c₁₀ = c₀₁ = μ/4 unless one of them is given: then the other is what μ/2 leaves.
    Raise MjframesError for unknown laws and constants and for values that no stable law has.
    """
    if law not in LAWS:
        raise MjframesError(f"law is {law!r}; the laws on quadrature points are {', '.join(map(repr, LAWS))}.")
    given = material.law_constants
    if unknown := sorted(set(given) - set(CONSTANTS[law])):
        raise MjframesError(f"law {law!r} has no constant {unknown[0]!r}; it has {', '.join(CONSTANTS[law])}.")
    lam, mu = material.lame
    values = {"bulk": lam + 2 * mu / 3, **given}
    if law == "mooney_rivlin":
        if "c10" in given and "c01" not in given:
            values["c01"] = mu / 2 - given["c10"]
        values.setdefault("c01", mu / 4)
        values.setdefault("c10", mu / 2 - values["c01"])
        mu = 2 * (values["c10"] + values["c01"])
    else:
        mu = values.setdefault("mu", mu)
    if law == "arruda_boyce":
        values.setdefault("segments", SEGMENTS)
    made = LawParameters(law, **values)
    _require(made, "mu" if "mu" in CONSTANTS[law] else "c10 + c01", mu, 0 < mu < np.inf, "positive")
    _require(
        made, "bulk", made.bulk, 2 / 3 * mu <= made.bulk * (1 + 1e-12) < np.inf, f"at least 2/3 μ, {2 / 3 * mu:g} Pa"
    )
    if law == "mooney_rivlin":
        _require(made, "c10", made.c10, made.c10 >= 0, "at least 0")
        _require(made, "c01", made.c01, made.c01 >= 0, "at least 0")
    if law == "arruda_boyce":
        _require(made, "segments", made.segments, 2 <= made.segments < np.inf, "at least 2 segments in a chain")
    return made


def law_of_constants(law: str, constants: Sequence[float]) -> LawParameters:
    """Return the parameters from what `constants` gave."""
    names = ("c10", "c01", "bulk") if law == "mooney_rivlin" else ("mu", "segments", "bulk")
    return LawParameters(cast(Law, law), **dict(zip(names, constants, strict=True)))


def _require(made: LawParameters, name: str, value: float, holds: bool, condition: str) -> None:
    if not holds:
        raise MjframesError(f"{name} of law {made.law!r} is {value:g}; it must be {condition}.")


def energy(parameters: LawParameters, F: Array) -> Array:
    """Return ψ (q,) [J/m³] of deformation gradients F (q, 3, 3); 0 at rest."""
    i1, i2, j, _ = _invariants(F)
    (f, _, _), c2, d, kappa = _terms(parameters, i1)
    return f + c2 * (i2 - 3) - d * (j - 1) + kappa / 2 * (j - 1) ** 2


def stress(parameters: LawParameters, F: Array) -> Array:
    """Return the first Piola stress P (q, 3, 3) [Pa] = 2 f' F + 2 c₂ (I₁ F − F C) + (κ (J − 1) − d) cof F."""
    i1, _, j, cofactor = _invariants(F)
    (_, slope, _), c2, d, kappa = _terms(parameters, i1)
    along = 2 * (slope + c2 * i1)[:, None, None]
    return along * F - 2 * c2 * F @ _transposed(F) @ F + (kappa * (j - 1) - d)[:, None, None] * cofactor


def hessian(parameters: LawParameters, F: Array) -> Array:
    """Return ∂P/∂F (q, 9, 9) [Pa], row 3r + a and column 3s + b for ∂P_ra/∂F_sb."""
    i1, _, j, cofactor = _invariants(F)
    (_, slope, curvature), c2, d, kappa = _terms(parameters, i1)
    eye = np.eye(3)
    same = np.einsum("rs,ab->rasb", eye, eye)[None]
    left, right = F @ _transposed(F), _transposed(F) @ F
    by_f = np.einsum("qra,qsb->qrasb", F, F)
    twisted = (
        np.einsum("qrb,qsa->qrasb", F, F)
        + np.einsum("rs,qab->qrasb", eye, right)
        + np.einsum("qrs,ab->qrasb", left, eye)
    )
    permutation = np.zeros((3, 3, 3))
    permutation[[0, 1, 2], [1, 2, 0], [2, 0, 1]], permutation[[0, 1, 2], [2, 0, 1], [1, 2, 0]] = 1, -1
    by_cofactor = np.einsum("rst,abc,qtc->qrasb", permutation, permutation, F)  # ∂cof F/∂F

    def times(scalar: Array) -> Array:
        return scalar[:, None, None, None, None]

    total = (
        2 * times(slope + c2 * i1) * same
        + 4 * times(curvature + c2) * by_f
        - 2 * c2 * twisted
        + kappa * np.einsum("qra,qsb->qrasb", cofactor, cofactor)
        + times(kappa * (j - 1) - d) * by_cofactor
    )
    return total.reshape(-1, 9, 9)


def projected_hessian(parameters: LawParameters, F: Array) -> Array:
    """Return ∂P/∂F (q, 9, 9) [Pa] with the magnitudes of its eigenvalues λ, positive semi-definite; no Newton step from
    it is longer than `REACH` along an eigenvector n, in F or to the largest stretch σ:
    max(|λ|, |P·n| / (REACH max(1, σ))).

    With zero for negative ones a crumpled body has nothing but its mass against a large force there, and large steps
    throw it apart (Chen et al., Stabler Neo-Hookean Simulation, SIGGRAPH 2024); so do those eigenvalues that pass
    through zero on the way to rest, where the stress does not.
    """
    values, vectors = np.linalg.eigh(hessian(parameters, F))
    load = np.einsum("qe,qen->qn", stress(parameters, F).reshape(-1, 9), vectors)
    reach = REACH * np.maximum(1, np.linalg.norm(F, 2, axis=(1, 2)))
    return np.einsum("qen,qn,qfn->qef", vectors, np.maximum(np.abs(values), np.abs(load) / reach[:, None]), vectors)


def cauchy_stress(parameters: LawParameters, F: Array) -> Array:
    """Return σ (q, 3, 3) [Pa] = P Fᵀ / J; |J| counts as 1e-6 where it is less, as in the plugin."""
    j = np.linalg.det(F)[:, None, None]
    return stress(parameters, F) @ _transposed(F) / np.copysign(np.maximum(np.abs(j), LEAST_VOLUME), j)


def _transposed(F: Array) -> Array:
    return np.swapaxes(F, -1, -2)


def _invariants(F: Array) -> tuple[Array, Array, Array, Array]:
    """I₁, I₂, J (q,) and cof F (q, 3, 3)."""
    cofactor = np.stack([np.cross(F[:, (r + 1) % 3], F[:, (r + 2) % 3]) for r in range(3)], axis=1)
    return (
        (F**2).sum(axis=(1, 2)),
        (cofactor**2).sum(axis=(1, 2)),
        np.einsum("qa,qa->q", F[:, 0], cofactor[:, 0]),
        cofactor,
    )


def _terms(p: LawParameters, i1: Array) -> tuple[tuple[Array, Array, Array], float, float, float]:
    """f, f', f'' at I₁ (q,); c₂, d and κ [Pa]."""
    if p.law == "green_lagrange":  # μ |dev E|² = μ/6 (I₁² − 3 I₂)
        return (p.mu / 6 * (i1**2 - 9), p.mu / 3 * i1, np.full_like(i1, p.mu / 3)), -p.mu / 2, 0.0, p.bulk
    if p.law == "neo_hookean":
        f = 2 / 3 * p.mu * (i1 - 3 - np.log((i1 + 1) / 4))
        return (f, 2 / 3 * p.mu * i1 / (i1 + 1), 2 / 3 * p.mu / (i1 + 1) ** 2), 0.0, p.mu, p.bulk + p.mu / 6
    rho, slope, curvature = _regular_invariant(i1)
    if p.law == "mooney_rivlin":
        d, kappa = 2 * p.c10 + 4 * p.c01, p.bulk + (2 * p.c10 - 4 * p.c01) / 3
        return (p.c10 * (rho - 3), p.c10 * slope, p.c10 * curvature), p.c01, d, kappa
    rest = _chains(np.array(3.0), p.segments)
    chain = p.mu / (2 * rest[1])  # μ₁
    f, df, ddf = _chains(rho, p.segments)
    terms = (chain * (f - rest[0]), chain * df * slope, chain * (ddf * slope**2 + df * curvature))
    return terms, 0.0, p.mu, p.bulk + p.mu / 3 - 4 * float(chain * rest[2])


def _regular_invariant(i1: Array) -> tuple[Array, Array, Array]:
    """ρ, ρ', ρ'': I₁ above COLLAPSING, below it a cubic that is flat at 0, so that nothing holds a collapsed point."""
    x = np.minimum(i1 / COLLAPSING, 1)
    rho = np.where(x < 1, COLLAPSING * (x**2 - x**3 / 3 + 1 / 3), i1)
    return rho, x * (2 - x), 2 * (1 - x) / COLLAPSING


def _chains(rho: Array, segments: float) -> tuple[Array, Array, Array]:
    """Σ_k a_k N^(1−k) ρᵏ and its first two derivatives."""
    series = np.polynomial.Polynomial([0, *(a / segments**k for k, a in enumerate(CHAINS))])
    return series(rho), series.deriv()(rho), series.deriv(2)(rho)
