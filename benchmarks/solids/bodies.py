"""Bodies that nobody tuned anything for, what holds them and what loads them: what the report's main table judges.

Loads are their own weight along each axis, forces on an end, and pushes on 1, 5 and 20 % of the surface at a few places
that are far from each other. Loads of a free body are carried by its own inertia.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.solids.cases import DENSITY, STEAK, Array, Mask
from mjframes.base.rigid import motion_basis
from mjframes.volume.grid import Grid, voxel_grid
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

PUSHED = (0.01, 0.05, 0.2)  # [-] of the surface
PLACES = 2  # at which each of them pushes
FACING = 0.3  # [-] least cosine between the normals of a push: it is not on both sides of a plate
STEAK_SPACING = 5e-3  # [m]


@dataclass(frozen=True, eq=False)
class Load:
    """Forces on voxels.

    kind: "weight", "end" or "push ‹share of the surface›".
    force: (n, 3), of any size [N].
    """

    name: str
    kind: str
    force: Array


@dataclass(frozen=True, eq=False)
class Body:
    """One body with all its loads.

    fixed: (nx, ny, nz) voxels that do not move, None for a free body.
    ends: (n, 3) forces on its ends, by name.
    bound: [-] of the static error that is promised at five frames; against the same mesh where `same_mesh`.
    """

    name: str
    title: str
    volume: Volume
    fixed: Mask | None
    ends: dict[str, Array]
    bound: float
    same_mesh: bool = False

    @cached_property
    def grid(self) -> Grid:
        return voxel_grid(self.volume)

    @cached_property
    def held(self) -> Mask:
        """Return which voxels (n,) do not move."""
        if self.fixed is None:
            return np.zeros(len(self.grid.index), bool)
        return self.fixed[tuple(self.grid.index.T)]

    @cached_property
    def motions(self) -> Array:
        """Return orthonormal rigid motions (3n, 6) of the voxels of a free body; (3n, 0) of one that is held."""
        centers = self.grid.centers
        return motion_basis(centers) if self.fixed is None else np.zeros((centers.size, 0))

    def apart(self, field: Array) -> Array:
        """Return displacements (n, 3) without rigid motions that nothing holds."""
        motions = self.motions
        return field - (motions @ (motions.T @ field.ravel())).reshape(-1, 3)

    def loads(self) -> list[Load]:
        """Return all of them; those of a free body are in balance."""
        found = [Load(name, "end", force) for name, force in self.ends.items()] + self._pushes()
        if self.fixed is None:
            return [Load(load.name, load.kind, self._balanced(load.force)) for load in found]
        mass = self.grid.density * self.grid.cell_volume
        weights = (np.outer(mass, axis) for axis in np.eye(3))
        return [Load(f"weight along {'xyz'[a]}", "weight", force) for a, force in enumerate(weights)] + found

    def _balanced(self, force: Array) -> Array:
        inertia = np.repeat(self.grid.density * self.grid.cell_volume, 3)[:, None] * self.motions
        carried = np.linalg.solve(self.motions.T @ inertia, self.motions.T @ force.ravel())
        return force - (inertia @ carried).reshape(-1, 3)

    def _pushes(self) -> list[Load]:
        """On the voxels that are nearest to a place and face the same way, inwards."""
        grid = self.grid
        surface = grid.outermost[~self.held[grid.outermost]]
        place, normal = grid.centers[surface], _normals(grid, surface)
        around = grid.centers[self.held] if self.held.any() else place.mean(axis=0)[None]
        distance = np.linalg.norm(place[:, None] - around, axis=2).min(axis=1)
        found = []
        for number in range(1, PLACES + 1):
            middle = int(np.argmax(distance))
            away = np.linalg.norm(place - place[middle], axis=1)
            distance = np.minimum(distance, away)
            facing = np.flatnonzero(normal @ normal[middle] > FACING)
            nearest = facing[np.argsort(away[facing], kind="stable")]
            for share in PUSHED:
                pushed = nearest[: max(1, round(share * len(surface)))]
                force = np.zeros((len(grid.index), 3))
                force[surface[pushed]] = -normal[pushed].mean(axis=0)
                found.append(Load(f"push {number} on {share:.0%}", f"push {share:.0%}", force))
        return found


def _normals(grid: Grid, voxels: NDArray[np.integer]) -> Array:
    """(s, 3) outward: the mean direction of what is empty among the 26 neighbours; along z where that has none."""
    offsets = np.stack(np.meshgrid(*(np.arange(-1, 2),) * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    around = grid.index[voxels, None] + 1 + offsets
    empty = grid.padded[tuple(np.moveaxis(around, -1, 0))] < 0
    normal = empty @ (offsets * grid.spacing).astype(float)
    size = np.linalg.norm(normal, axis=1, keepdims=True)
    return np.where(size > 0, normal / np.maximum(size, 1e-300), [0.0, 0.0, 1.0])


def _even(where: Mask, direction: int, sign: float = 1.0) -> Array:
    """A force on some voxels, the same on each."""
    force = np.zeros((len(where), 3))
    force[where, direction] = sign
    return force


def _stiffly(grid: Grid, where: Mask, direction: int, sign: float = 1.0) -> Array:
    """A force on some voxels in proportion to their stiffness: soft layers would be torn out of stiff ones."""
    return _even(where, direction, sign) * grid.young[:, None]


def _first(labels: NDArray[np.integer], axis: int = 0) -> Mask:
    mask = np.zeros(labels.shape, bool)
    mask[(slice(None),) * axis + (0,)] = True
    return mask


def _bar(
    name: str, title: str, labels: NDArray[np.integer], materials: dict[int, Material], bound: float,
    ends: Callable[[Grid, Mask], dict[str, Array]], same_mesh: bool = False,
) -> Body:  # fmt: skip
    """A body held at its first layer along x and loaded at its last."""
    volume = Volume.from_labels(labels.astype(np.uint8), 0.01, materials)
    grid = voxel_grid(volume)
    end = grid.index[:, 0] == labels.shape[0] - 1
    return Body(name, title, volume, _first(labels), ends(grid, end), bound, same_mesh)


def _pull_and_shear(grid: Grid, end: Mask) -> dict[str, Array]:
    return {"pull": _stiffly(grid, end, 0), "shear": _stiffly(grid, end, 2, -1)}


def _material(young: float, poisson: float = 0.3) -> Material:
    return Material(float(young), poisson, DENSITY)


def beam(poisson: float) -> Body:
    """Return a homogeneous bar, six times as long as thick."""
    name = f"beam_{100 * poisson:.0f}"
    materials = {1: _material(1e6, poisson)}
    return _bar(name, f"beam, ν = {poisson:g}", np.ones((36, 6, 6), int), materials, 0.05, _pull_and_shear)


def block() -> Body:
    """Return a nearly incompressible cube, held below."""
    labels = np.ones((12, 12, 12), np.uint8)
    volume = Volume.from_labels(labels, 0.01, {1: _material(1e5, 0.49)})
    top = voxel_grid(volume).index[:, 2] == 11
    ends = {"press": _even(top, 2, -1), "shear": _even(top, 0)}
    return Body("block_49", "block, ν = 0.49", volume, _first(labels, 2), ends, 0.10)


def sandwich() -> Body:
    """Return two stiff faces on a core a hundred times softer."""
    labels = np.ones((36, 6, 8), int)
    labels[:, :, 2:6] = 2
    return _bar("sandwich", "sandwich 1:100", labels, {1: _material(1e6), 2: _material(1e4)}, 0.08, _pull_and_shear)


def composite() -> Body:
    """Return blocks of 2³ voxels, each of one of 24 materials between 10⁴ and 10⁷ Pa."""
    rng = np.random.default_rng(3)
    young = 1e4 * 10 ** rng.uniform(0, 3, 24)
    labels = np.kron(rng.integers(1, 25, (12, 4, 4)), np.ones((2, 2, 2), int))
    materials = {1 + i: _material(e) for i, e in enumerate(young)}
    return _bar("composite", "random 2³ blocks 1:1000", labels, materials, 0.08, _pull_and_shear, same_mesh=True)


def graded_bar() -> Body:
    """Return a bar a hundred times softer at its end than where it is held."""
    labels = np.broadcast_to((1 + np.arange(36) // 2)[:, None, None], (36, 6, 6))
    materials = {1 + i: _material(1e6 * 100 ** (-i / 17)) for i in range(18)}
    return _bar("graded_bar", "bar graded along it 1:100", labels, materials, 0.05, _pull_and_shear)


def graded_plate() -> Body:
    """Return a plate fifty times stiffer at one of its long edges than at the other."""
    labels = np.broadcast_to((1 + np.arange(16))[None, :, None], (36, 16, 3))
    materials = {1 + i: _material(1e5 * 50 ** (i / 15)) for i in range(16)}
    return _bar("graded_plate", "plate graded across it 1:50", labels, materials, 0.05, _pull_and_shear)


def elbow() -> Body:
    """Return an L whose upright has a joint fifty times softer just above the corner."""
    labels = np.zeros((24, 6, 24), np.uint8)
    labels[:, :, :6] = labels[18:] = 1
    labels[18:, :, 7:11] = 2
    volume = Volume.from_labels(labels, 0.01, {1: _material(1e6), 2: _material(2e4)})
    top = voxel_grid(volume).index[:, 2] == 23
    ends = {"sideways": _even(top, 0), "outwards": _even(top, 1)}
    return Body("elbow", "L with a soft joint", volume, _first(labels), ends, 0.05)


def tree() -> Body:
    """Return a trunk that forks into two branches, with a soft joint below the fork; one branch is loaded."""
    labels = np.zeros((36, 6, 36), np.uint8)
    labels[:16, :, 15:21] = 1
    for step in range(20):
        away = 4 + round(0.6 * step)
        for middle in (18 + away, 18 - away):
            labels[16 + step, :, middle - 3 : middle + 3] = 1
        if step < 4:
            labels[16 + step, :, 15 - away : 21 + away] = 1
    labels[12:16][labels[12:16] > 0] = 2
    volume = Volume.from_labels(labels, 0.01, {1: _material(1e6), 2: _material(3e4, 0.45)})
    index = voxel_grid(volume).index
    end = (index[:, 0] == 35) & (index[:, 2] > 18)
    ends = {"up": _even(end, 2), "aside": _even(end, 1)}
    return Body("tree", "tree with a soft joint", volume, _first(labels), ends, 0.05)


def limb() -> Body:
    """Return a bone with a joint in flesh, and a tendon above it that reaches the far bone."""
    labels = np.zeros((36, 10, 10), np.uint8)
    y, z = np.meshgrid(np.arange(10) - 4.5, np.arange(10) - 4.5, indexing="ij")
    radius = np.hypot(y, z)
    labels[:, radius < 5] = 1
    labels[:, radius < 2.2] = 2
    labels[17:20, radius < 2.2] = 3
    labels[8:, (z > 2) & (z < 4) & (abs(y) < 2)] = 4
    labels[30:33, (z > 1) & (z < 4) & (abs(y) < 2)] = 4
    materials = {1: _material(2e4, 0.45), 2: _material(1e8), 3: _material(2e5, 0.45), 4: _material(5e6, 0.4)}
    volume = Volume.from_labels(labels, 0.005, materials)
    grid = voxel_grid(volume)
    tendon, bone = ((grid.label == label) & (grid.index[:, 0] == layer) for label, layer in ((4, 8), (2, 35)))
    ends = {"tendon": _even(tendon, 0, -1), "end": _even(bone, 2, -1)}
    return Body("limb", "limb with bone and tendon", volume, _first(labels), ends, 0.08)


def free_core() -> Body:
    """Return a stiff core in a soft coat that nothing holds, bent by three forces and stretched by two."""
    labels = np.ones((28, 8, 8), np.uint8)
    labels[4:24, 2:6, 2:6] = 2
    volume = Volume.from_labels(labels, 0.01, {1: _material(2e4, 0.45), 2: _material(1e7)})
    x = voxel_grid(volume).index[:, 0]
    ends = {
        "bend": _even(x == 0, 2, -1) + _even(x == 27, 2, -1) + _even((x == 13) | (x == 14), 2),
        "stretch": _even(x == 27, 0) + _even(x == 0, 0, -1),
    }
    return Body("free_core", "stiff core in a soft coat, free", volume, None, ends, 0.30)


def steak() -> Body:
    """Return the T-bone steak of the checkout in coarse voxels, held by its bone; the end of one muscle is loaded."""
    fine = Volume.load(STEAK)
    whole = int(np.count_nonzero(fine.labels))
    volume = fine.resample(round(whole * float(np.prod(fine.spacing)) / STEAK_SPACING**3)).largest_component()
    grid = voxel_grid(volume)
    bone = next(label for label, material in volume.materials.items() if material.is_rigid)
    flesh = next(label for label, material in volume.materials.items() if material.name == "flesh")
    x = grid.centers[:, 0]
    end = (grid.label == flesh) & (x >= np.quantile(x[grid.label == flesh], 0.95))
    ends = {"muscle": _even(end, 0), "lift": _even(end, 2)}
    return Body("steak", "steak", volume, volume.labels == bone, ends, 0.08)


BODIES: tuple[Callable[[], Body], ...] = (
    lambda: beam(0.3), lambda: beam(0.49), block, sandwich, composite, graded_bar, graded_plate, elbow, tree, limb,
    free_core,
)  # fmt: skip
QUICK = (lambda: beam(0.3), sandwich)


def all_bodies(quick: bool) -> list[Body]:
    """Return all of them, or the few that the quick report has; the steak is in a checkout only."""
    found = [make() for make in (QUICK if quick else BODIES)]
    return found if quick or not Path(STEAK).is_file() else [*found, steak()]
