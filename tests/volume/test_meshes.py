"""Volumes from meshes: exact insides, imperfect surfaces, several materials, losses that are said."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from builders.data import SHARED, shared
from numpy.typing import NDArray

from mjframes.base.errors import MjframesError
from mjframes.volume.material import Material
from mjframes.volume.meshes import MeshLike, MeshSurface, MeshWarning, lids, load_surface, winding_number
from mjframes.volume.volume import Volume
from mjframes.volume.voxelize import _crossings, spacing_for

FLESH = Material(young=2e4, poisson=0.45, density=1050)
BONE = Material.rigid(density=1900)
FAT = Material(young=5e3, poisson=0.45, density=920)


def said(*arguments: Any, **options: Any) -> tuple[Volume, list[str]]:
    """The volume and what was said of its meshes."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", MeshWarning)
        volume = Volume.from_meshes(*arguments, **options)
    return volume, [str(warning.message) for warning in caught if warning.category is MeshWarning]


def silently(*arguments: Any, **options: Any) -> Volume:
    volume, notices = said(*arguments, **options)
    assert notices == []
    return volume


def size(volume: Volume) -> float:
    """Volume of the inside [m³]."""
    return np.count_nonzero(volume.labels) * float(np.prod(volume.spacing))


def centers(volume: Volume) -> NDArray[np.float64]:
    return volume.origin + (np.argwhere(volume.labels) + 0.5) * volume.spacing


def box(extents: tuple[float, float, float], at: tuple[float, float, float] = (0, 0, 0)) -> trimesh.Trimesh:
    """A box with its lowest corner at a point."""
    mesh = trimesh.creation.box(extents=extents)
    mesh.apply_translation(np.array(at) + np.array(extents) / 2)
    return mesh


def joined(*meshes: trimesh.Trimesh) -> trimesh.Trimesh:
    return trimesh.util.concatenate(list(meshes))  # pyright: ignore[reportReturnType]


def turned(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices, mesh.faces[:, ::-1], process=False)


def exact_volume(surface: MeshSurface, side: int = 40) -> float:
    """∫ [w > ½] dV by the sum over all triangles at side³ points, one at random in each cell."""
    low, high = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
    cells = np.stack(np.meshgrid(*[np.arange(side)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    points = low + (cells + np.random.default_rng(0).random(cells.shape)) / side * (high - low)
    w = pytest.importorskip("igl").winding_number(surface.vertices, surface.faces, points)
    return float(np.mean(w > 0.5) * np.prod(high - low))


# ---- good surfaces


def test_box_fills_its_cells_and_keeps_its_place() -> None:
    volume = silently([(box((0.04, 0.06, 0.1), at=(1, 2, 3)), FLESH)], 0.01)
    assert volume.labels.shape == (4, 6, 10)
    assert volume.labels.dtype == np.uint8
    assert volume.labels.all()
    np.testing.assert_allclose(volume.origin, [1, 2, 3])
    np.testing.assert_array_equal(volume.axes, np.eye(3))
    assert volume.materials == {1: FLESH}


def test_inside_is_what_the_winding_number_says_everywhere() -> None:
    mesh = trimesh.creation.torus(0.05, 0.02, major_sections=12, minor_sections=9)
    mesh.apply_transform(trimesh.transformations.rotation_matrix(0.7, [1, 2, 3]))
    volume = silently([(mesh, FLESH)], (0.005, 0.004, 0.003))
    points = volume.origin + (np.argwhere(volume.labels < 9) + 0.5) * volume.spacing
    expected = winding_number(points, np.asarray(mesh.triangles)) > 0.5
    np.testing.assert_array_equal(volume.labels.ravel() != 0, expected)


def test_rays_through_vertices_and_edges_do_not_leak() -> None:
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=1.0)
    mesh.vertices = np.round(mesh.vertices * 8) / 8  # many vertices at voxel centres, upright and degenerate triangles
    mesh = trimesh.Trimesh(np.r_[mesh.vertices, [[-1.0625] * 3, [1.0625] * 3]], mesh.faces, process=False)
    volume, _ = said([(mesh, FLESH)], 0.125)
    rows = np.diff(np.pad(volume.labels.astype(int), ((0, 0), (0, 0), (1, 1))), axis=2)
    assert (np.abs(rows).sum(axis=2) <= 2).all()
    assert size(volume) == pytest.approx(mesh.volume, rel=0.05)


def test_columns_close_where_edges_pass_their_centres() -> None:
    rng = np.random.default_rng(0)
    faces = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]])
    for _ in range(200):  # corners at voxel centres: edges between them meet other centres, up to rounding
        change = np.zeros((100, 100, 2), np.int32)
        _crossings(rng.integers(0, 100, (4, 3)).astype(np.float64), faces, change)
        assert not change.sum(axis=2).any()


