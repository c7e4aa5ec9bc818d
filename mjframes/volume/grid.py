"""The voxels inside a volume as a compact list, with the material of each.

Voxel v has its centre at p_v = origin + axes · (spacing ∘ (index_v + ½)), in volume coordinates [m].
Everything after this stage works on these n voxels, never on the image.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from mjframes.base.constants import RIGID_RATIO
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume, components


@dataclass(frozen=True, eq=False)
class Grid:
    """The n voxels inside a volume, in C order of their indices.

    index: (n, 3) int32.
    padded: (nx + 2, ny + 2, nz + 2) int32, `lookup` with a border of −1 around it.
    spacing: (3,) [m].
    axes: (3, 3), column a is the direction of index axis a.
    origin: (3,) [m].
    cell_volume: of one voxel [m³].
    labels, table: (m,) the labels present and their materials, with rigid ones just stiff enough.
    material: (n,) unsigned integers, the place of each voxel's material in `table`.
    piece: (n,) int32, number of the connected rigid piece (26 neighbours), −1 where soft.
    """

    index: NDArray[np.int32]
    padded: NDArray[np.int32]
    spacing: NDArray[np.float64]
    axes: NDArray[np.float64]
    origin: NDArray[np.float64]
    cell_volume: float
    labels: NDArray[np.unsignedinteger]
    table: tuple[Material, ...]
    material: NDArray[np.unsignedinteger]
    piece: NDArray[np.int32]

    @property
    def lookup(self) -> NDArray[np.int32]:
        """Return the voxels' numbers (nx, ny, nz), −1 outside, as a view."""
        return self.padded[1:-1, 1:-1, 1:-1]

    def points(self, voxels: NDArray[np.integer] | slice) -> NDArray[np.float64]:
        """Return the centres (v, 3) of some voxels in volume coordinates [m]."""
        return self.origin + (self.index[voxels] + 0.5) * self.spacing @ self.axes.T

    @cached_property
    def centers(self) -> NDArray[np.float64]:
        """Return the centres (n, 3) of all voxels [m], kept from the first use on: `points` is for a few at a time."""
        return self.points(slice(None))

    def beside(self, step: ArrayLike, voxels: NDArray[np.integer] | slice = slice(None)) -> NDArray[np.int32]:
        """Return the voxel (v,) that is a step (3,) of −1, 0 and 1 along the index axes from each; −1 outside."""
        return self.padded[tuple((self.index[voxels] + 1 + np.asarray(step, np.int32)).T)]

    @cached_property
    def outermost(self) -> NDArray[np.int32]:
        """Return the voxels with a face neighbour outside: the nearest one to any point outside is one of them."""
        inside = self.padded >= 0
        core = np.asarray(ndimage.binary_erosion(inside, ndimage.generate_binary_structure(3, 1)), bool)
        return self.padded[inside & np.logical_not(core)]

    @property
    def length(self) -> float:
        """Return the length from the first to the last centre, along the index axis where that is longest [m]."""
        return float(np.max(np.ptp(self.index, axis=0) * self.spacing))

    @property
    def label(self) -> NDArray[np.unsignedinteger]:
        """Return the material's label (n,)."""
        return self.labels[self.material]

    @cached_property
    def young(self) -> NDArray[np.float64]:
        """Return Young's modulus (n,) [Pa]."""
        return self.per_material("young")[self.material]

    @cached_property
    def lam(self) -> NDArray[np.float64]:
        """Return Lamé's λ (n,) [Pa]."""
        return self.per_material("lam")[self.material]

    @cached_property
    def mu(self) -> NDArray[np.float64]:
        """Return Lamé's μ (n,) [Pa]."""
        return self.per_material("mu")[self.material]

    @cached_property
    def density(self) -> NDArray[np.float64]:
        """Return the density (n,) [kg/m³]."""
        return self.per_material("density")[self.material]

    @cached_property
    def compliance(self) -> NDArray[np.float64]:
        """Return the compliance (n,) [1/Pa], 0 where rigid."""
        return self.per_material("compliance")[self.material]

    def per_material(self, name: str) -> NDArray[np.float64]:
        """Return a property (m,) of the materials of `table`: young, lam, mu, density or compliance."""
        if name in ("lam", "mu"):
            return np.array([material.lame[name == "mu"] for material in self.table])
        return np.array([getattr(material, name) for material in self.table], np.float64)


def voxel_grid(volume: Volume) -> Grid:
    """Return the compact list of the voxels inside `volume`."""
    labels = np.ascontiguousarray(volume.labels)
    n = int(np.count_nonzero(labels))
    padded = np.full([size + 2 for size in labels.shape], -1, np.int32)
    index = np.empty((n, 3), np.int32)
    known = np.array(sorted(volume.materials), labels.dtype)
    material = np.empty(n, np.min_scalar_type(len(known)))
    _list_voxels(labels, known, padded, index, material)
    present = np.flatnonzero(np.bincount(material, minlength=len(known)))
    if len(present) < len(known):
        place = np.zeros(len(known), material.dtype)
        place[present] = np.arange(len(present))
        material = place[material]
    table = [volume.materials[int(label)] for label in known[present]]
    is_rigid = np.array([m.is_rigid for m in table])
    piece = np.full(n, -1, np.int32)
    if is_rigid.any():
        piece = components(np.isin(labels, known[present][is_rigid]))[0][labels != 0] - np.int32(1)
    return Grid(
        index=index,
        padded=padded,
        spacing=volume.spacing,
        axes=volume.axes,
        origin=volume.origin,
        cell_volume=float(np.prod(volume.spacing)),
        labels=known[present],
        table=tuple(_strain_moduli(table)),
        material=material,
        piece=piece,
    )


