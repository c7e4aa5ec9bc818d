"""The hyperelastic laws, an entry each: all that the Python half knows of a law is here.

Each is a function of I₁ = tr C, I₂ = ½ (I₁² − tr C²) and J = det F, C = Fᵀ F, finite for every F,

    ψ = f(I₁) + c₂ (I₂ − 3) − d (J − 1) + κ/2 (J − 1)²

where ∂ψ/∂F = 0 at rest and Hooke's law with shear modulus μ and bulk modulus K near it ask for

    2 f'(3) + 4 c₂ = d,   2 f'(3) + 2 c₂ = μ,   4 f''(3) − 2 f'(3) + κ = K − 2/3 μ.

`build`, its errors, the command line, the documents and the tests read LAWS; stress and tangent follow (`laws.py`). The
plugin has the same laws (plugin/laws), which says more on each; this is what its results are compared with.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mjframes.base.choices import COROTATIONAL

Array = NDArray[np.float64]
Constants = tuple[float, float, float]  # of one material, as the plugin reads them
Terms = tuple[tuple[Array, Array, Array], float, float, float]  # f, f', f'' at I₁ (q,); c₂, d and κ [Pa]

SEGMENTS = 8.0  # [-] N of arruda_boyce unless given: chains are straight at a stretch of 2.8 and more
COLLAPSING = 1.5  # [-] I₁ below which ρ departs from it; at 0.9 it would leave a second minimum for ν = 0
CHAINS = (1 / 2, 1 / 20, 11 / 1050, 19 / 7000, 519 / 673750)  # Arruda and Boyce's series


def _as_hooke(given: Mapping[str, float], mu: float) -> dict[str, float]:
    return {"mu": mu}


@dataclass(frozen=True)
class Law:
    """A hyperelastic law.

    constants: their names, in the order in which the plugin reads them, "" for a place that is not used; the last one
    is the bulk modulus of small strains.
    terms: f and its derivatives, c₂, d and κ, of the constants and of I₁.
    missing: the constants but the bulk modulus that nobody gives, from those that are given and Hooke's μ [Pa].
    shear: μ of small strains [Pa], of the constants; shear_name: what messages call it.
    least: the smallest value of a constant, and that as messages say it.
    ratios: names of the constants that have no unit.
    """

    constants: tuple[str, str, str]
    terms: Callable[[Constants, Array], Terms]
    missing: Callable[[Mapping[str, float], float], dict[str, float]] = _as_hooke
    shear: Callable[[Constants], float] = lambda constants: constants[0]
    shear_name: str = "mu"
    least: Mapping[str, tuple[float, str]] = field(default_factory=dict)
    ratios: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of its constants."""
        return tuple(filter(None, self.constants))


def _green_lagrange(constants: Constants, i1: Array) -> Terms:
    """μ |dev E|² = μ/6 (I₁² − 3 I₂)."""
    mu, _, bulk = constants
    return (mu / 6 * (i1**2 - 9), mu / 3 * i1, np.full_like(i1, mu / 3)), -mu / 2, 0.0, bulk


def _neo_hookean(constants: Constants, i1: Array) -> Terms:
    mu, _, bulk = constants
    f = 2 / 3 * mu * (i1 - 3 - np.log((i1 + 1) / 4))
    return (f, 2 / 3 * mu * i1 / (i1 + 1), 2 / 3 * mu / (i1 + 1) ** 2), 0.0, mu, bulk + mu / 6


def _mooney_rivlin(constants: Constants, i1: Array) -> Terms:
    c10, c01, bulk = constants
    rho, slope, curvature = _regular_invariant(i1)
    d, kappa = 2 * c10 + 4 * c01, bulk + (2 * c10 - 4 * c01) / 3
    return (c10 * (rho - 3), c10 * slope, c10 * curvature), c01, d, kappa


def _mooney_rivlin_missing(given: Mapping[str, float], mu: float) -> dict[str, float]:
    """c₁₀ = c₀₁ = μ/4 unless one of them is given: then the other is what μ/2 leaves."""
    c01 = given.get("c01", mu / 2 - given["c10"] if "c10" in given else mu / 4)
    return {"c10": mu / 2 - c01, "c01": c01}


def _arruda_boyce(constants: Constants, i1: Array) -> Terms:
    mu, segments, bulk = constants
    rho, slope, curvature = _regular_invariant(i1)
    rest = _chains(np.array(3.0), segments)
    chain = mu / (2 * rest[1])  # μ₁
    f, df, ddf = _chains(rho, segments)
    terms = (chain * (f - rest[0]), chain * df * slope, chain * (ddf * slope**2 + df * curvature))
    return terms, 0.0, mu, bulk + mu / 3 - 4 * float(chain * rest[2])


def _regular_invariant(i1: Array) -> tuple[Array, Array, Array]:
    """ρ, ρ', ρ'': I₁ above COLLAPSING, below it a cubic that is flat at 0, so that nothing holds a collapsed point."""
    x = np.minimum(i1 / COLLAPSING, 1)
    rho = np.where(x < 1, COLLAPSING * (x**2 - x**3 / 3 + 1 / 3), i1)
    return rho, x * (2 - x), 2 * (1 - x) / COLLAPSING


def _chains(rho: Array, segments: float) -> tuple[Array, Array, Array]:
    """Σ_k a_k N^(1−k) ρᵏ and its first two derivatives."""
    series = np.polynomial.Polynomial([0, *(a / segments**k for k, a in enumerate(CHAINS))])
    return series(rho), series.deriv()(rho), series.deriv(2)(rho)


LAWS: dict[str, Law] = {
    "green_lagrange": Law(("mu", "", "bulk"), _green_lagrange),
    "neo_hookean": Law(("mu", "", "bulk"), _neo_hookean),
    "mooney_rivlin": Law(
        ("c10", "c01", "bulk"),
        _mooney_rivlin,
        _mooney_rivlin_missing,
        shear=lambda constants: 2 * (constants[0] + constants[1]),
        shear_name="c10 + c01",
        least={"c10": (0, "at least 0"), "c01": (0, "at least 0")},
    ),
    "arruda_boyce": Law(
        ("mu", "segments", "bulk"),
        _arruda_boyce,
        lambda given, mu: {"mu": mu, "segments": SEGMENTS},
        least={"segments": (2, "at least 2 segments in a chain")},
        ratios=("segments",),
    ),
}
ALL_LAWS = (COROTATIONAL, *LAWS)
