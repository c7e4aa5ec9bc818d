"""Hertz's force of a rigid ball on an elastic body, and where it holds.

    F = 4/3 E* √R δ^1.5,  E* = E / (1 − ν²),  1/R = 1/R_ball + κ

κ is the mean curvature of the surface, positive where it bulges towards the ball. The contact area has the radius
a = √(R δ). The body is taken as a half-space of one material without friction, and strains as small.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SMALL = 0.3  # [-] a / R: beyond it a sphere is no paraboloid
THICK = 10.0  # [a] a half-space has nothing else nearer: at 10 a its floor adds about a tenth


@dataclass(frozen=True)
class Ground:
    """What the ball is pressed into.

    young [Pa], poisson: of the material at the surface.  materials: how many the body has.
    curvature: of the surface [1/m].  slope: of the surface to the ball's path [-].  size: smallest extent [m].
    """

    young: float
    poisson: float
    materials: int
    curvature: float
    slope: float
    size: float

    def radius(self, ball: float) -> float:
        """Return R [m], infinite or negative in a hollow as narrow as the ball."""
        inverse = 1 / ball + self.curvature
        return 1 / inverse if inverse else np.inf


def hertz_force(depth: Array, ball: float, ground: Ground) -> Array:
    """Return F [N] at depths δ [m] for a ball of this radius [m]."""
    return 4 / 3 * ground.young / (1 - ground.poisson**2) * np.sqrt(ground.radius(ball)) * np.maximum(depth, 0) ** 1.5


def where_it_fails(depth: float, ball: float, ground: Ground) -> list[str]:
    """Return what of Hertz's assumptions does not hold at a depth [m], a clause each."""
    radius = ground.radius(ball)
    contact = np.sqrt(radius * depth)
    found = []
    if contact > SMALL * ball:
        found.append(f"the contact's radius of {1e3 * contact:.3g} mm is more than {SMALL:g} of the ball's")
    if ground.size < THICK * contact:
        found.append(f"the body is only {ground.size / contact:.2g} contact radii thick, which stiffens it")
    if ground.materials > 1:
        found.append(f"the body has {ground.materials} materials that deform")
    if ground.slope > SMALL:
        found.append(f"the surface is inclined by {np.degrees(np.arctan(ground.slope)):.0f}° to the ball's path")
    return found
