"""Corotational elasticity of a region, written as its equations (the paper, §5.2, with the exact rotation gradient).

    y_j = Rᵀ x_j − x̄_j          R: the proper rotation closest to F = Σ_j x_j ḡ_jᵀ
    W   = ½ yᵀ K_e y             energy [J]
    f   = −R Pᵀ K_e y            force [N], the exact −∂W/∂x while R is well determined (λ = 0)
    K   = R Pᵀ K_e P Rᵀ          Gauss–Newton stiffness [N/m], positive semi-definite

The plugin computes the same inside `mj_step`; this module is what the views read and what the plugin is tested against.
Shapes: x, rest, gradient (m, 3); K_e (3m, 3m), degrees of freedom point by point.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

TINY = 1e-15  # [m²] of a region that one point moves
SINGULAR = 1e-8  # [-] of A Z
SOFT_TWIST = 0.1  # [-] h_min below which a rotation fitted to the shape takes over; 2 at rest (plugin/corotational.cc)


def closest_rotation(deformation: NDArray[np.float64]) -> NDArray[np.float64]:
    """R (3, 3) in SO(3) that maximises tr(Rᵀ F), for F (3, 3): inverted shapes flip their thinnest direction."""
    u, _, vt = np.linalg.svd(deformation)
    u[:, 2] *= np.sign(np.linalg.det(u) * np.linalg.det(vt))
    return u @ vt


def cross_stack(z: NDArray[np.float64]) -> NDArray[np.float64]:
    """Z (3m, 3) with (Z a)_j = a × z_j, for z (m, 3)."""
    stack = np.zeros((len(z), 3, 3))
    stack[:, 0, 1], stack[:, 0, 2] = z[:, 2], -z[:, 1]
    stack[:, 1, 0], stack[:, 1, 2] = -z[:, 2], z[:, 0]
    stack[:, 2, 0], stack[:, 2, 1] = z[:, 1], -z[:, 0]
    return stack.reshape(-1, 3)


def _strain(x, rest, gradient):
    rotation = closest_rotation(x.T @ gradient)
    z = (x - x.mean(axis=0)) @ rotation
    return rotation, z, (z - (rest - rest.mean(axis=0))).ravel()


def region_energy(
    x: NDArray[np.float64], rest: NDArray[np.float64], gradient: NDArray[np.float64], stiffness: NDArray[np.float64]
) -> float:
    """Elastic energy ½ yᵀ K_e y [J] of one region."""
    _, _, y = _strain(x, rest, gradient)
    return 0.5 * float(y @ stiffness @ y)


def region_response(
    x: NDArray[np.float64], rest: NDArray[np.float64], gradient: NDArray[np.float64], stiffness: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Elastic force (m, 3) [N] and stiffness (3m, 3m) [N/m] of one region."""
    rotation, z, y = _strain(x, rest, gradient)
    stretch = z.T @ gradient
    stretch = 0.5 * (stretch + stretch.T)
    twist = np.linalg.eigvalsh(np.trace(stretch) * np.eye(3) - stretch)[0]
    fade = max(0.0, SOFT_TWIST - twist) / SOFT_TWIST
    extent = max(((rest - rest.mean(axis=0)) ** 2).sum(), TINY)
    stack = cross_stack(z)
    row = (cross_stack(-(gradient + 2 * fade / extent * z))).reshape(-1, 3, 3).transpose(1, 0, 2).reshape(3, -1)
    inverse = np.linalg.pinv(row @ stack, rcond=SINGULAR)  # points on a line can turn about it unseen
    projection = np.eye(x.size) - stack @ inverse @ row
    turn = np.kron(np.eye(len(x)), rotation)
    force = -turn @ projection.T @ stiffness @ y
    return force.reshape(-1, 3), turn @ projection.T @ stiffness @ projection @ turn.T


@dataclass(frozen=True, eq=False)
class CorotationalRegion:
    """points: (m,) its control points.  rest: x̄ (m, 3) [m].  gradient: ḡ (m, 3) [1/m].  stiffness: K_e [N/m]."""

    points: NDArray[np.int64]
    rest: NDArray[np.float64]
    gradient: NDArray[np.float64]
    stiffness: NDArray[np.float64]

    def energy(self, x: NDArray[np.float64]) -> float:
        """[J] with the region's control points at x (m, 3) [m]."""
        return region_energy(x, self.rest, self.gradient, self.stiffness)

    def response(self, x: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Elastic force (m, 3) [N] and stiffness (3m, 3m) [N/m]."""
        return region_response(x, self.rest, self.gradient, self.stiffness)