def test_wanted_number_of_voxels() -> None:
    for count in (500, 50_000):
        volume = silently([(trimesh.creation.icosphere(subdivisions=4), FLESH)], voxels=count)
        assert np.count_nonzero(volume.labels) == pytest.approx(count, rel=0.03)


def test_a_length_that_looks_like_another_unit_is_said() -> None:
    _, notices = said([(box((40, 60, 100)), FLESH)], 10)
    assert notices == ["mesh 1: the body is 100 m long; if its unit is another, give scale or --unit."]


def test_scale_is_of_the_meshes_and_not_of_the_spacing() -> None:
    for scale in (0.001, np.float32(0.001)):
        volume = silently([(box((40, 60, 100)), FLESH)], 0.01, scale=scale)
        assert volume.labels.shape == (4, 6, 10)


@pytest.mark.parametrize("ending", ["obj", "stl", "ply", "off", "glb"])
def test_files(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"box.{ending}"
    box((0.04, 0.06, 0.1)).export(path)
    assert silently([(path, FLESH)], 0.01).labels.shape == (4, 6, 10)


def test_scene_places_its_parts(tmp_path: Path) -> None:
    scene = trimesh.Scene([box((0.02, 0.02, 0.02))])
    scene.add_geometry(box((0.02, 0.02, 0.02)), transform=trimesh.transformations.translation_matrix([0.06, 0, 0]))
    scene.export(tmp_path / "two.glb")
    for source in (scene, tmp_path / "two.glb"):
        np.testing.assert_array_equal(silently([(source, FLESH)], 0.02).labels[:, 0, 0], [1, 0, 0, 1])


# ---- several materials


def test_later_meshes_win_and_the_hull_is_filled() -> None:
    pairs = [(box((0.04, 0.02, 0.02)), FLESH), (box((0.04, 0.02, 0.02), at=(0.02, 0, 0)), BONE)]
    pairs.append((box((0.01, 0.01, 0.01), at=(0.09, 0, 0)), BONE))
    volume = silently(pairs, 0.01, fill=FAT)
    np.testing.assert_array_equal(volume.labels[:, 0, 0], [1, 1, 2, 2, 2, 2, 4, 4, 4, 3])
    assert volume.materials == {1: FLESH, 2: BONE, 3: BONE, 4: FAT}
    hull = joined(*(mesh for mesh, _ in pairs)).convex_hull
    fine = silently(pairs, 0.001, fill=FAT)
    assert size(fine) == pytest.approx(hull.volume, rel=0.01)
    wanted, _ = said(pairs, voxels=20_000, fill=FAT)
    assert np.count_nonzero(wanted.labels) == pytest.approx(20_000, rel=0.05)


def test_a_mesh_that_is_covered_is_refused() -> None:
    with pytest.raises(MjframesError, match="mesh 1: later meshes cover all of it"):
        Volume.from_meshes([(box((0.02, 0.02, 0.02)), BONE), (box((0.04, 0.04, 0.04)), FLESH)], 0.01)


# ---- imperfect surfaces


def test_unwelded_triangles_are_a_surface(tmp_path: Path) -> None:
    mesh = box((0.04, 0.06, 0.1))
    loose = trimesh.Trimesh(mesh.triangles.reshape(-1, 3) * (1 + 1e-9), np.arange(36).reshape(-1, 3), process=False)
    assert silently([(loose, FLESH)], 0.01).labels.all()


def test_inside_out_is_turned() -> None:
    volume, notices = said([(turned(box((0.04, 0.06, 0.1))), FLESH)], 0.01)
    assert volume.labels.all()
    assert notices == ["mesh 1: it is inside out; the triangles were turned."]


@pytest.mark.parametrize(("is_hollow", "is_turned"), [(False, False), (True, False), (True, True)])
def test_a_shell_within_is_a_cavity_if_it_is_the_other_way_round(is_hollow: bool, is_turned: bool) -> None:
    inner = box((0.02, 0.02, 0.02), at=(0.01, 0.01, 0.01))
    mesh = joined(box((0.04, 0.04, 0.04)), turned(inner) if is_hollow else inner)
    volume, notices = said([(turned(mesh) if is_turned else mesh, FLESH)], 0.01)
    assert np.count_nonzero(volume.labels) == 64 - 8 * is_hollow
    assert any("2 of 2 shells are inside out" in notice for notice in notices) == is_turned
    assert any("overlaps or intersects itself" in notice for notice in notices) != is_hollow


def test_overlapping_shells_count_once_whichever_way_round() -> None:
    one, other = box((0.04, 0.02, 0.02)), box((0.04, 0.02, 0.02), at=(0.02, 0, 0))
    volume, notices = said([(joined(one, turned(other)), FLESH)], 0.01)
    assert volume.labels.shape == (6, 2, 2)
    assert volume.labels.all()
    assert "1 of 2 shells are inside out" in notices[0]
    assert "33 % of the volume, where it overlaps, counts once" in notices[1]


def test_mixed_orientation_is_made_consistent() -> None:
    pytest.importorskip("igl")
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=0.05)
    faces = mesh.faces.copy()
    faces[::3] = faces[::3, ::-1]
    volume, notices = said([(trimesh.Trimesh(mesh.vertices, faces, process=False), FLESH)], 0.004)
    assert size(volume) == pytest.approx(mesh.volume, rel=0.02)
    assert notices == ["mesh 1: it has triangles of mixed orientation; they were made consistent."]


