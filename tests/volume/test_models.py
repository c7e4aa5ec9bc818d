"""The shipped volumes: what their README says of them, and that their scripts still make them."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from mjframes.volume.volume import Volume, require_connected

MODELS = Path(__file__).parents[2] / "models"
FLESH, BONE, FAT = 1, 2, 3


@pytest.fixture(scope="module")
def steak() -> Volume:
    return Volume.load(MODELS / "steak.npz")


def _piece_sizes(mask: np.ndarray) -> list[int]:
    pieces = np.empty(mask.shape, np.int32)
    ndimage.label(mask, structure=np.ones((3, 3, 3)), output=pieces)  # pyright: ignore[reportArgumentType]
    return sorted(np.bincount(pieces.ravel())[1:].tolist())


def test_steak_has_the_size_of_the_papers(steak: Volume) -> None:
    assert 64_000 < (steak.labels > 0).sum() < 70_000
    extent = steak.spacing * (np.ptp(np.argwhere(steak.labels), axis=0) + 1)
    np.testing.assert_allclose(extent, (0.24, 0.19, 0.027), rtol=0.03)
    centroid = (np.argwhere(steak.labels).mean(axis=0) + 0.5) * steak.spacing + steak.origin
    np.testing.assert_allclose(centroid, 0, atol=1e-6)


def test_steak_has_a_rigid_bone_and_fat_softer_than_flesh(steak: Volume) -> None:
    assert {label: m.name for label, m in steak.materials.items()} == {FLESH: "flesh", BONE: "bone", FAT: "fat"}
    assert [steak.materials[label].is_rigid for label in (FLESH, BONE, FAT)] == [False, True, False]
    assert steak.materials[FAT].young < steak.materials[FLESH].young


def test_steak_is_one_piece_and_its_bone_too(steak: Volume) -> None:
    require_connected(steak)
    assert len(_piece_sizes(steak.labels == BONE)) == 1


def test_steaks_bone_spans_the_thickness(steak: Volume) -> None:
    bone = steak.labels == BONE
    under_bone = (steak.labels > 0) & bone.any(axis=2, keepdims=True)
    np.testing.assert_array_equal(under_bone, bone)


def test_steaks_muscles_meet_only_through_bone_and_fat(steak: Volume) -> None:
    tenderloin, strip_loin = _piece_sizes(steak.labels == FLESH)
    assert tenderloin > 15_000
    assert strip_loin > 1.5 * tenderloin


@pytest.fixture(scope="module")
def knee() -> Volume:
    return Volume.load(MODELS / "knee.npz")


@pytest.fixture(scope="module")
def fingertip() -> Volume:
    return Volume.load(MODELS / "fingertip.npz")


@pytest.fixture(scope="module")
def peach() -> Volume:
    return Volume.load(MODELS / "peach.npz")


NAMES = ["steak", "knee", "fingertip", "peach"]


@pytest.mark.parametrize("name", NAMES)
def test_volume_is_what_its_script_makes(name: str, request: pytest.FixtureRequest) -> None:
    shipped: Volume = request.getfixturevalue(name)
    spec = importlib.util.spec_from_file_location(f"make_{name}", MODELS / f"make_{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    made: Volume = getattr(module, f"make_{name}")()
    assert made.materials == shipped.materials
    assert made.labels.shape == shipped.labels.shape
    assert (made.labels != shipped.labels).mean() < 1e-4  # a sine's last digit may move a voxel on another machine
    np.testing.assert_allclose(made.origin, shipped.origin, atol=1e-6)


def test_knee_is_one_piece_of_the_papers_kinds(knee: Volume) -> None:
    require_connected(knee)
    assert 60_000 < (knee.labels > 0).sum() < 120_000
    assert (MODELS / "knee.npz").stat().st_size < 150_000
    young = {m.name: m.young for m in knee.materials.values() if not m.is_rigid}
    assert sorted(young, key=lambda name: young[name]) == ["flesh", "muscle", "cartilage", "ligament", "tendon"]


def test_knees_bones_are_three_and_apart(knee: Volume) -> None:
    rigid = [label for label, material in knee.materials.items() if material.is_rigid]
    assert len(rigid) == 3
    assert _piece_sizes(np.isin(knee.labels, rigid)) == sorted((knee.labels == label).sum() for label in rigid)


def test_knees_tendon_spans_from_muscle_to_tibia(knee: Volume) -> None:
    """One part above the patella, in the muscle, and one below, at the tibia; each touches the patella."""
    names = {material.name: label for label, material in knee.materials.items()}
    around = np.ones((3, 3, 3), bool)
    near = {
        name: ndimage.binary_dilation(knee.labels == names[name], around) for name in ("patella", "muscle", "femur")
    }
    near["tibia"] = ndimage.binary_dilation(knee.labels == names["tibia and fibula"], around)
    parts, count = ndimage.label(knee.labels == names["tendon"], structure=around)  # pyright: ignore[reportGeneralTypeIssues]
    touched = [{name for name, where in near.items() if (where & (parts == k + 1)).any()} for k in range(count)]
    assert sorted(touched, key=sorted) == [{"muscle", "patella"}, {"patella", "tibia"}]


@pytest.mark.parametrize("name", NAMES)
def test_readme_counts_the_voxels(name: str, request: pytest.FixtureRequest) -> None:
    volume: Volume = request.getfixturevalue(name)
    readme = (MODELS / "README.md").read_text(encoding="utf-8")
    for label, material in volume.materials.items():
        assert f"| {label} | {material.name} | {(volume.labels == label).sum():,} |" in readme


@pytest.mark.parametrize("name", NAMES)
def test_files_are_small(name: str) -> None:
    assert (MODELS / f"{name}.npz").stat().st_size < 200_000


def _at_the_surface(volume: Volume) -> np.ndarray:
    """Whether voxels inside have a face neighbour outside."""
    inside = np.pad(volume.labels, 1) > 0
    return (inside & ~np.asarray(ndimage.binary_erosion(inside), bool))[1:-1, 1:-1, 1:-1]


def test_fingertips_skin_covers_its_core(fingertip: Volume) -> None:
    """The plate lies under all of the pad; no core is at the surface but where it is glued on."""
    require_connected(fingertip)
    skin, core, plate = (fingertip.labels == label for label in (1, 2, 3))
    assert not (_at_the_surface(fingertip) & core).any()
    glued = round(-fingertip.origin[2] / fingertip.spacing[2])  # the layer above z = 0
    assert not plate[:, :, glued:].any()
    np.testing.assert_array_equal((skin | core)[:, :, glued] <= plate[:, :, glued - 1], True)
    assert fingertip.materials[1].young < fingertip.materials[2].young
    assert fingertip.materials[3].is_rigid


def test_peach_has_a_stone_in_flesh_in_skin(peach: Volume) -> None:
    require_connected(peach)
    around = np.ones((3, 3, 3), bool)
    outer, flesh, stone = np.isin(peach.labels, (1, 2)), peach.labels == 3, peach.labels == 4
    assert not (_at_the_surface(peach) & ~outer).any()
    assert not (np.asarray(ndimage.binary_dilation(stone, around), bool) & ~stone & ~flesh).any()
    assert len(_piece_sizes(stone)) == 1
    volume = (peach.labels > 0).sum() * peach.spacing.prod()
    assert 1.1e-4 < volume < 1.35e-4  # [m³]: that of a ball of 60 to 64 mm
