"""Pieces of a volume that do not move: Dirichlet conditions, which interpolating weights make exact (the paper, §3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mjframes.errors import MjframesError
from mjframes.grid import Grid


@dataclass(frozen=True, eq=False)
class Fixed:
    """The voxels inside the volume where `mask` (nx, ny, nz) holds; they stand still in the parent body."""

    mask: NDArray[np.bool_]


def fixed_cores(grid: Grid, fixed: Sequence[Fixed]) -> tuple[NDArray[np.int64], ...]:
    """The compact voxel numbers of each piece, with the whole of every rigid piece that it touches.

    Raises MjframesError for masks of another shape, empty ones, and pieces that overlap.
    """
    cores = []
    taken = np.zeros(len(grid.index), bool)
    for number, piece in enumerate(fixed):
        mask = np.asarray(piece.mask)
        if mask.shape != grid.lookup.shape or mask.dtype != bool:
            raise MjframesError(
                f"fixed[{number}] has a mask of shape {mask.shape} and type {mask.dtype}; "
                f"it must be boolean over the volume's {grid.lookup.shape} voxels."
            )
        chosen = mask[tuple(grid.index.T)]
        chosen |= (grid.piece >= 0) & np.isin(grid.piece, grid.piece[chosen])
        if not chosen.any():
            raise MjframesError(
                f"fixed[{number}] has a mask with no voxel inside the volume; it must have one or more."
            )
        if (chosen & taken).any():
            raise MjframesError(
                f"fixed[{number}] overlaps an earlier piece; a voxel or rigid piece can be in one only."
            )
        taken |= chosen
        cores.append(np.flatnonzero(chosen))
    return tuple(cores)
