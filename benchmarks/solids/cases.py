"""What is compared: volumes, what holds them, what pulls at them, and where frames placed by hand are.

Loads are forces on voxels, so that finite elements, frames and flex take the same ones; their size is chosen so that
the linear solution moves by `amplitude` times the body's length. "Held" are whole voxels.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mjframes.volume.grid import Grid, voxel_grid
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FRAMES = (3, 5, 10)
LARGE_FRAMES = (2, 4, 8)  # where displacements are large
SMALL = 1e-3  # [-] displacement by length in linear cases: quadratic terms are then below the errors looked for
DENSITY = 1000.0  # [kg/m³]
STEAK = Path(__file__).parents[2] / "models" / "steak.npz"  # in a checkout


@dataclass(frozen=True, eq=False)
class Case:
    """One load on one volume.

    fixed: (nx, ny, nz) voxels that do not move.
    load: (n, 3) direction and relative size of the force on each voxel.
    goal: (n, 3) the quantity of interest is Σ goal · u, a mean displacement.
    places: f → (f, 3) where f free frames go by hand [m], or None where a body has no centre line.
    frames: numbers of free frames.
    heterogeneous: several stiffnesses.
    straight: whether those lie one after the other along an axis.
    amplitude: displacement by length.
    nonlinear: compared with geometrically nonlinear finite elements.
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
        """Return which voxels inside (n,) are fixed, with the whole of rigid pieces that are."""
        held = self.fixed[tuple(self.grid.index.T)]
        return held | ((self.grid.piece >= 0) & np.isin(self.grid.piece, self.grid.piece[held]))

    def quantity(self, moved: Array) -> float:
        """Return the quantity of interest [m] of displacements (n, 3)."""
        return float(np.sum(self.goal * moved))


def _along(volume: Volume, axis: int) -> tuple[Mask, Mask]:
    """The first layer along an axis (nx, ny, nz), and whether a voxel is in the last (n,)."""
    index = voxel_grid(volume).index
    mask = np.zeros(volume.labels.shape, bool)
    mask[(slice(None),) * axis + (0,)] = True
    return mask, index[:, axis] == index[:, axis].max()


def _mean(where: Mask, direction: int) -> Array:
    goal = np.zeros((len(where), 3))
    goal[where, direction] = 1 / where.sum()
    return goal


def _pull(where: Mask, young: Array, direction: int, sign: float = 1.0) -> Array:
    """A pull on an end in proportion to its stiffness: without it soft layers would be torn out of stiff ones."""
    load = np.zeros((len(where), 3))
    load[where, direction] = sign * young[where]
    return load


