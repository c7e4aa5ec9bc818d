"""What no real soft body does: sizes far beyond that at rest, regions that are folded over; and the warning of it."""

from __future__ import annotations

import warnings

import numpy as np
from numpy.typing import NDArray

from mjframes.base.errors import Notice

Array = NDArray[np.float64]

GROWN = 1.5  # [-] of the size at rest
HELP = "try a smaller timestep, damping, more or other frames, or another law"


class InstabilityWarning(Notice):
    """One sentence on what a simulated soft body does that no real one would, and on what helps."""


def warn(sentence: str) -> None:
    """Warn that a soft body does what the sentence says, with what helps."""
    warnings.warn(f"soft body {sentence}; {HELP}.", InstabilityWarning, stacklevel=2)


def spread(mass: Array, x: Array) -> float:
    """Return the root mean square distance of masses (k,) at x (k, 3) from their centre."""
    share = mass / mass.sum()
    return float(np.sqrt(share @ ((x - share @ x) ** 2).sum(axis=1)))
