"""What voxels were sampled from is kept: through files, turns and other voxels, and where it fits no longer, not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial import KDTree

from mjframes.base.errors import MjframesError
from mjframes.surface.closest import rows_of_samples
from mjframes.surface.isosurface import extract_surface
from mjframes.volume.material import Material
from mjframes.volume.outline import MOST_PARTS, Outline, outline_in
from mjframes.volume.volume import Volume

FLESH = Material(1e4, 0.4, 1000)


def cone() -> trimesh.Trimesh:
    return trimesh.creation.cone(0.03, 0.06, sections=32)


def joined(meshes: list[trimesh.Trimesh]) -> trimesh.Trimesh:
    together = trimesh.util.concatenate(meshes)
    assert isinstance(together, trimesh.Trimesh)
    return together


def outline(volume: Volume) -> Outline:
    assert volume.outline is not None
    return volume.outline


def placed(volume: Volume) -> np.ndarray:
    """Its vertices (n, 3) in volume coordinates [m]."""
    return volume.origin + (outline(volume).vertices * volume.spacing) @ volume.axes.T


def test_a_mesh_is_kept_where_it_stands() -> None:
    volume = Volume.from_meshes([(cone(), FLESH)], voxels=500, up="-y")
    turned = cone().apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, [1, 0, 0])).vertices
    bounds = [end(placed(volume), axis=0) for end in (np.min, np.max)]
    np.testing.assert_allclose(bounds, [end(turned, axis=0) for end in (np.min, np.max)], atol=1e-7)
    low, high = (end(volume.centers, axis=0) for end in (np.min, np.max))
    assert (bounds[0] < low).all()
    assert (bounds[1] > high).all()


def test_a_file_has_it_whatever_else_is_told_of_the_grid(tmp_path: Path) -> None:
    volume = Volume.sphere(0.02, FLESH, voxels=500)
    volume.save(tmp_path / "ball.npz")
    again = Volume.load(tmp_path / "ball.npz")
    for name, array in outline(volume).arrays().items():
        np.testing.assert_array_equal(outline(again).arrays()[name], array)
    padded = replace(volume, labels=np.pad(volume.labels, 3), origin=volume.origin - 3 * volume.spacing)
    padded = replace(padded, outline=outline(volume).on(np.full(3, -3.0), np.ones(3), padded.labels.shape))
    padded.save(tmp_path / "padded.npz")
    for some in (Volume.load(tmp_path / "padded.npz", crop=True), volume, again):
        np.testing.assert_allclose(np.linalg.norm(placed(some), axis=1), 0.02, rtol=1e-5)
        np.testing.assert_allclose(np.linalg.norm(extract_surface(some).vertices, axis=1), 0.02, rtol=0.01)
    larger = Volume.load(tmp_path / "ball.npz", spacing=2 * volume.spacing, origin=2 * volume.origin + 1)
    np.testing.assert_allclose(np.linalg.norm(extract_surface(larger).vertices - 1, axis=1), 0.04, rtol=0.01)


def test_other_voxels_of_the_same_shape_have_it_and_others_do_not() -> None:
    volume = Volume.sphere(0.02, FLESH, voxels=2000)
    for voxels in (100, 20_000):
        np.testing.assert_allclose(np.linalg.norm(placed(volume.resample(voxels)), axis=1), 0.02, rtol=1e-4)
    assert volume.resample(200_000).outline is None  # the steps of the voxels are far from it
    assert volume.largest_component().outline is volume.outline
    assert volume.filled(FLESH).outline is None
    assert Volume.box(0.02, FLESH, voxels=500).outline is None


def test_what_fills_the_hull_ends_at_the_hull() -> None:
    balls = [trimesh.creation.icosphere(4, 0.02).apply_translation([x, 0, 0]) for x in (0, 0.06)]
    volume = Volume.from_meshes([(ball, FLESH) for ball in balls], spacing=0.003, fill=FLESH)
    x = extract_surface(volume).vertices
    between = (x[:, 0] > 0.002) & (x[:, 0] < 0.058)
    np.testing.assert_allclose(np.linalg.norm(x[between, 1:], axis=1), 0.02, rtol=0.01)


def test_each_shell_is_a_part_unless_there_are_very_many() -> None:
    some = [cone().apply_translation([0.1 * i, 0, 0]) for i in range(3)]
    pairs = [(some[0], FLESH), (joined(some[1:]), FLESH)]
    assert len(np.unique(outline(Volume.from_meshes(pairs, spacing=0.004)).part)) == 3
    grains = [trimesh.creation.box((0.004,) * 3).apply_translation([0.005 * i, 0, 0]) for i in range(MOST_PARTS)]
    many = [(joined(grains), FLESH), (cone().apply_translation([0, 0.1, 0]), FLESH)]
    assert len(np.unique(outline(Volume.from_meshes(many, spacing=0.002)).part)) == 2


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("vertices", np.zeros((4, 2))),
        ("vertices", np.full((4, 3), np.nan)),
        ("vertices", np.full((4, 3), 1e300)),
        ("vertices", np.zeros((4, 3), "U3")),
        ("faces", np.array([[0, 1, 4]])),
        ("faces", np.array([[0, 1, -1]])),
        ("faces", np.zeros((1, 3))),
        ("faces", np.zeros((0, 3), int)),
        ("part", np.zeros(2, int)),
        ("part", np.full(1, MOST_PARTS)),
        ("part", None),
        ("shape", np.ones(2, int)),
    ],
)
def test_a_damaged_one_is_none(name: str, value: np.ndarray | None) -> None:
    arrays = {
        "outline_vertices": np.eye(4, 3),
        "outline_faces": np.array([[0, 1, 2]]),
        "outline_part": np.zeros(1, int),
        "outline_shape": np.ones(3, int),
    }
    assert outline_in(arrays) is not None
    damaged = {key: some for key, some in (arrays | {f"outline_{name}": value}).items() if some is not None}
    assert outline_in(damaged) is None


@pytest.mark.parametrize("factor", [1e3, 1e15])
def test_one_that_is_much_larger_than_the_voxels_counts_for_nothing(factor: float) -> None:
    volume = Volume.sphere(0.02, FLESH, voxels=500)
    vertices = outline(volume).vertices.copy()
    vertices[::7] *= np.float32(factor)
    found = extract_surface(replace(volume, outline=replace(outline(volume), vertices=vertices)))
    np.testing.assert_array_equal(found.vertices, extract_surface(replace(volume, outline=None)).vertices)


@pytest.mark.parametrize("change", ["moved", "padded", "flat"])
def test_one_of_other_voxels_counts_for_nothing(change: str) -> None:
    volume = Volume.sphere(0.02, FLESH, voxels=500)
    plain = extract_surface(replace(volume, outline=None)).vertices
    if change == "padded":
        other = replace(volume, labels=np.pad(volume.labels, 2), origin=volume.origin - 2 * volume.spacing)
    else:
        away = np.array([5.0, 0, 0]) if change == "moved" else outline(volume).vertices * [0, 0, 1]
        other = replace(volume, outline=replace(outline(volume), vertices=outline(volume).vertices - np.float32(away)))
    np.testing.assert_allclose(extract_surface(other).vertices, plain, atol=1e-12)


def test_a_shell_without_area_counts_for_nothing() -> None:
    grain = trimesh.creation.box((1e-9,) * 3).apply_translation([0.03, 0, 0])
    ball = trimesh.creation.icosphere(4, 0.02)
    volume = Volume.from_meshes([(joined([ball, grain]), FLESH)], spacing=0.003)
    np.testing.assert_allclose(np.linalg.norm(extract_surface(volume).vertices, axis=1), 0.02, rtol=0.01)


def test_what_is_no_outline_is_refused() -> None:
    with pytest.raises(MjframesError, match="outline"):
        replace(Volume.sphere(0.02, FLESH, voxels=500), outline=trimesh.creation.icosphere())


def test_a_thin_rod_has_few_samples() -> None:
    """Rows across a narrow triangle were as many as along it."""
    corners = np.array([[[0, 0, 0], [0.0, 0.01, 0], [1.0, 0, 0]]])
    rows = rows_of_samples(corners, 0.002)
    points, owner = rows.samples()
    assert len(points) == len(owner) <= rows.larger < 5000
    places = KDTree(points).query(np.random.default_rng(0).dirichlet(np.ones(3), 300) @ corners[0])[0]
    assert places.max() < 0.002


def test_a_turned_volume_has_a_turned_surface() -> None:
    lying = extract_surface(Volume.cylinder(0.01, 0.04, FLESH, voxels=2000).upright("x"), 500).vertices
    assert np.abs(lying[:, 1]).max() == pytest.approx(0.02, rel=1e-4)
    side = np.abs(lying[:, 1]) < 0.0195
    np.testing.assert_allclose(np.linalg.norm(lying[side][:, [0, 2]], axis=1), 0.01, rtol=0.02)
