"""Corotational elasticity of a region, written as its equations (the paper, §5.2, with the rotation of least energy).

    W   = min over R of ½ yᵀ K_e y + κ/2 |skew Rᵀ F|²,   y_j = Rᵀ x_j − x̄_j,   F = Σ_j x_j ḡ_jᵀ
    f   = −R w,   w = ∂W/∂y               force [N], the exact −∂W/∂x
    K   = R Pᵀ H P Rᵀ                     stiffness of a step [N/m], positive semi-definite
    P   = 1 − Z Ω,   Ω = C⁻¹ (H Z − [a × w_j])ᵀ

κ makes R well determined: K_e at rest does not know it. H = ∂²W/∂y² at fixed R, (Z a)_j = a × z_j, Ω tells how R turns
as the points move and C is the curvature of W in such turns. Where C is far from Zᵀ H Z, R may be about to jump: then
Ω = (Zᵀ H Z)⁻¹ Zᵀ H, as with a hyperelastic law, and K is twice that. As the least of smooth functions of x, W is
continuous, and has the gradient of the least one.

Hooke's law in turning axes gets no stiffer where it is pressed, and loses its resistance to shear. So W of the whole
body's regions has the energy of pressed.py as well, ψ(E y), and H has Eᵀ (∂²ψ/∂ε²) E.

A hyperelastic law takes its share of the energy, in cells q of the region (`whole_body.cells`); K_e is what remains:

    ½ yᵀ K_e y + Σ_q V_q ψ(F_q),   F_q = I + E_q y      in place of ½ yᵀ K_e y

The plugin computes the same inside `mj_step`; this module is what the views read and what the plugin is tested against.
Shapes: x, rest, gradient (m, 3); K_e (3m, 3m), y (3m,), E_q (9, 3m), degrees of freedom point by point.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mjframes.elasticity.laws import LawParameters, energy, hessian, projected_hessian, stress
from mjframes.elasticity.pressed import PressedCell, UniformResponse

# each as in plugin/, where they are explained
FOLDED = 0.4  # [-] eigenvalue of sym Rᵀ F below which rotations farther away are tried
TWIST_FIRMNESS = 3.0  # [-] of κ, to the mean stiffness against shear
SHOWN = 1e-3  # [-] by which the gradient at rest may miss the identity
STEPS, HALVINGS = 60, 30  # of Newton's method for R
SURE, CLOSE = 1e-5, 1e-9  # [rad] a shorter step is not checked, or ends it
DESCENT = 1e-4  # [-] of the expected descent that a step has to find
TRUST = 0.7  # [rad] longest step
SURE_TURN = 2.0  # [-] of C, to Zᵀ H Z, and the other way round
UNSURE_STEP = 2.0  # [-] of K, where C is not so
SINGULAR = 1e-8  # [-] of Zᵀ H Z

CROSS = np.array(
    [[[0, 0, 0], [0, 0, -1], [0, 1, 0]], [[0, 0, 1], [0, 0, 0], [-1, 0, 0]], [[0, -1, 0], [1, 0, 0], [0, 0, 0]]]
)
FLIPS = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
TETRAHEDRON = [flip[:, None] * np.roll(np.eye(3), shift, axis=1) for shift in range(3) for flip in FLIPS]  # its turns


def closest_rotation(deformation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return R (3, 3) in SO(3) that maximises tr(Rᵀ F), for F (3, 3): inverted shapes flip their thinnest direction."""
    u, _, vt = np.linalg.svd(deformation)
    u[:, 2] *= np.sign(np.linalg.det(u) * np.linalg.det(vt))
    return u @ vt


