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
    """A soft body does what no real one would; the warning says what helps."""


def warn(sentence: str) -> None:
    """Warn that a soft body does what the sentence says, with what helps."""
    warnings.warn(f"soft body {sentence}; {HELP}.", InstabilityWarning, stacklevel=2)


def warn_inside(first: str, second: str, depth: float, when: str) -> None:
    """Warn that two soft bodies are so deep in each other [m], with what helps."""
    warnings.warn(
        f"the soft bodies {first!r} and {second!r} are {1000 * depth:.2g} mm inside each other {when}; start them "
        "farther apart or slower, or give both mf.Contact(solref=(s, 1)) with a shorter s, of two timesteps or more.",
        InstabilityWarning,
        stacklevel=2,
    )


def warn_shared(first: str, second: str, share: float) -> None:
    """Warn that two soft bodies start in the same place, for a share [-] of the smaller one's volume."""
    warnings.warn(
        f"the soft bodies {first!r} and {second!r} start inside each other: {share:.0%} of the smaller one is in both. "
        "Contacts cannot push them apart from there; start them farther apart.",
        InstabilityWarning,
        stacklevel=2,
    )


def spread(mass: Array, x: Array) -> float:
    """Return the root mean square distance of masses (k,) at x (k, 3) from their centre."""
    share = mass / mass.sum()
    return float(np.sqrt(share @ ((x - share @ x) ** 2).sum(axis=1)))
