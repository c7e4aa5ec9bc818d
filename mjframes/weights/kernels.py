"""The weights that one can choose, by name; `weights.py` computes them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from mjframes.base import texts
from mjframes.base.choices import HARMONIC, LINEAR, VORONOI
from mjframes.base.errors import MjframesError
from mjframes.base.options import option

MOST_SUBDIVISIONS = 20  # surfaces every millionth: far beyond any voxel


@dataclass(frozen=True)
class Voronoi:
    """The paper's kernels (§4.3) as weights of the frames.

    Parameters
    ----------
    subdivisions
        How often the intervals between the frames' cells are subdivided, 1 to 20.
    """

    subdivisions: int = field(
        default=1,
        metadata=option("how often the Voronoi kernels are subdivided, 1 to 20", reads=texts.count, metavar="N"),
    )


@dataclass(frozen=True)
class Harmonic:
    """Potentials as weights of the frames.

    A weight is 1 at the frame's own seed and 0 at the seeds of others. Stiffer material conducts it better.
    """


@dataclass(frozen=True)
class Linear:
    """Hat functions along one axis as weights of the frames.

    Parameters
    ----------
    axis
        Index axis of the hats, 0 to 2. The default is the one along which the frames extend most.
    """

    axis: int | None = field(
        default=None, metadata=option("index axis of the hats, that of the frames' largest extent unless given")
    )


Weights = Voronoi | Harmonic | Linear
KERNELS: dict[str, type[Weights]] = {VORONOI: Voronoi, HARMONIC: Harmonic, LINEAR: Linear}


def weights_of(given: str | Weights) -> Weights:
    """Return the weights of a name, or those that are given. Raise MjframesError for anything else."""
    weights = KERNELS[given]() if isinstance(given, str) and given in KERNELS else given
    if not isinstance(weights, Weights):
        names = ", ".join(map(repr, KERNELS))
        raise MjframesError(f"weights is {given!r}; it must be one of {names}, or as mf.Voronoi(subdivisions=2).")
    if isinstance(weights, Voronoi):
        times = weights.subdivisions
        if not isinstance(times, (int, np.integer)) or not 1 <= times <= MOST_SUBDIVISIONS:
            raise MjframesError(f"subdivisions is {times!r}; it must be an integer from 1 to {MOST_SUBDIVISIONS}.")
    return weights
