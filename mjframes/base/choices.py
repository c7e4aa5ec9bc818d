"""What `build` lets one choose from by name, listed once: stages, errors, the command line and the docs read it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class FrameType:
    """A kind of frame.

    freedom: its degrees of freedom.
    points: its control points, as many as monomials of its order.
    voxels: it needs so many, as fewer do not tell its motions apart.
    """

    freedom: int
    points: int
    voxels: int


FRAME_TYPES = {
    "affine": FrameType(freedom=12, points=4, voxels=3),
    "quadratic": FrameType(freedom=30, points=10, voxels=5),
    "rigid": FrameType(freedom=6, points=4, voxels=3),
    "point": FrameType(freedom=3, points=1, voxels=2),
}
METHODS = WHOLE_BODY, PAPER = "whole_body", "paper"
METRICS = EVEN, COMPLIANCE = "even", "compliance"  # geodesic distance within the body, and the paper's (5)
COROTATIONAL = "corotational"  # the linear law, Hooke's about a rotation
MASSES = LUMPED, CONSISTENT = "lumped", "consistent"
MODES = IMPLICIT, EXPLICIT = "implicit", "explicit"
