"""The closed surface of a volume, one skin a material (the paper, §5.4).

The isosurface {G ∗ 1_inside = ½} of the Gaussian-smoothed voxels, oriented outwards, moved along its normals so that it
encloses the volume of the voxels, and cut where two smoothed material indicators G ∗ 1_a and G ∗ 1_b are equal.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from skimage.measure import marching_cubes

from mjframes.base.cache import cached
from mjframes.base.errors import MjframesError
from mjframes.base.trimeshes import trimesh
from mjframes.surface.decimate import decimate
from mjframes.surface.seams import cut_seams
from mjframes.surface.smoothing import SMOOTHING, inside_field
from mjframes.volume.volume import Volume

OFFSETS = 4  # Newton steps of the enclosed volume: each squares the error, a tenth at the start
MARGIN = 2  # [voxels] of empty space around the volume, for the surface to close


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


def extract_surface(volume: Volume, target_vertices: int = 5000) -> Surface:
    """Return the closed surface of all materials together, with about `target_vertices` vertices and smooth seams.

    Raise MjframesError if target_vertices < 100.
    """
    if target_vertices < 100:
        raise MjframesError(f"target_vertices is {target_vertices!r}; a surface needs 100 vertices or more.")
    spacing = np.asarray(volume.spacing, dtype=np.float64)
    box = ndimage.find_objects((volume.labels > 0).astype(np.int8))[0]
    labels = np.pad(volume.labels[box], MARGIN)
    index, faces, *_ = marching_cubes(inside_field(labels > 0), 0.5, allow_degenerate=False)
    vertices, faces = decimate(index * spacing, faces, target_vertices)
    faces = faces[:, ::-1] if _mesh(vertices, faces).volume < 0 else faces
    vertices = _conserve_volume(vertices, faces, np.count_nonzero(labels) * float(np.prod(spacing)))
    materials, indicator = _material_indicators(labels, vertices / spacing)
    vertices, faces, label = cut_seams(vertices, faces, indicator)
    corner = np.array([s.start for s in box]) - MARGIN + 0.5  # index 0 of the padded array is the centre of a voxel
    vertices = volume.origin + (vertices + corner * spacing) @ volume.axes.T
    return Surface(vertices, faces.astype(np.int32), materials[label])


def kept_surface(volume: Volume) -> Surface:
    """Return `extract_surface`, kept on disk (`base.cache`) until the volume changes."""
    shape = (volume.labels, volume.spacing, volume.origin, volume.axes)
    return Surface(**cached("surface", shape, lambda: vars(extract_surface(volume))))


def _conserve_volume(vertices: np.ndarray, faces: np.ndarray, target: float) -> np.ndarray:
    """Move the surface along its normals until it encloses `target` [m³]: smoothing and decimation cut corners."""
    for _ in range(OFFSETS):
        mesh = _mesh(vertices, faces)
        vertices = vertices + (target - mesh.volume) / mesh.area * mesh.vertex_normals
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
        gauss = np.exp(-(((base + offset - index) / SMOOTHING) ** 2).sum(axis=1) / 2)
        indicator[rows, np.searchsorted(materials, label) % len(materials)] += gauss * (label > 0)
    return materials, indicator


def _mesh(vertices: np.ndarray, faces: np.ndarray) -> trimesh.Trimesh:
    return trimesh.Trimesh(vertices, faces, process=False)