def cross_stack(z: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return Z (3m, 3) with (Z a)_j = a × z_j, for z (m, 3)."""
    return np.einsum("cab,jb->jac", CROSS, z).reshape(-1, 3)


def turned(rotation: NDArray[np.float64], turn: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return R turned by a (3,) [rad] in its own axes, by Cayley's map."""
    q = 0.5 * (turn @ CROSS.reshape(3, 9)).reshape(3, 3)
    return rotation @ (np.eye(3) + 2 / (1 + 0.25 * turn @ turn) * (q + q @ q))


def stress_twist(moments: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return what a stress adds to the curvature (3, 3) of W in turns, from Σ_j z_j w_jᵀ (3, 3)."""
    return 0.5 * (moments + moments.T) - np.trace(moments) * np.eye(3)


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
class _Turn:
    """W of a region, but for a constant, as a function of a turn D = 1 + Δ of z = Rᵀ x: y = y₀ + Δᵀ z.

    curvature, slope: A (9, 9) and b (9,) of the quadratic part ½ Δ·A Δ + b·Δ [J].
    cells: with F (3, 3) before the turn, and how Δ changes it (9, 9).
    pressed: with ε (6,) before the turn, and how Δ changes it (6, 9).
    """

    curvature: NDArray[np.float64]
    slope: NDArray[np.float64]
    cells: list[tuple[LawCell, NDArray[np.float64], NDArray[np.float64]]]
    pressed: tuple[PressedCell, NDArray[np.float64], NDArray[np.float64]]

    def at(self, D: NDArray[np.float64]) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
        """Return W [J], and its slope (3,) and curvature (3, 3) in a for turns D exp([a]×)."""
        delta = (D - np.eye(3)).ravel()
        slope = self.curvature @ delta
        total = float(delta @ (0.5 * slope + self.slope))
        slope = slope + self.slope
        columns = (D @ CROSS).reshape(3, 9).T
        twist = columns.T @ self.curvature @ columns
        for cell, before, by_turn in self.cells:
            F = before[None] + (by_turn @ delta).reshape(1, 3, 3)
            total += cell.volume * float(energy(cell.law, F)[0])
            slope = slope + cell.volume * by_turn.T @ stress(cell.law, F).ravel()
            change = by_turn @ columns
            twist = twist + cell.volume * change.T @ projected_hessian(cell.law, F)[0] @ change
        cell, strain, by_turn = self.pressed
        value, P, H = cell.at(strain + by_turn @ delta)
        change = by_turn @ columns
        total, slope, twist = total + value, slope + by_turn.T @ P, twist + change.T @ H @ change
        return total, columns.T @ slope, twist + stress_twist(D.T @ slope.reshape(3, 3))

    def descend(self, D: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        """Return the least W [J] that Newton's method finds from D, and where it is."""
        total, slope, twist = self.at(D)
        for _ in range(STEPS):
            value, axes = np.linalg.eigh(twist)
            size = np.maximum(np.abs(value), 1e-6 * np.abs(value).max() + 1e-300)
            turn = -axes @ (axes.T @ slope / size)
            length = float(np.linalg.norm(turn))
            turn *= min(1.0, TRUST / max(length, 1e-300))
            after = turned(D, turn)
            found = self.at(after)
            for _ in range(HALVINGS):
                if length < SURE or found[0] <= total + DESCENT * turn @ slope:
                    break
                turn *= 0.5
                after = turned(D, turn)
                found = self.at(after)
            D, (total, slope, twist) = after, found
            if length < CLOSE:
                break
        return total, D


@dataclass(frozen=True, eq=False)
class CorotationalRegion:
    """A region with corotational elasticity.

    points: (m,) its control points.
    rest: x̄ (m, 3) [m].
    gradient: ḡ (m, 3) [1/m].
    stiffness: K_e [N/m].
    cells: of a hyperelastic law, of which K_e is what remains.
    stiffens: whether it gets stiffer where it is pressed; the paper's regions do not.
    """

    points: NDArray[np.int64]
    rest: NDArray[np.float64]
    gradient: NDArray[np.float64]
    stiffness: NDArray[np.float64]
    cells: tuple[LawCell, ...] = ()
    stiffens: bool = False

    @cached_property
    def solid(self) -> bool:
        """Return whether ḡ shows all of F: the points do not lie in a plane at rest."""
        return bool(np.abs(self._centred(self.rest).T @ self.gradient - np.eye(3)).max() < SHOWN)

    @cached_property
    def uniform(self) -> UniformResponse:
        """Return what K_e answers to uniform strains."""
        return UniformResponse.of(self.rest, self.stiffness)

    @cached_property
    def shear(self) -> float:
        """Return the mean stiffness against shear [J], of which κ is a multiple."""
        cells = sum(2 * c.volume * float(hessian(c.law, np.eye(3)[None])[0][1, 1]) for c in self.cells)
        return self.uniform.shear + cells

    @cached_property
    def firm(self) -> NDArray[np.float64]:
        """Return K_e with what κ adds (3m, 3m) [N/m]."""
        g = self.gradient
        skew = np.einsum("jc,kc,ab->jakb", g, g, np.eye(3)) - np.einsum("jb,ka->jakb", g, g)
        return self.stiffness + 0.5 * TWIST_FIRMNESS * self.shear * skew.reshape(self.stiffness.shape)

    @cached_property
    def pressed(self) -> PressedCell:
        """Return how the region is where it is pressed, without ψ where it has none or F is not known."""
        return PressedCell.of(self.uniform) if self.stiffens and self.solid else PressedCell.none(self.rest.size)

    def rotation(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return R (3, 3), the rotation of least energy."""
        x = self._centred(x)
        start = closest_rotation(x.T @ self.gradient)
        turn = self._turn(x @ start)
        least, best = turn.descend(np.eye(3))
        S = (start @ best).T @ x.T @ self.gradient
        if not self.solid or np.linalg.eigvalsh(S + S.T)[0] < 2 * FOLDED:
            for some in TETRAHEDRON[1:]:
                found, rotation = turn.descend(some)
                if found < least:
                    least, best = found, rotation
        return start @ best

    def spin(self, x: NDArray[np.float64], rotation: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return Ω (3, m, 3) [1/m]: dR/dt = R [ω]× with ω = Σ_j Ω_j v_j, of points at x (m, 3) [m] and velocities v_j.

        rotation: R there.
        The torque Zᵀ ∂W/∂y stays zero: with w = ∂W/∂y, z = Rᵀx and u = Rᵀv, (Zᵀ H Z + T) ω = Zᵀ H u + Σ_j u_j × w_j.
        """
        z = self._centred(x) @ rotation
        _, slope, curvature = self._energy(z)
        stack, w = cross_stack(z), slope.reshape(-1, 3)
        moment = (stack.T @ curvature).reshape(3, -1, 3) + np.einsum("iab,ja->ijb", CROSS, w)
        moment -= moment.mean(axis=1, keepdims=True)  # v less its mean
        twist = stack.T @ curvature @ stack + stress_twist(z.T @ w)
        return np.tensordot(np.linalg.pinv(twist, rcond=SINGULAR, hermitian=True), moment @ rotation.T, 1)

    def energy(self, x: NDArray[np.float64]) -> float:
        """Return W [J]."""
        return self._energy(self._centred(x) @ self.rotation(x))[0]

    def response(self, x: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return elastic force (m, 3) [N] and stiffness of a step (3m, 3m) [N/m]."""
        rotation = self.rotation(x)
        z = self._centred(x) @ rotation
        _, slope, curvature = self._energy(z, projected=True)
        stack = cross_stack(z)
        product = curvature @ stack
        twist = stack.T @ product
        inverse = np.linalg.pinv(twist, rcond=SINGULAR, hermitian=True)
        slope = slope - product @ inverse @ (stack.T @ slope)  # what the search left of a torque
        turning = twist + stress_twist(z.T @ slope.reshape(-1, 3))
        sure = min(np.linalg.eigvalsh(SURE_TURN * a - b)[0] for a, b in ((turning, twist), (twist, turning))) > 0
        if sure and self.solid and not self.cells:
            follow = np.linalg.solve(turning, (product - cross_stack(slope.reshape(-1, 3))).T)
        else:
            follow = inverse @ product.T
        turn = np.kron(np.eye(len(x)), rotation)
        apart = (np.eye(x.size) - stack @ follow) @ turn.T
        firmer = 1.0 if sure or not self.solid else UNSURE_STEP
        return -(turn @ slope).reshape(-1, 3), firmer * apart.T @ curvature @ apart

    def _energy(
        self, z: NDArray[np.float64], projected: bool = False
    ) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
        """W [J] as a function of z = Rᵀ x (m, 3), centred, at fixed R, with its slope (3m,) and curvature (3m, 3m)."""
        y = (z - self._centred(self.rest)).ravel()
        slope, curvature = self.firm @ y, self.firm.copy()
        total = 0.5 * float(y @ slope)
        for cell in self.cells:
            F = cell.deformation(y)
            total += cell.volume * float(energy(cell.law, F)[0])
            slope = slope + cell.volume * cell.slope.T @ stress(cell.law, F).ravel()
            H = (projected_hessian if projected else hessian)(cell.law, F)[0]
            curvature += cell.volume * cell.slope.T @ H @ cell.slope
        value, P, H = self.pressed.at(self.pressed.slope @ y)
        E = self.pressed.slope
        return total + value, slope + E.T @ P, curvature + E.T @ H @ E

    def _turn(self, z: NDArray[np.float64]) -> _Turn:
        """W as a function of how z (m, 3) turns."""
        y = (z - self._centred(self.rest)).ravel()
        lever = np.einsum("jr,ab->jarb", z, np.eye(3)).reshape(y.size, 9)  # y for Δ, entry 3r + a
        product = self.firm @ lever
        return _Turn(
            lever.T @ product,
            product.T @ y,
            [(cell, cell.deformation(y)[0], cell.slope @ lever) for cell in self.cells],
            (self.pressed, self.pressed.slope @ y, self.pressed.slope @ lever),
        )

    @staticmethod
    def _centred(x: NDArray[np.float64]) -> NDArray[np.float64]:
        return x - x.mean(axis=0)
