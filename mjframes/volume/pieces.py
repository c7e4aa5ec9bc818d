"""The pieces of a mesh file: its named objects, or the surfaces that are not connected.

A surface within another one is a cavity or a core of that, and belongs to its piece.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mjframes.base.errors import MjframesError
from mjframes.volume.meshes import PIECE, load_surface, open_scene, shells_around, shells_of

if TYPE_CHECKING:
    import trimesh


def load_pieces(path: str | os.PathLike[str]) -> dict[str, trimesh.Trimesh]:
    """Return the pieces of a mesh file, in its unit and place, for `Volume.from_meshes`.

    Parameters
    ----------
    path
        Mesh file.

    Returns
    -------
    dict
        Meshes by name: the file's objects if it has several (.3mf, .glb, .gltf, .obj), or else its unconnected
        surfaces, called "1", "2", … from the largest box on.

    Raises
    ------
    MjframesError
        If the file cannot be read.
    """
    from mjframes.base.trimeshes import trimesh

    objects = _objects(Path(path))
    if len(objects) > 1:
        return _named(path, objects)
    surface = load_surface(path, os.fspath(path), 1.0)
    whole = next(iter(objects.values()), None)
    metadata = {} if whole is None else {"units": whole.units}
    owner = _owners(surface.vertices, surface.faces)
    pieces = []
    for number in np.unique(owner):
        used, corner = np.unique(surface.faces[owner == number], return_inverse=True)
        pieces.append(trimesh.Trimesh(surface.vertices[used], corner.reshape(-1, 3), process=False, metadata=metadata))
    pieces.sort(key=lambda piece: -float(np.prod(piece.extents)))
    return _named(path, {str(number): piece for number, piece in enumerate(pieces, 1)})


def chosen_piece(path: str | os.PathLike[str], name: str) -> trimesh.Trimesh:
    """Return one of the pieces. Raise MjframesError where none has the name."""
    pieces = load_pieces(path)
    if name not in pieces:
        raise MjframesError(f"{os.fspath(path)}: it has no piece {name!r}; its pieces are {', '.join(pieces)}.")
    return pieces[name]


def _named(path: str | os.PathLike[str], pieces: dict[str, trimesh.Trimesh]) -> dict[str, trimesh.Trimesh]:
    """The pieces, each with what messages call it."""
    for name, piece in pieces.items():
        piece.metadata[PIECE] = f"{os.fspath(path)}, piece {name}"
    return pieces


def _objects(path: Path) -> dict[str, trimesh.Trimesh]:
    """The named objects of a file, where they stand in it; none for formats without names."""
    from mjframes.base.trimeshes import trimesh

    if path.suffix.lower() not in (".3mf", ".glb", ".gltf", ".obj"):
        return {}
    scene = open_scene(path, split_objects=True) if path.suffix.lower() == ".obj" else open_scene(path)
    found = {}
    for node in scene.graph.nodes_geometry:
        place, geometry = scene.graph[node]
        mesh = scene.geometry[str(geometry)]
        if isinstance(mesh, trimesh.Trimesh):
            found[str(node)] = mesh.copy().apply_transform(place)
    return found


def _owners(points: NDArray[np.float64], triangles: NDArray[np.int64]) -> NDArray[np.int64]:
    """(m,) the piece of each triangle: its connected surface, or the outermost one around that."""
    shell = shells_of(len(points), triangles)
    around = shells_around(points, triangles, shell)
    box = [float(np.prod(np.ptp(points[triangles[shell == s]], axis=(0, 1)))) for s in range(len(around))]
    owner = [max(outer, key=box.__getitem__) if outer else s for s, outer in enumerate(around)]
    return np.array(owner)[shell]
