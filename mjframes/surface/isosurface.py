"""The closed surface of a volume, one skin a material (the paper, §5.4).

The surface net of the voxels (`net.py`), flat where they are, decimated, moved along its normals where it is not flat
so that it encloses the volume of the voxels, and cut where two smoothed material indicators G ∗ 1_a and G ∗ 1_b are
equal. Where it is known what the voxels were sampled from, the net is drawn to that (`guide.py`) in place of the moves.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import ndimage
from scipy.spatial import KDTree

from mjframes.base.cache import cached
from mjframes.base.constants import LEAST_VERTICES, VERTICES
from mjframes.base.errors import MjframesError
from mjframes.base.portable import each
from mjframes.base.trimeshes import trimesh
from mjframes.surface.decimate import decimate
from mjframes.surface.guide import Guide, guide_to
from mjframes.surface.net import Net, surface_net
from mjframes.surface.seams import cut_seams
from mjframes.surface.smoothing import SMOOTHING
from mjframes.volume.volume import Volume

OFFSETS = 4  # Newton steps of the enclosed volume: each squares the error, a tenth at the start
MARGIN = 2  # [voxels] of empty space around the volume, for the surface to close
IN_PLANE = 1e-6  # [voxels] rounding of the decimation, which keeps planes


@dataclass(frozen=True, eq=False)
class Surface:
    """A closed surface of several materials.

    vertices: (s, 3) volume coordinates [m].
    faces: (t, 3) int32, counter-clockwise seen from outside.
    label: (t,) material label of each triangle.
    """

    vertices: np.ndarray
    faces: np.ndarray
    label: np.ndarray

    @property
    def mesh(self) -> trimesh.Trimesh:
        """Return its triangles, for areas, normals and the volume inside."""
        return _mesh(self.vertices, self.faces)

    @cached_property
    def vertex_normals(self) -> np.ndarray:
        """Return the unit normal at each vertex (s, 3), outward."""
        return _vertex_normals(self.mesh)


def extract_surface(volume: Volume, target_vertices: int = VERTICES) -> Surface:
    """Return the closed surface of all materials together, with about `target_vertices` vertices and smooth seams.

    Raise MjframesError if target_vertices < LEAST_VERTICES.
    """
    if target_vertices < LEAST_VERTICES:
        raise MjframesError(
            f"target_vertices is {target_vertices!r}; a surface needs {LEAST_VERTICES} vertices or more."
        )
    spacing = np.asarray(volume.spacing, dtype=np.float64)
    box = ndimage.find_objects((volume.labels > 0).astype(np.int8))[0]
    labels = np.pad(volume.labels[box], MARGIN)
    corner = np.array([s.start for s in box]) - MARGIN + 0.5  # index 0 of the padded array is the centre of a voxel
    net = surface_net(labels > 0)
    at, guide = _guided(volume, corner, net.vertices * spacing, net.faces)
    vertices, faces = decimate(at, net.faces, target_vertices)
    if guide is None:
        mobile = ~_fixed(net, vertices / spacing)
        vertices = _conserve_volume(vertices, faces, mobile, np.count_nonzero(labels) * float(np.prod(spacing)))
    else:
        vertices = guide.vertices(vertices, faces)
    materials, indicator = _material_indicators(labels, vertices / spacing)
    vertices, faces, label = cut_seams(vertices, faces, indicator)
    vertices = volume.origin + (vertices + corner * spacing) @ volume.axes.T
    return Surface(vertices, faces.astype(np.int32), materials[label])


def kept_surface(volume: Volume, target_vertices: int = VERTICES) -> Surface:
    """Return `extract_surface`, kept on disk (`base.cache`) until the volume changes."""
    shape = (volume.labels, volume.spacing, volume.origin, volume.axes, volume.outline, target_vertices)
    return Surface(**cached("surface", shape, lambda: vars(extract_surface(volume, target_vertices))))


def _guided(volume: Volume, corner: np.ndarray, at: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, Guide | None]:
    """A net's vertices (s, 3) drawn to the volume's outline, and what draws them; as they are and None without one."""
    if volume.outline is None or tuple(volume.outline.shape) != volume.labels.shape:
        return at, None
    guide = guide_to(volume.outline, corner, volume.spacing, at)
    drawn = None if guide is None else guide.net(at, faces)
    return (at, None) if drawn is None else (drawn, guide)


def _fixed(net: Net, vertices: np.ndarray) -> np.ndarray:
    """(s, 3) the axes along which vertices of the decimated net, in voxels, are still in the plane of a flat side."""
    near = KDTree(net.vertices).query(vertices)[1]
    plane = np.round(vertices + 0.5) - 0.5
    return net.fixed[near] & (np.abs(vertices - plane) < IN_PLANE)


def _conserve_volume(vertices: np.ndarray, faces: np.ndarray, mobile: np.ndarray, target: float) -> np.ndarray:
    """Move vertices along their normals, and the axes along which they are mobile (s, 3), until the surface encloses
    `target` [m³]: smoothing and decimation cut corners.
    """
    for _ in range(OFFSETS):
        mesh = _mesh(vertices, faces)
        way = np.where(mobile, _vertex_normals(mesh), 0)
        area = np.einsum("tc,tic->", mesh.face_normals * mesh.area_faces[:, None], way[faces]) / 3
        if not area > 0:
            return vertices
        vertices = vertices + (target - mesh.volume) / area * way
    return vertices


def _material_indicators(labels: np.ndarray, index: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(materials (m,), G ∗ 1_material at the points (s, m)), from the 5 × 5 × 5 voxels around each point."""
    materials = np.unique(labels[labels > 0])
    base = np.rint(index).astype(np.int64)
    indicator = np.zeros((len(index), len(materials)))
    rows = np.arange(len(index))
    for offset in itertools.product(range(-2, 3), repeat=3):
        at = np.clip(base + offset, 0, np.array(labels.shape) - 1)
        label = labels[tuple(at.T)]
        gauss = each(math.exp, -(((base + offset - index) / SMOOTHING) ** 2).sum(axis=1) / 2)
        indicator[rows, np.searchsorted(materials, label) % len(materials)] += gauss * (label > 0)
    return materials, indicator


def _vertex_normals(mesh: trimesh.Trimesh) -> np.ndarray:
    """(s, 3) means of the triangles' normals by their angles, as the mesh's own, whose acos is not portable."""
    a, b, c = mesh.triangles.transpose(1, 0, 2)
    along, across, opposite = (np.asarray(trimesh.util.unitize(edge)) for edge in (b - a, c - a, c - b))
    cosines = trimesh.util.diagonal_dot(along, across), trimesh.util.diagonal_dot(-along, opposite)
    one, two = (each(math.acos, np.clip(cosine, -1, 1)) for cosine in cosines)
    angles = np.stack([one, two, np.pi - one - two], axis=1)
    angles[(angles < trimesh.tol.merge).any(axis=1)] = 0  # of triangles without a normal
    return np.asarray(
        trimesh.geometry.weighted_vertex_normals(len(mesh.vertices), mesh.faces, mesh.face_normals, angles)
    )


def _mesh(vertices: np.ndarray, faces: np.ndarray) -> trimesh.Trimesh:
    return trimesh.Trimesh(vertices, faces, process=False)