def _row(volume: Volume, axis: int = 0) -> Callable[[int], Array]:
    """f frames evenly along an axis after a fixed first layer, the last in the last one, in the others' middle."""
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
    core: float | None = None,
    frames: tuple[int, ...] = FRAMES,
    amplitude: float = SMALL,
) -> Case:
    """Return a bar 0.1 m thick, four times as long, held at one end.

    load: weight, pull, twist.  core: its stiffness.
    """
    labels = np.ones((4 * across + 1, across, across), np.uint8)
    materials = {1: Material(1e6, 0.3, DENSITY)}
    if core is not None:
        inside = slice(across // 4, across - across // 4)
        labels[:, inside, inside] = 2
        materials[2] = Material(1e6 * core, 0.3, DENSITY)
    volume = Volume.from_labels(labels, 0.1 / across, materials)
    grid = voxel_grid(volume)
    fixed, end = _along(volume, 0)
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


def plate(name: str, title: str, pull: int, *, fine: int, graded: bool) -> Case:
    """Return figure 7: 10 × 4, one voxel thick, held on one side and pulled on the other, along x (0), or along y (1).

    graded: ten times stiffer at the right than at the left; else even, with a rigid square in the middle.
    """
    size = np.array([10, 4]) * fine
    labels = np.ones((*size, 1), np.uint8)
    if graded:
        bands = 20
        labels[:] = 1 + (np.arange(size[0]) * bands // size[0])[:, None, None]
        young = 1e5 * (1 + 9 * (np.arange(bands) + 0.5) / bands)
        materials = {1 + band: Material(float(e), 0.3, DENSITY) for band, e in enumerate(young)}
    else:
        labels[4 * fine : 6 * fine, fine : 3 * fine] = 2
        materials = {1: Material(1e5, 0.3, DENSITY), 2: Material.rigid(DENSITY)}
    volume = Volume.from_labels(labels, [0.1 / fine, 0.1 / fine, 0.1 / fine], materials)
    fixed, end = _along(volume, pull)
    force = np.zeros((len(end), 3))
    force[end, pull] = 1
    centerline = _row(volume) if pull == 0 else None
    return Case(name, title, volume, fixed, force, _mean(end, pull), FRAMES, centerline, True, centerline is not None)


def three_materials() -> Case:
    """Return figure 5: a bar of three materials, pressed."""
    labels = np.ones((61, 6, 6), np.uint8)
    labels[20:40], labels[40:] = 2, 3
    stiffness = {1: 3e5, 2: 1e5, 3: 1e6}
    volume = Volume.from_labels(labels, 0.01, {k: Material(e, 0.0, DENSITY) for k, e in stiffness.items()})
    fixed, end = _along(volume, 0)
    force = _pull(end, np.ones(len(end)), 0, -1.0)
    return Case(
        "three", "bar of three materials, pressed (Figure 5)", volume, fixed, force, -_mean(end, 0), FRAMES,
        _row(volume), True, True,
    )  # fmt: skip


def block_with_bone(load: str) -> Case:
    """Return a block of 0.3 × 0.1 × 0.1 m; in it, off the middle, a bone ten thousand times stiffer."""
    labels = np.ones((31, 10, 10), np.uint8)
    labels[8:24, 2:6, 5:8] = 2
    volume = Volume.from_labels(labels, 0.01, {1: Material(1e5, 0.3, DENSITY), 2: Material(1e9, 0.3, DENSITY)})
    fixed, end = _along(volume, 0)
    force, goal = _bar_load(voxel_grid(volume), load, end)
    words = {"pull": "pulled", "weight": "under its weight"}[load]
    return Case(
        f"bone_{load}", f"block with a bone 1:10⁴, {words}", volume, fixed, force, goal, FRAMES,
        heterogeneous=True,
    )  # fmt: skip


def sandwich() -> Case:
    """Return layers 1:1000 in turns, sheared: what uniform strains of a region cannot follow."""
    labels = np.ones((13, 12, 12), np.uint8)
    labels[:, :, 3:6] = labels[:, :, 9:] = 2
    volume = Volume.from_labels(labels, 0.01, {1: Material(1e4, 0.3, DENSITY), 2: Material(1e7, 0.3, DENSITY)})
    fixed, end = _along(volume, 2)
    force = _pull(end, np.ones(len(end)), 0)
    return Case(
        "sandwich", "layers 1:1000 in turns, sheared", volume, fixed, force, _mean(end, 0), FRAMES,
        _row(volume, 2), True, True,
    )  # fmt: skip


def cube() -> Case:
    """Return a cube, sheared: held below, pushed sideways above."""
    volume = Volume.from_labels(np.ones((12, 12, 13), np.uint8), 0.01, {1: Material(1e5, 0.3, DENSITY)})
    fixed, end = _along(volume, 2)
    force = _pull(end, np.ones(len(end)), 0)
    return Case("shear", "cube, sheared", volume, fixed, force, _mean(end, 0), FRAMES, _row(volume, 2), straight=True)


def sheet() -> Case:
    """Return a sheet of 0.3 × 0.2 m, 6 mm thick, one voxel: held at one edge, bent by its weight."""
    volume = Volume.from_labels(np.ones((31, 20, 1), np.uint8), [0.01, 0.01, 0.006], {1: Material(1e6, 0.3, DENSITY)})
    fixed, end = _along(volume, 0)
    force, goal = _bar_load(voxel_grid(volume), "weight", end)
    return Case("sheet", "thin sheet under its weight", volume, fixed, force, goal, FRAMES, _row(volume), straight=True)


def rod() -> Case:
    """Return a rod 1 m long, 3 cm thick, three voxels, bent far by its weight."""
    volume = Volume.from_labels(np.ones((101, 3, 3), np.uint8), 0.01, {1: Material(1e7, 0.3, DENSITY)})
    fixed, end = _along(volume, 0)
    force, goal = _bar_load(voxel_grid(volume), "weight", end)
    return Case(
        "rod_large", "slender rod, large displacement", volume, fixed, force, goal, LARGE_FRAMES, _row(volume),
        straight=True, amplitude=0.4, nonlinear=True,
    )  # fmt: skip


def steak(path: Path) -> Case:
    """Return the T-bone steak, held at one end and pulled on one side of the other."""
    volume = Volume.load(path).resample(6000)
    index = voxel_grid(volume).index
    ends = np.quantile(index[:, 0], [0.08, 0.92])
    fixed = np.zeros(volume.labels.shape, bool)
    fixed[: int(ends[0])] = True
    pulled = (index[:, 0] >= ends[1]) & (index[:, 1] < np.median(index[:, 1]))
    force = _pull(pulled, np.ones(len(index)), 0)
    return Case(
        "steak", "steak, pulled on one side", volume, fixed, force, _mean(pulled, 0), FRAMES, heterogeneous=True
    )


def all_cases(quick: bool) -> list[Case]:
    """Return all cases, or the few that the quick report has."""
    fine = 5 if quick else 10
    across = 8 if quick else 12
    cantilever = bar("cantilever", "cantilever, ν = 0.3 (Figure 8)", "weight", across=across)
    rigid = plate("plate_rigid", "plate with a rigid part, pulled along x (Figure 7)", 0, fine=fine, graded=False)
    cored = bar("core", "stiff core in a soft coat, 1:1000, under its weight", "weight", across=8, core=1e3)
    if quick:
        return [cantilever, rigid, cored]
    found = [
        cantilever,
        bar(
            "cantilever_large",
            "cantilever, large displacement",
            "weight",
            across=6,
            amplitude=0.25,
            frames=LARGE_FRAMES,
        ),
        plate("plate_graded", "plate with a stiffness gradient, pulled along it (Figure 7)", 0, fine=fine, graded=True),
        rigid,
        plate("plate_graded_y", "plate with a stiffness gradient, pulled across it", 1, fine=5, graded=True),
        plate("plate_rigid_y", "plate with a rigid part, pulled along y", 1, fine=5, graded=False),
        three_materials(),
        bar("twist", "bar, twisted", "twist", across=8),
        cube(),
        cored,
        bar(
            "core_large",
            "stiff core in a soft coat, large displacement",
            "weight",
            across=6,
            core=1e3,
            amplitude=0.25,
            frames=LARGE_FRAMES,
        ),
        sandwich(),
        block_with_bone("pull"),
        block_with_bone("weight"),
        sheet(),
        rod(),
    ]
    if STEAK.is_file():
        found.append(steak(STEAK))
    return found
