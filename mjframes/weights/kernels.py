"""Which weights the frames may have: a class each, its fields are its options, and KERNELS has their names.

`build`, its errors, the command line and the documents read KERNELS.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from mjframes.base import texts
from mjframes.base.errors import MjframesError
from mjframes.base.numbers import is_whole
from mjframes.base.options import option

if TYPE_CHECKING:
    from scipy import sparse

    from mjframes.frames.placement import Placement
    from mjframes.volume.grid import Grid

MOST_SUBDIVISIONS = 20  # surfaces every millionth: far beyond any voxel


class Weights(ABC):
    """Weights of the frames, of one kind."""

    @abstractmethod
    def at_voxels(self, grid: Grid, placement: Placement) -> sparse.csr_array:
        """Return the frames' weights at the voxel centres, (n, f) with sorted indices; their rows sum to 1."""


@dataclass(frozen=True)
class Voronoi(Weights):
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

    def __post_init__(self) -> None:
        times = self.subdivisions
        if not is_whole(times) or not 1 <= times <= MOST_SUBDIVISIONS:
            raise MjframesError(f"subdivisions is {times!r}; it must be an integer from 1 to {MOST_SUBDIVISIONS}.")

    def at_voxels(self, grid: Grid, placement: Placement) -> sparse.csr_array:
        """Return the frames' weights at the voxel centres (n, f)."""
        from mjframes.weights.voronoi import voronoi_weights

        return voronoi_weights(grid, placement, int(self.subdivisions))


@dataclass(frozen=True)
class Harmonic(Weights):
    """Potentials as weights of the frames.

    A weight is 1 at the frame's own seed and 0 at the seeds of others. Stiffer material conducts it better.
    """

    def at_voxels(self, grid: Grid, placement: Placement) -> sparse.csr_array:
        """Return the frames' weights at the voxel centres (n, f)."""
        from mjframes.weights.harmonic import harmonic_weights

        return harmonic_weights(grid, placement)


@dataclass(frozen=True)
class Linear(Weights):
    """Hat functions along one axis as weights of the frames.

    Parameters
    ----------
    axis
        Index axis of the hats, 0 to 2. The default is the one along which the frames extend most.
    """

    axis: int | None = field(
        default=None, metadata=option("index axis of the hats, that of the frames' largest extent unless given")
    )

    def at_voxels(self, grid: Grid, placement: Placement) -> sparse.csr_array:
        """Return the frames' weights at the voxel centres (n, f). Raise MjframesError as `linear_weights` does."""
        from mjframes.weights.linear import linear_weights

        return linear_weights(grid, placement, self.axis)


VORONOI = "voronoi"
KERNELS: dict[str, type[Weights]] = {VORONOI: Voronoi, "harmonic": Harmonic, "linear": Linear}


def weights_of(given: str | Weights) -> Weights:
    """Return the weights of a name, or those that are given. Raise MjframesError for anything else."""
    weights = KERNELS[given]() if isinstance(given, str) and given in KERNELS else given
    if not isinstance(weights, Weights):
        names = ", ".join(map(repr, KERNELS))
        raise MjframesError(f"weights is {given!r}; it must be one of {names}, or as mf.Voronoi(subdivisions=2).")
    return weights
