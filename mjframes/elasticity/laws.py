"""Hyperelastic laws: energy density ψ(F), first Piola stress P = ∂ψ/∂F and ∂P/∂F made positive semi-definite (§5.2).

`law_table.py` has the laws and their equation; here is what follows from it for all of them.
Index letters: q deformation gradient; r, s its rows; a, b its columns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mjframes.base.errors import MjframesError
from mjframes.elasticity.law_table import LAWS, Constants, Terms
from mjframes.volume.material import Material

Array = NDArray[np.float64]

LEAST_VOLUME = 1e-6  # [-] least |J| that Cauchy's stress is divided by
REACH = 1.0  # [-] of F along an eigenvector of ∂P/∂F: the longest Newton step; strains below it are not affected


@dataclass(frozen=True)
class LawParameters:
    """Constants of one law for one material, in the law's order: moduli [Pa] and ratios [-], 0 where it has no such."""

    law: str
    constants: Constants

    def __getitem__(self, name: str) -> float:
        """Return a constant by its name."""
        return self.constants[LAWS[self.law].constants.index(name)]

    def scaled(self, factor: float) -> LawParameters:
        """Return those of a material with `factor` times the moduli."""
        law = LAWS[self.law]
        pairs = zip(law.constants, self.constants, strict=True)
        one, two, three = (value if name in law.ratios else factor * value for name, value in pairs)
        return LawParameters(self.law, (one, two, three))

    @property
    def hooke(self) -> tuple[float, float]:
        """Return Young's modulus [Pa] and Poisson's ratio [-] of small strains."""
        mu, bulk = LAWS[self.law].shear(self.constants), self["bulk"]
        young = 9 * bulk * mu / (3 * bulk + mu)
        return young, max(0.0, young / (2 * mu) - 1)


def law_parameters(law: str, material: Material) -> LawParameters:
    """Return the law's constants for a material: its own, the others from its Young's modulus and Poisson's ratio.

    Raise MjframesError for unknown laws and constants and for values that no stable law has.
    """
    if law not in LAWS:
        raise MjframesError(f"law is {law!r}; the laws on quadrature points are {', '.join(map(repr, LAWS))}.")
    kind, given = LAWS[law], material.law_constants
    if unknown := sorted(set(given) - set(kind.names)):
        raise MjframesError(f"law {law!r} has no constant {unknown[0]!r}; it has {', '.join(kind.names)}.")
    lam, mu = material.lame
    values = {"bulk": lam + 2 * mu / 3, **kind.missing(given, mu), **given}
    made = law_of_constants(law, [values.get(name, 0.0) for name in kind.constants])
    mu, bulk = kind.shear(made.constants), made["bulk"]
    _require(law, kind.shear_name, mu, 0 < mu < np.inf, "positive")
    _require(law, "bulk", bulk, 2 / 3 * mu <= bulk * (1 + 1e-12) < np.inf, f"at least 2/3 μ, {2 / 3 * mu:g} Pa")
    for name, (least, condition) in kind.least.items():
        _require(law, name, made[name], least <= made[name] < np.inf, condition)
    return made


def law_of_constants(law: str, constants: Sequence[float]) -> LawParameters:
    """Return the parameters from what `constants` gave."""
    one, two, three = constants
    return LawParameters(law, (one, two, three))


def _require(law: str, name: str, value: float, holds: bool, condition: str) -> None:
    if not holds:
        raise MjframesError(f"{name} of law {law!r} is {value:g}; it must be {condition}.")


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


def _terms(parameters: LawParameters, i1: Array) -> Terms:
    return LAWS[parameters.law].terms(parameters.constants, i1)
