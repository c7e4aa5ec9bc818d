"""The closed surface of a volume, one skin a material (the paper, §5.4).

The surface net of the voxels (`net.py`), flat where they are, decimated, moved along its normals where it is not flat
so that it encloses the volume of the voxels, and cut where two smoothed material indicators G ∗ 1_a and G ∗ 1_b are
equal.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.spatial import KDTree

from mjframes.base.cache import cached
from mjframes.base.constants import LEAST_VERTICES, VERTICES
from mjframes.base.errors import MjframesError
from mjframes.base.trimeshes import trimesh
from mjframes.surface.decimate import decimate
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
    net = surface_net(labels > 0)
    vertices, faces = decimate(net.vertices * spacing, net.faces, target_vertices)
    mobile = ~_fixed(net, vertices / spacing)
    vertices = _conserve_volume(vertices, faces, mobile, np.count_nonzero(labels) * float(np.prod(spacing)))
    materials, indicator = _material_indicators(labels, vertices / spacing)
    vertices, faces, label = cut_seams(vertices, faces, indicator)
    corner = np.array([s.start for s in box]) - MARGIN + 0.5  # index 0 of the padded array is the centre of a voxel
    vertices = volume.origin + (vertices + corner * spacing) @ volume.axes.T
    return Surface(vertices, faces.astype(np.int32), materials[label])


def kept_surface(volume: Volume, target_vertices: int = VERTICES) -> Surface:
    """Return `extract_surface`, kept on disk (`base.cache`) until the volume changes."""
    shape = (volume.labels, volume.spacing, volume.origin, volume.axes, target_vertices)
    return Surface(**cached("surface", shape, lambda: vars(extract_surface(volume, target_vertices))))


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
        way = np.where(mobile, mesh.vertex_normals, 0)
        outward = mesh.face_normals * mesh.area_faces[:, None]
        area = _sum((outward[:, None] * way[faces]).reshape(len(faces), -1)) / 3
        if not area > 0:
            return vertices
        vertices = vertices + (target - _sum(outward * mesh.triangles[:, 0]) / 3) / area * way
    return vertices


def _sum(values: np.ndarray) -> float:
    """The sum without rounding: NumPy's depends on the processor, and with it which vertices touch."""
    return math.fsum(values.ravel())


def _material_indicators(labels: np.ndarray, index: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(materials (m,), G ∗ 1_material at the points (s, m)), from the 5 × 5 × 5 voxels around each point."""
    materials = np.unique(labels[labels > 0])
    base = np.rint(index).astype(np.int64)
    indicator = np.zeros((len(index), len(materials)))
    rows = np.arange(len(index))
    for offset in itertools.product(range(-2, 3), repeat=3):
        at = np.clip(base + offset, 0, np.array(labels.shape) - 1)
        label = labels[tuple(at.T)]
        gauss = np.exp(-(((base + offset - index) / SMOOTHING) ** 2).sum(axis=1) / 2)
        indicator[rows, np.searchsorted(materials, label) % len(materials)] += gauss * (label > 0)
    return materials, indicator


def _mesh(vertices: np.ndarray, faces: np.ndarray) -> trimesh.Trimesh:
    return trimesh.Trimesh(vertices, faces, process=False)
