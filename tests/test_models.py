"""The shipped volumes: what their README says of them, and that their scripts still make them."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from mjframes.volume import Volume, require_connected

MODELS = Path(__file__).parent.parent / "models"
FLESH, BONE, FAT = 1, 2, 3


@pytest.fixture(scope="module")
def steak() -> Volume:
    return Volume.from_labels(MODELS / "steak.npz")


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


def test_steak_is_what_its_script_makes(steak: Volume) -> None:
    spec = importlib.util.spec_from_file_location("make_steak", MODELS / "make_steak.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    made = module.make_steak()
    assert made.materials == steak.materials
    assert made.labels.shape == steak.labels.shape
    assert (made.labels != steak.labels).mean() < 1e-4  # a sine's last digit may move a voxel on another machine
    np.testing.assert_allclose(made.origin, steak.origin, atol=1e-6)


def test_readme_counts_the_steaks_voxels(steak: Volume) -> None:
    readme = (MODELS / "README.md").read_text(encoding="utf-8")
    for label in (FLESH, BONE, FAT):
        assert f"| {label} | {steak.materials[label].name} | {(steak.labels == label).sum():,} |" in readme
