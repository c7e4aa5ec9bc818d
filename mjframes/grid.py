"""The voxels inside a volume as a compact list, with the material of each.

Voxel v has its centre at p_v = origin + axes · (spacing ∘ (index_v + ½)), in volume coordinates [m].
Everything after this stage works on these n voxels, never on the image.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from mjframes.constants import RIGID_RATIO
from mjframes.material import Material
from mjframes.volume import Volume


@dataclass(frozen=True, eq=False)
class Grid:
    """The n voxels inside a volume, in C order of their indices.

    index: (n, 3) int32.  lookup: (nx, ny, nz) int32, the voxel's number or −1 outside.
    spacing: (3,) [m].  axes: (3, 3), column a is the direction of index axis a.  origin: (3,) [m].
    centers: (n, 3) volume coordinates [m].  cell_volume: of one voxel [m³].  label: (n,) the material's label.
    young, lam, mu: (n,) [Pa].  density: (n,) [kg/m³].  compliance: (n,) [1/Pa], 0 where rigid.
    piece: (n,) int32, number of the connected rigid piece (26 neighbours), −1 where soft.
    """

    index: NDArray[np.int32]
    lookup: NDArray[np.int32]
    spacing: NDArray[np.float64]
    axes: NDArray[np.float64]
    origin: NDArray[np.float64]
    centers: NDArray[np.float64]
    cell_volume: float
    label: NDArray[np.unsignedinteger]
    young: NDArray[np.float64]
    lam: NDArray[np.float64]
    mu: NDArray[np.float64]
    density: NDArray[np.float64]
    compliance: NDArray[np.float64]
    piece: NDArray[np.int32]


def voxel_grid(volume: Volume) -> Grid:
    """The compact list of the voxels inside `volume`."""
    inside = volume.labels != 0
    index = np.argwhere(inside).astype(np.int32)
    lookup = np.full(inside.shape, -1, np.int32)
    lookup[inside] = np.arange(len(index), dtype=np.int32)

    label = volume.labels[inside]
    present, material = np.unique(label, return_inverse=True)
    table = [volume.materials[int(number)] for number in present]
    is_rigid = np.array([m.is_rigid for m in table])[material]
    modulus = _strain_moduli(table)

    rigid_image = np.zeros(inside.shape, bool)
    rigid_image[inside] = is_rigid
    pieces, _ = ndimage.label(rigid_image, structure=np.ones((3, 3, 3)), output=np.int32)  # pyright: ignore

    return Grid(
        index=index,
        lookup=lookup,
        spacing=volume.spacing,
        axes=volume.axes,
        origin=volume.origin,
        centers=volume.origin + (index + 0.5) * volume.spacing @ volume.axes.T,
        cell_volume=float(np.prod(volume.spacing)),
        label=label,
        young=np.array([m.young for m in modulus])[material],
        lam=np.array([m.lame[0] for m in modulus])[material],
        mu=np.array([m.lame[1] for m in modulus])[material],
        density=np.array([m.density for m in table])[material],
        compliance=np.array([m.compliance for m in table])[material],
        piece=pieces[inside].astype(np.int32) - np.int32(1),
    )


def _strain_moduli(table: list[Material]) -> list[Material]:
    """The materials with rigid ones made just stiff enough: more buys no rigidity, only energy of second-order stretch.

    A point on a circle that moves along its tangent for a step leaves the circle, and a stiff body pays E for that.
    """
    stiffest = max((m.young for m in table if not m.is_rigid), default=np.inf)
    return [replace(m, young=min(m.young, RIGID_RATIO * stiffest)) if m.is_rigid else m for m in table]
