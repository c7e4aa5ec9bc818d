"""Surfaces of meshes, balls and cylinders are where these are, to a small part of a voxel, and closed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from mjframes.surface.closest import closest_weights
from mjframes.surface.isosurface import Surface, extract_surface
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

FLESH = Material(1e4, 0.4, 1000)
TURN = trimesh.transformations.rotation_matrix(0.5, [1, 2, 3])
SIZE = np.array([0.1, 0.06, 0.04])  # [m] of the box


def made(meshes: Sequence[trimesh.Trimesh], spacing: float) -> tuple[Volume, Surface]:
    volume = Volume.from_meshes([(mesh, FLESH) for mesh in meshes], spacing=spacing)
    surface = extract_surface(volume)
    assert surface.mesh.is_watertight
    return volume, surface


def of_box(points: np.ndarray) -> np.ndarray:
    """Signed distance of points (n, 3) from the box around the origin [m]."""
    beyond = np.abs(points) - SIZE / 2
    return np.linalg.norm(np.maximum(beyond, 0), axis=1) + np.minimum(beyond.max(axis=1), 0)


@pytest.mark.parametrize("voxels", [500, 4000, 20_000])
def test_a_ball_is_round(voxels: int) -> None:
    """The surface of its voxels is 0.1 voxel off, and up to 0.4: it rolled away where it was set down."""
    ball = Volume.sphere(0.02, FLESH, voxels=voxels)
    spacing = float(ball.spacing[0])
    off = np.linalg.norm(extract_surface(ball).vertices, axis=1) - 0.02
    assert np.abs(off).max() < 0.02 * spacing
    plain = np.linalg.norm(extract_surface(replace(ball, outline=None)).vertices, axis=1)
    assert np.ptp(plain) > 0.15 * spacing


def test_a_cylinder_ends_in_sharp_circles() -> None:
    cylinder = Volume.cylinder(0.03, 0.08, FLESH, voxels=8000)
    x = extract_surface(cylinder).vertices
    spacing = float(cylinder.spacing[0])
    radius = np.linalg.norm(x[:, :2], axis=1)
    assert np.abs(np.maximum(radius - 0.03, np.abs(x[:, 2]) - 0.04)).max() < 0.05 * spacing
    rim = (radius > 0.03 - 0.05 * spacing) & (np.abs(x[:, 2]) > 0.04 - 0.05 * spacing)
    angle = np.sort(np.arctan2(x[rim, 1], x[rim, 0])[x[rim, 2] > 0])
    assert np.diff(angle).max() * 0.03 < 3 * spacing


@pytest.mark.parametrize("turn", [np.eye(4), TURN], ids=["straight", "turned"])
def test_a_box_has_flat_sides_wherever_its_voxels_are(turn: np.ndarray) -> None:
    """Its sides are a third of a voxel away from those of its voxels, or slanting."""
    spacing = 0.0031
    _, surface = made([trimesh.creation.box(SIZE).apply_transform(turn)], spacing)
    place = surface.mesh.triangles_center @ turn[:3, :3]
    off = np.abs(of_box(place)) / spacing
    order = np.argsort(off)
    share = np.cumsum(surface.mesh.area_faces[order]) / surface.mesh.area
    assert off[order][np.searchsorted(share, 0.97)] < 0.05
    assert off.max() < 1
    sharp = np.sort(np.abs(surface.mesh.face_normals @ turn[:3, :3]), axis=1)[:, 2] > 0.999
    assert surface.mesh.area_faces[sharp].sum() > 0.97 * surface.mesh.area


def test_what_is_in_any_of_several_meshes_is_inside() -> None:
    """A bone in flesh, just below its surface, and another ball that overlaps it."""
    balls = [((0, 0, 0), 0.03), ((0, 0, 0.0185), 0.01), ((0.03, 0, 0), 0.02)]
    meshes = [trimesh.creation.icosphere(5, radius).apply_translation(middle) for middle, radius in balls]
    volume, surface = made(meshes, 0.002)
    off = np.min([np.linalg.norm(surface.vertices - middle, axis=1) - radius for middle, radius in balls], axis=0)
    assert np.abs(off).max() < 0.3 * volume.spacing[0]  # in the groove between two
    assert np.sqrt(np.mean(off**2)) < 0.03 * volume.spacing[0]


def test_a_core_just_below_the_surface_hides_no_part_of_it() -> None:
    """Vertices of the net that are below the surface are nearer to the core."""
    core = trimesh.creation.box((0.04, 0.02, 0.02)).apply_translation([0, 0, 0.0047])
    boxes = [box.apply_transform(TURN) for box in (trimesh.creation.box((0.06, 0.04, 0.03)), core)]
    x = made(boxes, 0.002)[1].vertices @ TURN[:3, :3]
    top = (np.abs(x[:, 0]) < 0.018) & (np.abs(x[:, 1]) < 0.008) & (x[:, 2] > 0.01)
    assert top.sum() > 100
    np.testing.assert_allclose(x[top, 2], 0.015, atol=5e-5)


@pytest.mark.parametrize("spacing", [(0.002,) * 3, (0.001, 0.001, 0.003)])
@pytest.mark.parametrize("gap", [0.002, 0.0026])
def test_what_is_near_another_mesh_is_not_drawn_to_it(gap: float, spacing: tuple[float, float, float]) -> None:
    sizes = (0.004, 0.02, 0.03)
    boxes = [trimesh.creation.box(sizes).apply_translation([side * (0.002 + gap / 2), 0, 0]) for side in (-1, 1)]
    volume = Volume.from_meshes([(box, FLESH) for box in boxes], spacing=spacing)
    x = np.abs(extract_surface(volume).vertices)
    assert x[:, 0].min() > 0.9 * gap / 2
    assert (x.max(axis=0) < np.array([0.0041 + gap / 2, 0.0101, 0.0151])).all()


def test_few_triangles_are_folded() -> None:
    """Vertices from both sides come together at a knot's narrow places and at an edge."""
    edge = trimesh.creation.box((0.06, 0.04, 0.03)).apply_transform(TURN)
    for mesh in (edge, trimesh.creation.cone(0.02, 0.06, sections=5).apply_transform(TURN)):
        _, surface = made([mesh], 0.0023)
        found = surface.mesh
        assert found.area_faces.min() > 1e-5 * 0.0023**2
        assert (found.face_adjacency_angles > 2.7).sum() <= 2
        np.testing.assert_allclose(np.linalg.norm(surface.vertex_normals, axis=1), 1, rtol=1e-6)


