"""Corotational elasticity of a region, written as its equations (the paper, §5.2, with the exact rotation gradient).

    y_j = Rᵀ x_j − x̄_j              R: the proper rotation closest to F = Σ_j x_j g_jᵀ
    W   = ½ yᵀ K_e y                 energy [J]
    f   = −R Pᵀ K_e y                force [N], the exact −∂W/∂x while R is well determined (λ = 0, θ = 1)
    K   = (2 − θ) R Pᵀ K_e P Rᵀ      stiffness of a step [N/m], positive semi-definite; Gauss–Newton's for θ = 1

The gradients g are the region's own, ḡ, unless it is what one frame, the child, adds to other frames, its parents:

    g   = θ ḡ + (1 − θ) ĝ            ĝ: of the parents' points alone
    θ   = smoothstep((e − OPPOSED) / (AGREEING − OPPOSED))
    e   = min λ_min(sym(R₀ᵀ F))      over F₀ = Σ_j x_j ḡ_jᵀ and F_p = Σ_j x_j g°_jᵀ of each frame p; R₀ closest to F₀

Given the parents' rotation the energy is a convex quadratic of the child's points, so that a child that was turned over
or inside out finds back. e is 1 at rest; how x changes θ is left out of f and K, as it is for λ.

A hyperelastic law takes its share of the energy, in cells q of the region (`whole_body.cells`); K_e is what remains:

    W   = ½ yᵀ K_e y + Σ_q V_q ψ(F_q),   F_q = I + E_q y
    f   = −R Pᵀ (K_e y + Σ_q V_q E_qᵀ P(F_q)),   K_e + Σ_q V_q E_qᵀ (∂P/∂F) E_q for K_e in K, ∂P/∂F projected

The plugin computes the same inside `mj_step`; this module is what the views read and what the plugin is tested against.
Shapes: x, rest, gradient (m, 3); K_e (3m, 3m), y (3m,), E_q (9, 3m), degrees of freedom point by point.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mjframes.elasticity.laws import LawParameters, energy, projected_hessian, stress

# each as in plugin/, where they are explained
AGREEING, OPPOSED = 0.4, 0.1  # [-] e above which θ is 1 and below which it is 0
SOFT_TWIST, SOFT_TWIST_APART = 0.1, 1.0  # [-] h_min below which the shape as it is shows how it turns, for θ = 1 and 0
FLAT, TINY = 1e-3, 1e-15  # [-], [m²] of a shape's second moments
SINGULAR = 1e-8  # [-] of A Z


def closest_rotation(deformation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return R (3, 3) in SO(3) that maximises tr(Rᵀ F), for F (3, 3): inverted shapes flip their thinnest direction."""
    u, _, vt = np.linalg.svd(deformation)
    u[:, 2] *= np.sign(np.linalg.det(u) * np.linalg.det(vt))
    return u @ vt


