"""What `build` lets one choose from, by name, listed once: for its arguments and those of the command line."""

from __future__ import annotations

from typing import Literal, get_args

Law = Literal["green_lagrange", "neo_hookean", "mooney_rivlin", "arruda_boyce"]

FRAME_TYPES = ("affine", "quadratic", "rigid", "point")
METHODS = WHOLE_BODY, PAPER = "whole_body", "paper"
METRICS = EVEN, COMPLIANCE = "even", "compliance"  # geodesic distance within the body, and the paper's (5)
WEIGHTS = VORONOI, HARMONIC, LINEAR = "voronoi", "harmonic", "linear"
COROTATIONAL = "corotational"  # the linear law, Hooke's about a rotation
LAWS: tuple[Law, ...] = get_args(Law)  # those for large strains
MASSES = LUMPED, CONSISTENT = "lumped", "consistent"
MODES = IMPLICIT, EXPLICIT = "implicit", "explicit"
