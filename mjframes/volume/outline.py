"""The surfaces that voxels were sampled from, where these are known: a body's surface is drawn to them.

Places are in voxels, so that they move, turn and grow with the volume.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mjframes.base.errors import MjframesError
from mjframes.volume.meshes import MeshSurface, shells_of

Array = NDArray[np.float64]

MOST_PARTS = 64  # more shells than these count as one a mesh, and more meshes as one
FACET = 0.5  # [voxels] edge of the facets of something round: they are within 0.003 of it at a radius of ten
MOST_HALVINGS = 6  # of an icosahedron's edges: 82,000 facets


@dataclass(frozen=True, eq=False)
class Outline:
    """Surfaces around the voxels of a grid. What is in any of them is inside.

    vertices: (n, 3) [voxels]: voxel (a, b, c) fills [a, a+1] × [b, b+1] × [c, c+1].
    faces: (m, 3) int32, counter-clockwise seen from outside.
    part: (m,) int32, which surface each belongs to, of MOST_PARTS at most.
    shape: (3,) of the grid.

    Raise MjframesError for arrays that are not so.
    """

    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]
    part: NDArray[np.int32]
    shape: NDArray[np.int32]

    def __post_init__(self) -> None:
        kinds = {"vertices": ("f", (..., 3)), "faces": ("iu", (..., 3)), "part": ("iu", (...,)), "shape": ("iu", (3,))}
        for name, (kind, shape) in kinds.items():
            array = np.asarray(getattr(self, name))
            fits = array.ndim == len(shape) and all(
                n in (..., have) for n, have in zip(shape, array.shape, strict=True)
            )
            if not fits or array.dtype.kind not in kind:
                raise MjframesError(f"the outline's {name} are {array.dtype} of shape {array.shape}.")
        faces, part = self.faces, self.part
        numbered = len(faces) == len(part) > 0 and 0 <= faces.min() <= faces.max() < len(self.vertices)
        if not numbered or not 0 <= part.min() <= part.max() < MOST_PARTS or not np.isfinite(self.vertices).all():
            raise MjframesError("the outline has no triangles, or its numbers are out of range.")

    def on(self, start: Array, size: Array, shape: Sequence[int]) -> Outline:
        """Return the outline on another grid of some shape (3,), in voxels of the old one.

        start: (3,) its corner.  size: (3,) of its voxels.
        """
        vertices = ((self.vertices - start) / size).astype(np.float32)
        return Outline(vertices, self.faces, self.part, np.array(shape, np.int32))

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return them as a file has them."""
        return {f"outline_{field.name}": getattr(self, field.name) for field in fields(self)}


def outline_in(arrays: Mapping[str, NDArray[Any]]) -> Outline | None:
    """Return the outline in the arrays of a file, None where there is none or where it is damaged."""
    names = [f"outline_{field.name}" for field in fields(Outline)]
    if any(name not in arrays for name in names):
        return None
    vertices, faces, part, shape = (arrays[name] for name in names)
    if vertices.dtype.kind != "f" or {faces.dtype.kind, part.dtype.kind, shape.dtype.kind} - {"i", "u"}:
        return None
    with np.errstate(over="ignore"):
        vertices = vertices.astype(np.float32)
    try:
        return Outline(vertices, *(some.astype(np.int32) for some in (faces, part, shape)))
    except MjframesError:
        return None


def outline_of(surfaces: Sequence[MeshSurface], origin: Array, spacing: Array, shape: Sequence[int]) -> Outline:
    """Return the outline that surfaces make together, around a grid from `origin` (3,) [m] on, along the axes."""
    start = np.cumsum([0, *(len(surface.vertices) for surface in surfaces)])
    faces = np.concatenate([surface.faces + first for surface, first in zip(surfaces, start, strict=False)])
    vertices = (np.concatenate([surface.vertices for surface in surfaces]) - origin) / spacing
    part = np.asarray(shells_of(len(vertices), faces), np.int64)
    if part.max() >= MOST_PARTS:
        part = np.repeat(np.arange(len(surfaces)), [len(surface.faces) for surface in surfaces])
    if part.max() >= MOST_PARTS:
        part = np.zeros(len(faces), np.int64)
    whole = faces.astype(np.int32), part.astype(np.int32), np.array(shape, np.int32)
    return Outline(vertices.astype(np.float32), *whole)


def ball_outline(radius: float, origin: Array, spacing: Array, shape: Sequence[int]) -> Outline:
    """Return that of a ball around 0.  radius: [m].  origin, spacing, shape: of the grid."""
    from mjframes.base.trimeshes import trimesh

    halvings = int(np.clip(np.ceil(np.log2(1.05 * radius / (FACET * spacing.min()))), 2, MOST_HALVINGS))
    mesh = trimesh.creation.icosphere(subdivisions=halvings, radius=radius)
    return _of_mesh(mesh, origin, spacing, shape)


def cylinder_outline(radius: float, length: float, origin: Array, spacing: Array, shape: Sequence[int]) -> Outline:
    """Return that of a cylinder along z around 0.  radius, length: [m].  origin, spacing, shape: of the grid."""
    from mjframes.base.trimeshes import trimesh

    sides = int(np.clip(np.ceil(2 * np.pi * radius / (FACET * spacing.min())), 32, 256))
    return _of_mesh(trimesh.creation.cylinder(radius=radius, height=length, sections=sides), origin, spacing, shape)


def _of_mesh(mesh: Any, origin: Array, spacing: Array, shape: Sequence[int]) -> Outline:
    surface = MeshSurface("", np.asarray(mesh.vertices), np.asarray(mesh.faces, np.int64))
    return outline_of([surface], origin, spacing, shape)