def test_both_sides_drawn_is_one_surface() -> None:
    pytest.importorskip("igl")
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=0.05)
    both = trimesh.Trimesh(mesh.vertices, np.r_[mesh.faces, mesh.faces[:, ::-1]], process=False)
    volume, notices = said([(both, FLESH)], 0.004)
    assert size(volume) == pytest.approx(mesh.volume, rel=0.02)
    assert "1280 repeated triangles dropped" in notices[0]


def test_a_fin_of_no_thickness_encloses_nothing() -> None:
    mesh = box((0.04, 0.04, 0.04))
    n = len(mesh.vertices)
    fin = [[n, n + 1, n + 2], [n + 2, n + 1, n]]
    points = np.r_[mesh.vertices, [[0.04, 0.02, 0.02], [0.08, 0.02, 0.02], [0.04, 0.02, 0.04]]]
    volume, notices = said([(trimesh.Trimesh(points, np.r_[mesh.faces, fin], process=False), FLESH)], 0.01)
    assert np.count_nonzero(volume.labels) == 64
    assert notices == ["mesh 1: 2 repeated triangles dropped."]


@pytest.mark.parametrize("is_turned", [False, True])
def test_a_hole_is_closed_by_the_winding_number(is_turned: bool) -> None:
    pytest.importorskip("igl")
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=1.0)
    bowl = trimesh.Trimesh(mesh.vertices + np.array([0, 0, 20]), mesh.faces[mesh.triangles_center[:, 2] < 0.5])
    volume, notices = said([(turned(bowl) if is_turned else bowl, FLESH)], 0.05)
    assert centers(volume)[:, 2].max() == pytest.approx(20.5, abs=0.05)  # a flat lid is where w is exactly ½
    assert size(volume) == pytest.approx(np.pi * 1.5**2 * (3 - 1.5) / 3, rel=0.02)
    assert "not watertight" in notices[-1]
    assert ("inside out" in notices[0]) == is_turned


def test_a_bent_hole_is_closed_by_the_winding_number_and_not_by_its_lid() -> None:
    pytest.importorskip("igl")
    mesh = box((1, 1, 1)).subdivide().subdivide()
    corner = (mesh.face_normals @ [1, 1, 0]) > 0.5  # two adjacent sides are open
    gutter = trimesh.Trimesh(mesh.vertices, mesh.faces[~corner])
    volume, _ = said([(gutter, FLESH)], 0.0625)
    points = (np.argwhere(volume.labels < 9) + 0.5) * volume.spacing
    w = winding_number(points, np.asarray(gutter.triangles))
    is_clear = np.abs(w - 0.5) > 0.01  # libigl approximates
    np.testing.assert_array_equal(volume.labels.ravel()[is_clear] != 0, w[is_clear] > 0.5)
    assert is_clear.mean() > 0.9