def evened(grid: Grid) -> Grid:
    """Return the same voxels as if all that is not rigid were one material: compliance distance is then geodesic."""
    alike = replace(grid.table[0], young=1.0, is_rigid=False)
    return replace(grid, table=tuple(material if material.is_rigid else alike for material in grid.table))


def without(grid: Grid, voxels: NDArray[np.integer]) -> tuple[Grid, NDArray[np.int32]]:
    """Return the grid without some voxels, and the numbers (r,) that its voxels have in the whole one.

    voxels: of each rigid piece all or none.
    """
    stays = np.ones(len(grid.index), bool)
    stays[voxels] = False
    number = np.full(len(grid.index) + 1, -1, np.int32)  # the last is that of outside, −1
    number[:-1][stays] = np.arange(np.count_nonzero(stays))
    pieces = np.unique(grid.piece[stays])
    piece = np.where(grid.piece < 0, -1, np.searchsorted(pieces[pieces >= 0], grid.piece)).astype(np.int32)
    rest = replace(
        grid,
        index=grid.index[stays],
        padded=number[grid.padded],
        material=grid.material[stays],
        piece=piece[stays],
    )
    return rest, np.flatnonzero(stays).astype(np.int32)


def with_materials(grid: Grid, elasticity: Sequence[tuple[float, float]]) -> Grid:
    """Return the same voxels with Young's modulus [Pa] and Poisson's ratio [-] of each material of the table."""
    pairs = zip(grid.table, elasticity, strict=True)
    return replace(grid, table=tuple(replace(some, young=young, poisson=poisson) for some, (young, poisson) in pairs))


def nearest_voxels(
    grid: Grid, points: ArrayLike, within: float, edges: ArrayLike = (1.0, 1.0, 1.0)
) -> NDArray[np.int64]:
    """Return the voxel (s,) whose centre is nearest to each point; −1 where none is `within` reach.

    points: (s, 3) volume coordinates [m].  edges: (3,) of a voxel, in the unit of `within`; so that distance counts
    voxels along the axes unless they are given.
    """
    at = (np.asarray(points, np.float64) - grid.origin) @ grid.axes / grid.spacing - 0.5
    return _nearest(np.clip(at, -1e6, 1e6), grid.lookup, np.asarray(edges, np.float64), float(within))


def _strain_moduli(table: list[Material]) -> list[Material]:
    """The materials with rigid ones made just stiff enough: more buys no rigidity, only energy of second-order stretch.

    A point on a circle that moves along its tangent for a step leaves the circle, and a stiff body pays E for that.
    """
    stiffest = max((m.young for m in table if not m.is_rigid), default=np.inf)
    return [replace(m, young=min(m.young, RIGID_RATIO * stiffest)) if m.is_rigid else m for m in table]


@njit(cache=True, nogil=True)
def _list_voxels(
    labels: NDArray[np.unsignedinteger],
    known: NDArray[np.unsignedinteger],
    padded: NDArray[np.int32],
    index: NDArray[np.int32],
    material: NDArray[np.unsignedinteger],
) -> None:
    """Fill padded, index (n, 3) and material (n,), the place in `known` of each voxel's label."""
    v = 0
    place = 0
    for a in range(labels.shape[0]):
        for b in range(labels.shape[1]):
            for c in range(labels.shape[2]):
                label = labels[a, b, c]
                if label == 0:
                    continue
                if known[place] != label:
                    place = np.searchsorted(known, label)
                material[v] = place
                index[v, 0], index[v, 1], index[v, 2] = a, b, c
                padded[a + 1, b + 1, c + 1] = v
                v += 1


@njit(cache=True, nogil=True)
def root_of(parent: NDArray[np.int32], v: Any) -> int:
    """Return the representative of v's set, with the paths to it halved on the way (union–find)."""
    while parent[v] != v:
        parent[v] = parent[parent[v]]
        v = parent[v]
    return v


@njit(cache=True, nogil=True)
def _nearest(
    at: NDArray[np.float64], lookup: NDArray[np.int32], edges: NDArray[np.float64], within: float
) -> NDArray[np.int64]:
    """Return the voxel (s,) nearest to places in index coordinates (s, 3), −1 where none is `within` reach."""
    voxel = np.full(len(at), -1, np.int64)
    for s in range(len(at)):
        low, high = np.empty(3, np.int64), np.empty(3, np.int64)
        for axis in range(3):
            reach = within / edges[axis]
            low[axis] = max(0, int(np.ceil(at[s, axis] - reach)))
            high[axis] = min(lookup.shape[axis] - 1, int(np.floor(at[s, axis] + reach)))
        best = within * within
        for a in range(low[0], high[0] + 1):
            for b in range(low[1], high[1] + 1):
                for c in range(low[2], high[2] + 1):
                    x, y, z = (a - at[s, 0]) * edges[0], (b - at[s, 1]) * edges[1], (c - at[s, 2]) * edges[2]
                    square = x * x + y * y + z * z
                    if lookup[a, b, c] >= 0 and (square < best or (square == best and voxel[s] < 0)):
                        best = square
                        voxel[s] = lookup[a, b, c]
    return voxel