@pytest.mark.parametrize("thickness", [0.0014, 0.0018, 0.0024, 0.003])
def test_what_is_thinner_than_a_voxel_becomes_as_thick(thickness: float) -> None:
    """Contacts need that much: a ball of 2 cm went into a plate of 1.4 mm by 11 mm."""
    plate = trimesh.creation.box((0.06, 0.04, thickness))
    volume, surface = made([plate], 0.002)
    top = surface.vertices[:, 2] > 0
    middle = np.abs(surface.vertices[:, :2]).max(axis=1) < 0.015
    upper, lower = (np.abs(surface.vertices[middle & some, 2]) for some in (top, ~top))
    assert len(upper) > 20
    np.testing.assert_allclose(np.concatenate([upper, lower]), max(thickness, volume.spacing[2]) / 2, rtol=1e-3)


def test_what_was_cut_off_later_ends_where_its_voxels_do() -> None:
    whole = Volume.sphere(0.02, FLESH, spacing=0.002)
    labels = whole.labels.copy()
    labels[: labels.shape[0] // 2] = 0
    x = extract_surface(replace(whole, labels=labels)).vertices
    assert x[:, 0].min() == pytest.approx(0, abs=0.01 * whole.spacing[0])
    away = np.linalg.norm(x, axis=1)
    cut = x[:, 0] < 0.3 * whole.spacing[0]
    assert np.abs(x[cut & (away < 0.017), 0]).max() < 1e-9
    np.testing.assert_allclose(away[x[:, 0] > 1.5 * whole.spacing[0]], 0.02, rtol=1e-3)


def test_a_hole_stays_closed_as_its_voxels_close_it() -> None:
    pytest.importorskip("igl")
    ball = trimesh.creation.icosphere(4, 0.02)
    is_open = ball.triangles_center[:, 2] < 0.016
    volume, surface = made([trimesh.Trimesh(ball.vertices, ball.faces[is_open])], 0.002)
    away = np.linalg.norm(surface.vertices, axis=1)
    np.testing.assert_allclose(away[surface.vertices[:, 2] < 0.012], 0.02, atol=0.05 * volume.spacing[0])
    lid = (surface.vertices[:, 2] > 0.012) & (np.linalg.norm(surface.vertices[:, :2], axis=1) < 0.008)
    assert lid.sum() > 10
    assert surface.vertices[lid, 2].min() > 0.013


def test_a_triangle_without_area_has_places_too() -> None:
    corners = np.array([[[0.0, 0, 0], [1, 0, 0], [1, 0, 0]], [[2.0, 0, 0], [2, 0, 0], [2, 0, 0]]])
    points = np.array([[0.3, 1, 0], [2, 1, 0]])
    weights = closest_weights(points, corners[:, 0], corners[:, 1], corners[:, 2])
    at = np.einsum("nc,nci->ni", weights, corners)
    np.testing.assert_allclose(at, [[0.3, 0, 0], [2, 0, 0]], atol=1e-12)
