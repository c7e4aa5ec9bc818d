"""Pieces of a volume that bodies of the scene hold: boundary conditions, exact as weights interpolate (§3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from mjframes.errors import MjframesError
from mjframes.grid import Grid

Piece = TypeVar("Piece", "Fixed", "Attached")
PARENT = ""  # as the name of a link: the body that the soft body is attached to


@dataclass(frozen=True, eq=False)
class Fixed:
    """The voxels inside the volume where `mask` (nx, ny, nz) holds; they stand still in the parent body."""

    mask: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Attached:
    """The voxels inside the volume where `mask` (nx, ny, nz) holds; they move with the scene's body `link`."""

    link: str
    mask: NDArray[np.bool_]


def pieces(name: str, given: Piece | Sequence[Piece], kind: type[Piece]) -> list[Piece]:
    """The pieces of one kind, of which one may stand alone.  name: of the argument, for messages."""
    found = list(given) if isinstance(given, (list, tuple)) else [given]
    for piece in found:
        if not isinstance(piece, kind):
            arguments = "mask" if kind is Fixed else '"forearm", mask'
            raise MjframesError(
                f"{name} has a {type(piece).__name__}; give one or more pieces, as [mf.{kind.__name__}({arguments})]."
            )
    return [piece for piece in found if isinstance(piece, kind)]


def held_cores(
    grid: Grid, fixed: Sequence[Fixed], attached: Sequence[Attached]
) -> tuple[tuple[NDArray[np.int64], ...], tuple[str, ...]]:
    """The compact voxel numbers of each piece, with the whole of every rigid piece that it touches, and its link.

    Raises MjframesError for links without a name, masks of another shape, empty ones, and pieces that overlap.
    """
    cores = []
    taken = np.zeros(len(grid.index), bool)
    pieces = [(f"fixed[{i}]", piece.mask) for i, piece in enumerate(fixed)]
    pieces += [(f"attached[{i}]", piece.mask) for i, piece in enumerate(attached)]
    for number, piece in enumerate(attached):
        if not isinstance(piece.link, str) or not piece.link:
            raise MjframesError(f"attached[{number}] has the link {piece.link!r}; give the name of a body.")
    for name, given in pieces:
        mask = np.asarray(given)
        if mask.shape != grid.lookup.shape or mask.dtype != bool:
            raise MjframesError(
                f"{name} has a mask of shape {mask.shape} and type {mask.dtype}; "
                f"it must be boolean over the volume's {grid.lookup.shape} voxels."
            )
        chosen = mask[tuple(grid.index.T)]
        chosen |= (grid.piece >= 0) & np.isin(grid.piece, grid.piece[chosen])
        if not chosen.any():
            raise MjframesError(f"{name} has a mask with no voxel inside the volume; it must have one or more.")
        if (chosen & taken).any():
            raise MjframesError(f"{name} overlaps an earlier piece; a voxel or rigid piece can be in one only.")
        taken |= chosen
        cores.append(np.flatnonzero(chosen))
    return tuple(cores), tuple(PARENT for _ in fixed) + tuple(piece.link for piece in attached)