def cross_stack(z: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return Z (3m, 3) with (Z a)_j = a × z_j, for z (m, 3)."""
    stack = np.zeros((len(z), 3, 3))
    stack[:, 0, 1], stack[:, 0, 2] = z[:, 2], -z[:, 1]
    stack[:, 1, 0], stack[:, 1, 2] = -z[:, 2], z[:, 0]
    stack[:, 2, 0], stack[:, 2, 1] = z[:, 1], -z[:, 0]
    return stack.reshape(-1, 3)


def smallest_eigenvalue(matrix: NDArray[np.float64]) -> float:
    """Return the smallest eigenvalue of the symmetric part of a matrix (3, 3)."""
    return float(np.linalg.eigvalsh(0.5 * (matrix + matrix.T))[0])


def trust(agreement: float) -> float:
    """Return θ [-], how much a region's own gradients count, for e."""
    t = min(max((agreement - OPPOSED) / (AGREEING - OPPOSED), 0.0), 1.0)
    return t * t * (3 - 2 * t)


def shape_gradient(z: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return gradients (m, 3) [1/m] of a shape as it is now: N (z_j − c), N = (Σ_j (z_j − c)(z_j − c)ᵀ)⁻¹, c a mean."""
    offset = z - z.mean(axis=0)
    moment = offset.T @ offset
    return offset @ np.linalg.inv(moment + (FLAT * np.trace(moment) + TINY) * np.eye(3))


@dataclass(frozen=True, eq=False)
class LawCell:
    """A point at which a region's hyperelastic law is evaluated.

    volume: V_q [m³].
    law: of its material.
    slope: E_q (9, 3m) [1/m], row 3r + a for F_ra.
    """

    volume: float
    law: LawParameters
    slope: NDArray[np.float64]

    def deformation(self, y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return F_q (1, 3, 3)."""
        return np.eye(3)[None] + (self.slope @ y).reshape(1, 3, 3)


@dataclass(frozen=True, eq=False)
class Fallback:
    """What a region turns by where its frames disagree.

    gradient: ĝ (m, 3) [1/m], 0 for the child's points.
    own: g° (m, 3) [1/m], 0 for frames that have none.
    frame: (m,) of each point, the child last.
    """

    gradient: NDArray[np.float64]
    own: NDArray[np.float64]
    frame: NDArray[np.int64]

    def agreement(self, x: NDArray[np.float64], gradient: NDArray[np.float64]) -> float:
        """Return e [-] with the points at x (m, 3) [m]; gradient: ḡ (m, 3) [1/m]."""
        deformation = x.T @ gradient
        back = closest_rotation(deformation).T
        frames = (self.frame == i for i in np.unique(self.frame))
        of_frames = (x[some].T @ self.own[some] for some in frames if self.own[some].any())
        return min(smallest_eigenvalue(back @ some) for some in (deformation, *of_frames))

    @property
    def parents(self) -> int:
        """Return how many points are the parents', which come first."""
        return int((self.frame != self.frame[-1]).sum())


@dataclass(frozen=True, eq=False)
class CorotationalRegion:
    """A region with corotational elasticity.

    points: (m,) its control points.
    rest: x̄ (m, 3) [m].
    gradient: ḡ (m, 3) [1/m].
    stiffness: K_e [N/m].
    fallback: None where ḡ stands alone.
    cells: of a hyperelastic law, of which K_e is what remains.
    """

    points: NDArray[np.int64]
    rest: NDArray[np.float64]
    gradient: NDArray[np.float64]
    stiffness: NDArray[np.float64]
    fallback: Fallback | None = None
    cells: tuple[LawCell, ...] = ()

    def effective_gradient(self, x: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        """Return θ [-] and g (m, 3) [1/m] with the region's control points at x (m, 3) [m]."""
        if self.fallback is None:
            return 1.0, self.gradient
        theta = trust(self.fallback.agreement(x, self.gradient))
        return theta, theta * self.gradient + (1 - theta) * self.fallback.gradient

    def rotation(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return R (3, 3)."""
        return closest_rotation(x.T @ self.effective_gradient(x)[1])

    def spin(self, x: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return ω (3,) [rad/s], dR/dt = R [ω]×, while the region's points at x (m, 3) [m] move by v (m, 3) [m/s].

        With S = RᵀF, ω solves (tr(S) 1 − S) ω = axial(RᵀḞ − ḞᵀR); how θ changes is left out.
        """
        gradient = self.effective_gradient(x)[1]
        rotation = closest_rotation(x.T @ gradient)
        stretch, rate = rotation.T @ x.T @ gradient, rotation.T @ v.T @ gradient
        axial = np.array([rate[2, 1] - rate[1, 2], rate[0, 2] - rate[2, 0], rate[1, 0] - rate[0, 1]])
        twist = np.trace(stretch) * np.eye(3) - 0.5 * (stretch + stretch.T)
        return np.linalg.pinv(twist, rcond=SINGULAR, hermitian=True) @ axial

    def energy(self, x: NDArray[np.float64]) -> float:
        """Return ½ yᵀ K_e y + Σ_q V_q ψ(F_q) [J]."""
        _, _, y = self._strain(x, self.effective_gradient(x)[1])
        cells = sum(c.volume * float(energy(c.law, c.deformation(y))[0]) for c in self.cells)
        return 0.5 * float(y @ self.stiffness @ y) + cells

    def response(self, x: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return elastic force (m, 3) [N] and stiffness of a step (3m, 3m) [N/m]."""
        theta, gradient = self.effective_gradient(x)
        rotation, z, y = self._strain(x, gradient)
        stretch = z.T @ gradient
        twist = smallest_eigenvalue(np.trace(stretch) * np.eye(3) - stretch)
        h = gradient.copy()
        shows = self.fallback.parents if self.fallback else None  # so many points, the first ones, show how it turns
        soft = theta * SOFT_TWIST + (1 - theta) * SOFT_TWIST_APART
        h[:shows] += max(0.0, soft - twist) / soft * shape_gradient(z[:shows])
        stack = cross_stack(z)
        row = cross_stack(-h).reshape(-1, 3, 3).transpose(1, 0, 2).reshape(3, -1)
        inverse = np.linalg.pinv(row @ stack, rcond=SINGULAR)  # points on a line can turn about it unseen
        projection = np.eye(x.size) - stack @ inverse @ row
        turn = np.kron(np.eye(len(x)), rotation)
        stiffness, slope = self.stiffness, self.stiffness @ y
        for cell in self.cells:
            F = cell.deformation(y)
            slope = slope + cell.volume * cell.slope.T @ stress(cell.law, F).ravel()
            stiffness = stiffness + cell.volume * cell.slope.T @ projected_hessian(cell.law, F)[0] @ cell.slope
        force = -turn @ projection.T @ slope
        return force.reshape(-1, 3), (2 - theta) * turn @ projection.T @ stiffness @ projection @ turn.T

    def _strain(
        self, x: NDArray[np.float64], gradient: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """R (3, 3), z (m, 3) and y (3m,), both centred, for g."""
        rotation = closest_rotation(x.T @ gradient)
        z = (x - x.mean(axis=0)) @ rotation
        return rotation, z, (z - (self.rest - self.rest.mean(axis=0))).ravel()
