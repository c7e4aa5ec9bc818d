"""What is pressed gets stiffer: energy that a corotational region has beside W (§5.2; plugin/pressed.h says why).

    ψ = c Σ_i g(1 − b − σ_i),   σ the eigenvalues of 1 + ε,   ε = C⁻¹ Uᵀ K_e y,   C = Uᵀ K_e U,   c = λ μ V / (λ + μ)

U are the uniform strains of the region's points, and λ V and μ V are those of C. g′(e) is 18 e² for e > 0, and
straight on where σ is below 0.3. Strains are (6,), of the symmetric S of unit |S|: three along the axes, then three
across them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# [-] each as in plugin/constants.h, where they are explained
PRESSED_BEGIN = 0.15
PRESSED_END = 0.3
SINGULAR = 1e-8
ALIKE = 1e-6

EYE = np.eye(3)
ACROSS = np.array([0, 1, 2]), np.array([1, 2, 0])
STRAINS = np.array(
    [np.outer(axis, axis) for axis in EYE]
    + [np.sqrt(0.5) * (np.outer(EYE[a], EYE[b]) + np.outer(EYE[b], EYE[a])) for a, b in zip(*ACROSS, strict=True)]
)
FLAT = STRAINS.reshape(6, 9)
VOLUME = np.array([1.0, 1, 1, 0, 0, 0])  # tr ε = VOLUME · ε


@dataclass(frozen=True, eq=False)
class UniformResponse:
    """What K_e answers to uniform strains, y_j = S x̄_j.

    energy: C (6, 6) [J].
    force: K_e U (3m, 6) [N].
    """

    energy: Array
    force: Array

    @staticmethod
    def of(rest: Array, stiffness: Array) -> UniformResponse:
        """Return that of points at rest (m, 3) and K_e (3m, 3m)."""
        offset = rest - rest.mean(axis=0)
        motions = np.stack([(offset @ S).ravel() for S in STRAINS], axis=1)
        force = stiffness @ motions
        return UniformResponse(motions.T @ force, force)

    @property
    def dilation(self) -> float:
        """Return K_e's eigenvalue on the strain that changes the volume alone: (3 λ + 2 μ) V [J]."""
        return max(0.0, float(VOLUME @ self.energy @ VOLUME) / 3)

    @property
    def shear(self) -> float:
        """Return the mean of its eigenvalues on the five that keep the volume: 2 μ V [J]."""
        return max(0.0, (float(np.trace(self.energy)) - self.dilation) / 5)


@dataclass(frozen=True, eq=False)
class PressedCell:
    """How a region of m points is where it is pressed.

    firmness: c [J].
    slope: C⁻¹ Uᵀ K_e (6, 3m) [1/m].
    """

    firmness: float
    slope: Array

    @staticmethod
    def none(size: int) -> PressedCell:
        """Return that of a region of so many degrees of freedom that has no ψ."""
        return PressedCell(0.0, np.zeros((6, size)))

    @staticmethod
    def of(response: UniformResponse) -> PressedCell:
        """Return that of a region with this response."""
        least, *_, most = np.linalg.eigvalsh(response.energy)
        if least <= SINGULAR * most:
            return PressedCell.none(len(response.force))
        mu, lame = 0.5 * response.shear, max(0.0, (response.dilation - response.shear) / 3)
        return PressedCell(
            mu * lame / (lame + mu), np.asarray(np.linalg.solve(response.energy, response.force.T), np.float64)
        )

    def at(self, strain: Array) -> tuple[float, Array, Array]:
        """Return ψ [J], P = ∂ψ/∂ε (6,) [J] and ∂P/∂ε (6, 6) [J] of ε (6,)."""
        value, axes = np.linalg.eigh(EYE + (strain @ FLAT).reshape(3, 3))
        e = 1 - PRESSED_BEGIN - value
        if not self.firmness or e[0] <= 0:
            return 0.0, np.zeros(6), np.zeros((6, 6))
        g, g1, g2 = stiffening(e)
        a, b = ACROSS
        apart = e[a] - e[b]
        alike = np.abs(apart) <= ALIKE
        between = np.where(alike, 0.5 * (g2[a] + g2[b]), (g1[a] - g1[b]) / np.where(alike, 1, apart))
        along = FLAT @ (axes[:, None] * axes).reshape(9, 3)
        across = FLAT @ (np.sqrt(2) * axes[:, None, a] * axes[:, b]).reshape(9, 3)
        H = (along * g2) @ along.T + (across * between) @ across.T
        return self.firmness * float(g.sum()), -self.firmness * along @ g1, self.firmness * H


def stiffening(e: Array) -> tuple[Array, Array, Array]:
    """Return g, g′ and g″ of e = 1 − b − σ."""
    end = 1 - PRESSED_BEGIN - PRESSED_END
    some, beyond = np.clip(e, 0, end), np.maximum(0, e - end)
    g1, g2 = 18 * some**2, 36 * some
    return 6 * some**3 + beyond * (g1 + 0.5 * beyond * g2), g1 + beyond * g2, g2
