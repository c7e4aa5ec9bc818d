"""Pieces of a volume that bodies of the scene hold: boundary conditions, exact as weights interpolate (§3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mjframes.base.errors import MjframesError

if TYPE_CHECKING:
    from mjframes.volume.grid import Grid

MOST_THIN = 0.5  # [-] of the free voxels, that may be a layer of one over what is held
PARENT = ""  # as the name of a link: the body that the soft body is attached to


@dataclass(frozen=True, eq=False)
class Fixed:
    """Voxels that stand still in the body that the soft body is attached to.

    Parameters
    ----------
    mask
        Array (nx, ny, nz) of the volume's shape, true for the voxels that are held. Voxels outside the volume do not
        count. `Volume.side`, `Volume.in_box`, `Volume.with_label` and `mjframes.near` make such masks.
    """

    mask: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Attached:
    """Voxels that move with a named body of the scene.

    Parameters
    ----------
    link
        Name of the body of the scene.
    mask
        Array (nx, ny, nz) of the volume's shape, true for the voxels that move with it, as for `Fixed`.
    """

    link: str
    mask: NDArray[np.bool_]


Support = Fixed | Attached


def supports_of(given: Support | Sequence[Support]) -> tuple[Support, ...]:
    """Return the pieces, of which one may stand alone. Raise MjframesError for anything else."""
    found: list[Support] = []
    for number, piece in enumerate(given if isinstance(given, (list, tuple)) else [given]):
        if not isinstance(piece, (Fixed, Attached)):
            raise MjframesError(
                f"supports has a {type(piece).__name__}; give one or more pieces, as [mf.Fixed(mask), "
                'mf.Attached("forearm", mask)].'
            )
        if isinstance(piece, Attached) and not (isinstance(piece.link, str) and piece.link):
            raise MjframesError(f"supports[{number}] has the link {piece.link!r}; give the name of a body.")
        found.append(piece)
    return tuple(found)


def held_cores(grid: Grid, supports: Sequence[Support]) -> tuple[tuple[NDArray[np.int64], ...], tuple[str, ...]]:
    """Return the voxels of each piece, with the whole of every rigid piece that it touches, and its link.

    Raise MjframesError for masks of another shape, empty ones, pieces that overlap, and those that leave little more
    free than layers of one voxel.
    """
    cores = []
    taken = np.zeros(len(grid.index), bool)
    for number, piece in enumerate(supports):
        name, mask = f"supports[{number}]", np.asarray(piece.mask)
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
    if taken.any() and (thin := _thin(grid, taken)) > MOST_THIN:
        raise MjframesError(
            f"supports leave a layer of one voxel free in {thin:.0%} of the flesh, and frames cannot say how it shears;"
            f" take a spacing of {grid.spacing.min() / 2:g} m or less, or hold fewer voxels."
        )
    return tuple(cores), tuple(PARENT if isinstance(piece, Fixed) else piece.link for piece in supports)


def _thin(grid: Grid, held: NDArray[np.bool_]) -> float:
    """Which share of the free voxels is a layer of one: beyond it, away from what is held, nothing is free."""
    holds, free = np.append(held, False), np.append(~held, False)  # outside, number −1, is neither
    thin = np.zeros(len(held), bool)
    for step in (*np.eye(3, dtype=int), *-np.eye(3, dtype=int)):
        beside, beyond = (grid.beside(way) for way in (step, -step))
        thin |= holds[beside] & ~free[beyond]
    return float(np.mean(thin[~held])) if not held.all() else 0.0