def test_open_surfaces_ask_for_libigl(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "igl", None)
    mesh = box((0.1, 0.1, 0.1))
    wanted = (
        r'not watertight and needs libigl, which is not installed; pip install "mjframes\[meshes\]", or repair it\.$'
    )
    with pytest.raises(MjframesError, match=wanted):
        Volume.from_meshes([(trimesh.Trimesh(mesh.vertices, mesh.faces[1:]), FLESH)], 0.01)


def test_mixed_orientation_asks_for_libigl(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "igl", None)
    mesh = box((0.1, 0.1, 0.1))
    faces = np.concatenate([mesh.faces[:1, ::-1], mesh.faces[1:]])
    with pytest.raises(MjframesError, match=r"mesh 1: the surface has triangles of mixed orientation and needs libigl"):
        Volume.from_meshes([(trimesh.Trimesh(mesh.vertices, faces, process=False), FLESH)], 0.01)


def test_lids_close_every_hole() -> None:
    mesh = trimesh.creation.icosphere(subdivisions=3)
    kept = np.random.default_rng(1).random(len(mesh.faces)) < 0.8
    surface = load_surface(trimesh.Trimesh(mesh.vertices, mesh.faces[kept], process=False), "", 1.0)
    lid = lids(surface)
    points = np.random.default_rng(2).uniform(-1, 1, (50, 3))
    w = [winding_number(points, part.vertices[part.faces]) for part in (surface, lid)]
    np.testing.assert_allclose(sum(w), np.rint(sum(w)), atol=1e-9)
    assert surface.open_edges > 50


# ---- what falls through the grid


def test_thin_parts_are_reported_with_a_spacing_that_catches_them() -> None:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.05)
    wire = trimesh.creation.cylinder(radius=0.001, height=0.1, sections=12)
    wire.apply_transform(trimesh.transformations.rotation_matrix(0.3, [1, 1, 0], [0.08, 0.013, 0.017]))
    wire.apply_translation([0.08, 0.013, 0.017])
    volume, notices = said([(joined(ball, wire), FLESH)], 0.01)
    assert centers(volume)[:, 0].max() < 0.06
    share = 100 * wire.area / (wire.area + ball.area)
    assert float(notices[0].split()[2]) == pytest.approx(share, rel=0.05)
    assert "a spacing of 0.0011 m would catch" in notices[0]
    caught = silently([(joined(ball, wire), FLESH)], 0.0011)
    assert centers(caught)[:, 0].max() > 0.08


def test_a_difference_in_volume_is_reported() -> None:
    _, notices = said([(box((0.104, 0.104, 0.104)), FLESH)], 0.01)
    assert notices[0].startswith("mesh 1: its voxels hold 11 % less than the mesh")


def test_a_mesh_without_a_voxel_is_refused() -> None:
    plate = box((0.1, 0.1, 0.001), at=(0, 0, 0.0052))
    with pytest.raises(MjframesError, match=r"mesh 2: 100 % of its surface .* encloses no voxel"):
        Volume.from_meshes([(box((0.1, 0.1, 0.1)), FLESH), (plate, BONE)], 0.01)


# ---- what cannot be used


def test_a_number_of_voxels_is_chosen_where_none_is_given() -> None:
    volume = Volume.from_meshes([(box((0.1, 0.1, 0.1)), FLESH)])
    assert np.count_nonzero(volume.labels) == pytest.approx(20_000, rel=0.1)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"spacing": 0.1, "voxels": 10}, "give exactly one"),
        ({"spacing": -0.1}, "spacing is .*; it must be one or three positive lengths"),
        ({"voxels": 0}, "voxels is 0"),
        ({"spacing": 0.1, "scale": 0}, "scale is 0"),
        ({"spacing": 1e-9}, "cells of a body"),
        ({"spacing": 0.1, "fill": "flesh"}, "material 'flesh'"),
    ],
)
def test_bad_arguments(options: dict[str, Any], message: str) -> None:
    with pytest.raises(MjframesError, match=message):
        Volume.from_meshes([(box((1, 1, 1)), FLESH)], **options)


