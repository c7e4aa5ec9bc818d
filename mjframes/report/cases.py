"""What is compared: volumes, what holds them, what pulls at them, and where the frames of each are.

Loads are forces on voxels, so that finite elements, frames and flex take the same ones; their size is chosen so that the
linear solution moves by `amplitude` times the body's length. "Held" are whole voxels.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mjframes.grid import Grid, voxel_grid
from mjframes.material import Material
from mjframes.volume import Volume

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SMALL = 1e-3  # [-] displacement by length in linear cases: quadratic terms are then below the errors looked for
DENSITY = 1000.0  # [kg/m³]


@dataclass(frozen=True, eq=False)
class Case:
    """One load on one volume.

    fixed: (nx, ny, nz) voxels that do not move.  load: (n, 3) direction and relative size of the force on each voxel.
    goal: (n, 3) the quantity of interest is Σ goal · u, a mean displacement.  places: f → (f, 3) where f free frames
    go [m], or None where `build` places them.  frames: numbers of free frames.  heterogeneous: several stiffnesses.
    straight: whether the frames lie one after the other along an axis (weights="linear").
    amplitude: displacement by length.  nonlinear: compared with geometrically nonlinear finite elements.
    figure: of the paper, if it is from there.
    """

    name: str
    title: str
    volume: Volume
    fixed: Mask
    load: Array
    goal: Array
    frames: tuple[int, ...]
    places: Callable[[int], Array] | None = None
    heterogeneous: bool = False
    straight: bool = False
    amplitude: float = SMALL
    nonlinear: bool = False

    @cached_property
    def grid(self) -> Grid:
        return voxel_grid(self.volume)

    @cached_property
    def held(self) -> Mask:
        """(n,) which voxels inside are fixed, with the whole of rigid pieces that are."""
        held = self.fixed[tuple(self.grid.index.T)]
        return held | ((self.grid.piece >= 0) & np.isin(self.grid.piece, self.grid.piece[held]))

    @property
    def length(self) -> float:
        """[m] of the longest edge of the bounding box."""
        return float(np.max(np.ptp(self.grid.index, axis=0) * self.grid.spacing))

    def quantity(self, moved: Array) -> float:
        """The quantity of interest [m] of displacements (n, 3)."""
        return float(np.sum(self.goal * moved))


def _along(volume: Volume, axis: int, fixed: int = 1) -> tuple[Mask, Array, Array]:
    """Fixed first layers along an axis; (n,) position in voxels along it, and (n,) whether a voxel is in the last."""
    index = voxel_grid(volume).index
    mask = np.zeros(volume.labels.shape, bool)
    mask[(slice(None),) * axis + (slice(fixed),)] = True
    return mask, index[:, axis].astype(float), index[:, axis] == index[:, axis].max()


def _mean(where: Array, direction: int) -> Array:
    goal = np.zeros((len(where), 3))
    goal[where, direction] = 1 / where.sum()
    return goal


def _pull(where: Array, young: Array, direction: int, sign: float = 1.0) -> Array:
    """A pull on an end in proportion to its stiffness: without it soft layers would be torn out of stiff ones."""
    load = np.zeros((len(where), 3))
    load[where, direction] = sign * young[where]
    return load


def _row(volume: Volume, axis: int = 0) -> Callable[[int], Array]:
    """f frames evenly along an axis, after a fixed first layer, the last in the last layer, in the cross section's middle."""
    shape, step = np.array(volume.labels.shape), volume.spacing

    def places(frames: int) -> Array:
        at = np.tile(shape * step / 2, (frames, 1))
        at[:, axis] = (np.arange(1, frames + 1) / frames * (shape[axis] - 1) + 0.5) * step[axis]
        return at

    return places


def bar(
    name: str,
    title: str,
    load: str,
    *,
    across: int,
    poisson: float = 0.3,
    core: float | None = None,
    length: int = 4,
    frames: tuple[int, ...] = (1, 2, 4, 8),
    amplitude: float = SMALL,
) -> Case:
    """0.1 m thick, `length` times as long, held at one end; load: weight, pull, twist.  core: how much stiffer it is."""
    labels = np.ones((length * across + 1, across, across), np.uint8)
    materials = {1: Material(1e6, poisson, DENSITY)}
    if core is not None:
        inside = slice(across // 4, across - across // 4)
        labels[:, inside, inside] = 2
        materials[2] = Material(1e6 * core, poisson, DENSITY)
    volume = Volume.from_labels(labels, 0.1 / across, materials)
    grid = voxel_grid(volume)
    fixed, _, end = _along(volume, 0)
    force, goal = _bar_load(grid, load, end)
    return Case(
        name, title, volume, fixed, force, goal, frames, _row(volume), core is not None, True, amplitude,
        amplitude > 10 * SMALL,
    )  # fmt: skip


def _bar_load(grid: Grid, load: str, end: Mask) -> tuple[Array, Array]:
    if load == "weight":
        down = np.zeros((len(end), 3))
        down[:, 2] = -grid.density
        return down, -_mean(end, 2)
    if load == "pull":
        return _pull(end, grid.young, 0), _mean(end, 0)
    arm = grid.centers - grid.centers[end].mean(axis=0)
    turn = np.column_stack([np.zeros(len(arm)), -arm[:, 2], arm[:, 1]]) * end[:, None]
    return turn * grid.young[:, None], turn / np.sum(turn**2)


def cases(quick: bool) -> list[Case]:
    """All, or a few small ones."""
    across = 8 if quick else 12
    chosen = [
        bar("cantilever", "cantilever under its weight, ν = 0.3 (Figure 8)", "weight", across=across),
    ]
    return chosen
