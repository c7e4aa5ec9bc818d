"""What voxels were sampled from is kept: through files, turns and other voxels, and where it fits no longer, not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from mjframes.surface.isosurface import extract_surface
from mjframes.volume.material import Material
from mjframes.volume.outline import MOST_PARTS, Outline, outline_in
from mjframes.volume.volume import Volume

FLESH = Material(1e4, 0.4, 1000)


def cone() -> trimesh.Trimesh:
    return trimesh.creation.cone(0.03, 0.06, sections=32)


def outline(volume: Volume) -> Outline:
    assert volume.outline is not None
    return volume.outline


def test_a_mesh_is_kept_where_it_stands() -> None:
    volume = Volume.from_meshes([(cone(), FLESH)], voxels=500, up="-y")
    turned = cone().apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, [1, 0, 0])).vertices
    bounds = [end(outline(volume).vertices, axis=0) for end in (np.min, np.max)]
    np.testing.assert_allclose(bounds, [end(turned, axis=0) for end in (np.min, np.max)], atol=1e-7)
    low, high = (end(volume.centers, axis=0) for end in (np.min, np.max))
    assert (bounds[0] < low).all()
    assert (bounds[1] > high).all()


def test_a_file_has_it_and_other_coordinates_do_not(tmp_path: Path) -> None:
    volume = Volume.sphere(0.02, FLESH, voxels=500)
    volume.save(tmp_path / "ball.npz")
    again = outline(Volume.load(tmp_path / "ball.npz"))
    for name, array in outline(volume).arrays().items():
        np.testing.assert_array_equal(again.arrays()[name], array)
    assert Volume.load(tmp_path / "ball.npz", crop=True).outline is not None
    assert Volume.load(tmp_path / "ball.npz", spacing=0.001).outline is None
    assert Volume.load(tmp_path / "ball.npz", origin=(0, 0, 0)).outline is None


def test_other_voxels_of_the_same_shape_have_it_and_others_do_not() -> None:
    volume = Volume.sphere(0.02, FLESH, voxels=2000)
    assert volume.resample(500).outline is volume.outline
    assert volume.largest_component().outline is volume.outline
    assert volume.filled(FLESH).outline is None
    assert Volume.from_meshes([(cone(), FLESH)], voxels=500, fill=FLESH).outline is None
    assert Volume.box(0.02, FLESH, voxels=500).outline is None


def test_each_shell_is_a_part_unless_there_are_very_many() -> None:
    some = [cone().apply_translation([0.1 * i, 0, 0]) for i in range(3)]
    pairs = [(some[0], FLESH), (trimesh.util.concatenate(some[1:]), FLESH)]
    assert len(np.unique(outline(Volume.from_meshes(pairs, spacing=0.004)).part)) == 3
    grains = [trimesh.creation.box((0.004,) * 3).apply_translation([0.005 * i, 0, 0]) for i in range(MOST_PARTS)]
    many = [(trimesh.util.concatenate(grains), FLESH), (cone().apply_translation([0, 0.1, 0]), FLESH)]
    assert len(np.unique(outline(Volume.from_meshes(many, spacing=0.002)).part)) == 2


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("vertices", np.zeros((4, 2))),
        ("vertices", np.full((4, 3), np.nan)),
        ("vertices", np.zeros((4, 3), "U3")),
        ("faces", np.array([[0, 1, 4]])),
        ("faces", np.array([[0, 1, -1]])),
        ("faces", np.zeros((1, 3))),
        ("faces", np.zeros((0, 3), int)),
        ("part", np.zeros(2, int)),
        ("part", None),
    ],
)
def test_a_damaged_one_is_none(name: str, value: np.ndarray | None) -> None:
    arrays = {
        "outline_vertices": np.eye(4, 3),
        "outline_faces": np.array([[0, 1, 2]]),
        "outline_part": np.zeros(1, int),
    }
    assert outline_in(arrays) is not None
    damaged = {key: some for key, some in (arrays | {f"outline_{name}": value}).items() if some is not None}
    assert outline_in(damaged) is None


def test_a_turned_volume_has_a_turned_surface() -> None:
    lying = extract_surface(Volume.cylinder(0.01, 0.04, FLESH, voxels=2000).upright("x"), 500).vertices
    assert np.abs(lying[:, 1]).max() == pytest.approx(0.02, rel=1e-4)
    side = np.abs(lying[:, 1]) < 0.0195
    np.testing.assert_allclose(np.linalg.norm(lying[side][:, [0, 2]], axis=1), 0.01, rtol=0.02)