@pytest.mark.parametrize(
    ("mesh", "message"),
    [
        ("none.obj", r"none\.obj: there is no such file"),
        ("none.step", r"none\.step: meshes of type \.step cannot be read; give \.obj, "),
        (trimesh.Trimesh(), "no triangles"),
        (trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [1, 1, 1], [0, 1, 1]], [[0, 1, 2], [0, 2, 3]]), "flat"),
        (trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, np.nan, 0]], [[0, 1, 2]], process=False), "no points in space"),
        (7, "mesh 1: it is a int"),
    ],
)
def test_bad_meshes(mesh: MeshLike, message: str) -> None:
    with pytest.raises(MjframesError, match=message):
        Volume.from_meshes([(mesh, FLESH)], 0.1)


def test_bad_pairs() -> None:
    for meshes in ([], [box((1, 1, 1))]):
        with pytest.raises(MjframesError, match="list of one or more pairs"):
            Volume.from_meshes(meshes, 0.1)  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("ending", ["obj", "stl", "ply", "off", "glb"])
def test_damaged_files(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"bad.{ending}"
    path.write_bytes(b"\x00\xff this is no mesh\n" * 20)
    with pytest.raises(MjframesError, match=rf"bad\.{ending}: ") as error:
        Volume.from_meshes([(path, FLESH)], 0.1)
    assert "\n" not in str(error.value)


# ---- surfaces from the wild: a volume as the policy has it, or one sentence


@pytest.mark.parametrize(
    ("name", "reference", "notice"),
    [
        ("two_boxes_nested_358.ply", 1.125, ""),
        ("multibody_20_bad_winding.stl", 0.00742322, "2 of 2 shells have triangles of mixed orientation"),
        ("shark_2k6_zero_area.ply", 21486.38, "inside out"),
        ("cow_2k9_82si_wt.obj", 53.5674, "overlaps or intersects itself"),
        ("bunny_8k_nonmanifold_dups.ply", None, "not watertight"),
        pytest.param("camelhead_11k_open.off", None, "not watertight", marks=pytest.mark.slow),
    ],
)
def test_broken_meshes(name: str, reference: float | None, notice: str) -> None:
    path = shared(f"broken_meshes/{name}")
    if "watertight" in notice or "mixed" in notice:
        pytest.importorskip("igl")
    expected = exact_volume(load_surface(path, "", 1.0)) if reference is None else reference
    volume, notices = said([(path, FLESH)], voxels=200_000)
    assert size(volume) == pytest.approx(expected, rel=0.02)
    assert notice in " ".join(notices)
    assert all(text.startswith(str(path)) and "\n" not in text for text in notices)


@pytest.mark.parametrize(
    ("name", "message"),
    [("triangle_soup_100.stl", "its 100 triangles are loose .* enclose nothing"), ("woody_flat2d.obj", "is flat")],
)
def test_what_has_no_inside_is_refused(name: str, message: str) -> None:
    pytest.importorskip("igl")
    with pytest.raises(MjframesError, match=message):
        Volume.from_meshes([(shared(f"broken_meshes/{name}"), FLESH)], voxels=100_000)


def test_rat_of_two_materials() -> None:
    skin = shared("meshes/rat_skin_closed_5k4.ply")
    spine = trimesh.creation.capsule(height=0.08, radius=0.006)
    spine.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [0, 1, 0]))
    spine.apply_translation([-0.06, 0, 0.07])
    volume, _ = said([(skin, FLESH), (spine, BONE)], voxels=60_000)
    assert size(volume) == pytest.approx(6.29979e-4, rel=0.01)
    assert np.count_nonzero(volume.labels == 2) * np.prod(volume.spacing) == pytest.approx(spine.volume, rel=0.1)
    assert volume.materials == {1: FLESH, 2: BONE}


def test_dragon_in_seven_million_cells() -> None:
    surface = load_surface(shared("meshes/dragon_stanford_20k_repaired.ply"), "", 1.0)
    spacing = (np.prod(np.ptp(surface.vertices, axis=0)) / 7e6) ** (1 / 3)
    volume, notices = said([(SHARED / "meshes/dragon_stanford_20k_repaired.ply", FLESH)], spacing)
    assert volume.labels.size == pytest.approx(7e6, rel=0.02)
    assert size(volume) == pytest.approx(0.10903909, rel=1e-3)
    assert len(notices) == 1
    assert spacing_for([surface], int(np.count_nonzero(volume.labels)), False)[0] == pytest.approx(spacing, rel=0.01)
