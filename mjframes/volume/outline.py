"""The surfaces that voxels were sampled from, where these are known: a body's surface is drawn to them.

What is in any of them is inside. Voxels that were changed since may be elsewhere; so nothing relies on them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mjframes.volume.meshes import MeshSurface, shells_of

MOST_PARTS = 64  # of loose triangles each is a shell: no more are told from each other
FACETS = 0.5  # [voxels] edge of the facets of something round: they are within 0.003 of it at a radius of ten
MOST_HALVINGS = 6  # of an icosahedron's edges: 82,000 facets


@dataclass(frozen=True, eq=False)
class Outline:
    """Surfaces in volume coordinates.

    vertices: (n, 3) [m].
    faces: (m, 3) int32, counter-clockwise seen from outside.
    part: (m,) int32, which closed surface each belongs to.
    """

    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]
    part: NDArray[np.int32]

    def turned(self, turn: NDArray[np.float64]) -> Outline:
        """Return them turned about the origin by a rotation (3, 3)."""
        return replace(self, vertices=(self.vertices @ turn.T).astype(np.float32))

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return them as a file has them."""
        return {f"outline_{field.name}": getattr(self, field.name) for field in fields(self)}


def outline_in(arrays: Mapping[str, NDArray[Any]]) -> Outline | None:
    """Return the outline in the arrays of a file, None where there is none or where they do not fit each other."""
    found = [arrays.get(f"outline_{field.name}") for field in fields(Outline)]
    vertices, faces, part = found
    if vertices is None or faces is None or part is None:
        return None
    shaped = (
        vertices.ndim == faces.ndim == 2 and vertices.shape[1] == faces.shape[1] == 3 and part.shape == (len(faces),)
    )
    if not shaped or vertices.dtype.kind != "f" or faces.dtype.kind not in "iu" or part.dtype.kind not in "iu":
        return None
    if not (len(faces) and np.isfinite(vertices).all() and 0 <= faces.min() <= faces.max() < len(vertices)):
        return None
    return Outline(vertices.astype(np.float32), faces.astype(np.int32), part.astype(np.int32))


def outline_of(surfaces: Sequence[MeshSurface]) -> Outline:
    """Return the outline that surfaces make together."""
    start = np.cumsum([0, *(len(surface.vertices) for surface in surfaces)])
    faces = np.concatenate([surface.faces + first for surface, first in zip(surfaces, start, strict=False)])
    vertices = np.concatenate([surface.vertices for surface in surfaces])
    part = shells_of(len(vertices), faces)
    if part.max() >= MOST_PARTS:
        part = np.repeat(np.arange(len(surfaces)), [len(surface.faces) for surface in surfaces])
    return Outline(vertices.astype(np.float32), faces.astype(np.int32), part.astype(np.int32))


def ball_outline(radius: float, spacing: float) -> Outline:
    """Return that of a ball around the origin.  radius, spacing: [m]."""
    from mjframes.base.trimeshes import trimesh

    halvings = int(np.clip(np.ceil(np.log2(1.05 * radius / (FACETS * spacing))), 1, MOST_HALVINGS))
    return _of_mesh(trimesh.creation.icosphere(subdivisions=halvings, radius=radius))


def cylinder_outline(radius: float, length: float, spacing: float) -> Outline:
    """Return that of a cylinder along z around the origin.  radius, length, spacing: [m]."""
    from mjframes.base.trimeshes import trimesh

    sides = int(np.clip(np.ceil(2 * np.pi * radius / (FACETS * spacing)), 16, 256))
    return _of_mesh(trimesh.creation.cylinder(radius=radius, height=length, sections=sides))


def _of_mesh(mesh: Any) -> Outline:
    return outline_of([MeshSurface("", np.asarray(mesh.vertices), np.asarray(mesh.faces, np.int64))])
