"""Volumes: placement of voxels in space, label images of every format, and a clear refusal of what cannot be used."""

from __future__ import annotations

import gzip
import sys
import tracemalloc
import zipfile
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from mjframes.base.errors import MjframesError
from mjframes.body.build import build
from mjframes.volume.images import ImageWarning
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume, require_connected

SHARED = Path(__file__).parents[3] / "shared" / "data" / "volumes"
FLESH = Material(young=2e4, poisson=0.45, density=1050, name="flesh", rgba=(0.6, 0.1, 0.1, 1.0))
BONE = Material.rigid(density=1900, name="bone")
MATERIALS = {1: FLESH, 2: BONE}
TILT = np.array([[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1]])  # a rotation about z with exact decimals


def _labels() -> NDArray[np.uint8]:
    """(3, 4, 5), without symmetry, so that a swapped or reversed axis shows."""
    labels = np.zeros((3, 4, 5), np.uint8)
    labels[0, :, :] = 1
    labels[0:2, 0, 0] = 2
    labels[0, 3, 4] = 0
    return labels


def _centers(volume: Volume, label: int) -> NDArray[np.float64]:
    """World positions (n, 3) [m] of the voxels with a label, sorted: the same for any order of the array's axes."""
    index = np.argwhere(volume.labels == label)
    points = volume.origin + ((index + 0.5) * volume.spacing) @ volume.axes.T
    return points[np.lexsort(np.round(points, 9).T)]


# ---- arrays


def test_array_gets_identity_axes_and_zero_origin() -> None:
    volume = Volume.from_labels(_labels(), 0.002, MATERIALS)
    np.testing.assert_array_equal(volume.labels, _labels())
    np.testing.assert_array_equal(volume.spacing, [0.002] * 3)
    np.testing.assert_array_equal(volume.origin, [0, 0, 0])
    np.testing.assert_array_equal(volume.axes, np.eye(3))
    assert volume.materials == MATERIALS


def test_array_is_copied() -> None:
    labels = _labels()
    volume = Volume.from_labels(labels, 0.002, MATERIALS)
    labels[:] = 7
    assert volume.labels.max() == 2


def test_anisotropic_spacing_and_origin_are_kept() -> None:
    volume = Volume.from_labels(_labels(), (0.001, 0.002, 0.003), MATERIALS, origin=(1, 2, 3))
    np.testing.assert_array_equal(volume.spacing, [0.001, 0.002, 0.003])
    np.testing.assert_array_equal(volume.origin, [1, 2, 3])


@pytest.mark.parametrize(
    ("given", "largest", "expected"),
    [(np.int64, 2, np.uint8), (np.float64, 2, np.uint8), (np.int32, 256, np.uint16), (np.int64, 70_000, np.uint32)],
)
def test_labels_shrink_to_the_smallest_type(given: Any, largest: int, expected: Any) -> None:
    labels = np.asfortranarray(np.where(_labels() == 2, np.int64(largest), _labels()).astype(given))
    volume = Volume.from_labels(labels, 0.002, {1: FLESH, largest: BONE})
    assert volume.labels.dtype == expected
    assert volume.labels.flags.c_contiguous
    np.testing.assert_array_equal(volume.labels, labels)


def test_boolean_array_is_label_one() -> None:
    assert Volume.from_labels(_labels() > 0, 0.002, {1: FLESH}).labels.sum() == (_labels() > 0).sum()


def test_materials_of_absent_labels_are_allowed() -> None:
    assert set(Volume.from_labels(_labels(), 0.002, {**MATERIALS, 9: FLESH}).materials) == {1, 2, 9}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"labels": np.ones((3, 4))}, r"labels have shape \(3, 4\)"),
        ({"labels": np.ones((0, 4, 4), int)}, "labels have shape .* at least one voxel"),
        ({"labels": np.full((2, 2, 2), 1.5)}, "labels contain 1.5"),
        ({"labels": np.full((2, 2, 2), np.nan)}, "labels run from nan"),
        ({"labels": np.full((2, 2, 2), -1)}, "labels run from -1"),
        ({"labels": np.full((2, 2, 2), 2**40)}, "labels run from"),
        ({"labels": np.full((2, 2, 2), "a")}, "labels are <U1"),
        ({"labels": [[[1, 2]], [[1]]]}, "labels are rows of different lengths"),
        ({"labels": np.zeros((2, 2, 2), int)}, "labels are all 0"),
        ({"spacing": None}, "spacing is missing"),
        ({"spacing": 0}, "spacing is 0; it must be"),
        ({"spacing": -0.1}, "spacing is -0.1"),
        ({"spacing": np.inf}, "spacing is inf"),
        ({"spacing": (1, 2)}, r"spacing is \(1, 2\)"),
        ({"spacing": "fine"}, "spacing is 'fine'"),
        ({"origin": (1, 2)}, r"origin is \(1, 2\)"),
        ({"origin": (1, 2, np.nan)}, "origin is .*nan"),
        ({"materials": None}, "labels 1, 2 have no material"),
        ({"materials": {1: FLESH}}, "label 2 has no material"),
        ({"materials": {0: FLESH, **MATERIALS}}, "materials has 0"),
        ({"materials": {1: 2e4, 2: BONE}}, "materials has 1: 20000.0"),
        ({"materials": [FLESH, BONE]}, "materials is"),
    ],
)
def test_unusable_arguments_are_named(change: dict[str, Any], message: str) -> None:
    arguments: dict[str, Any] = {"labels": _labels(), "spacing": 0.002, "materials": MATERIALS, **change}
    with pytest.raises(MjframesError, match=f"^{message}"):
        Volume.from_labels(**arguments)


def test_all_that_is_missing_is_named_at_once(tmp_path: Path) -> None:
    np.save(tmp_path / "v.npy", _labels())
    message = r"v\.npy: spacing is missing; .* --spacing, .* Besides, labels 1, 2 have no material; give one in"
    with pytest.raises(MjframesError, match=message):
        Volume.load(tmp_path / "v.npy")


def test_an_image_of_intensities_is_not_listed_label_by_label() -> None:
    intensity = np.arange(6 * 6 * 6).reshape(6, 6, 6)
    with pytest.raises(
        MjframesError, match=r"labels 1, .*, 10, … up to 215, 215 in all, .*is this a label image\?"
    ) as error:
        Volume.from_labels(intensity, 0.001, {})
    assert len(str(error.value)) < 400
    with pytest.raises(MjframesError, match=r"labels contain 0\.5; .* Is this a label image\?"):
        Volume.from_labels(intensity / 2, 0.001, {})


@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("dtype", [np.uint8, np.int16, np.float64])
def test_a_cropped_image_is_the_same_body(tmp_path: Path, order: Any, dtype: type) -> None:
    labels = np.zeros((30, 20, 25), dtype, order)
    labels[5:9, 3:5, 20:23] = 1
    labels[6, 4, 21], labels[0, 0, 0], labels[29, 19, 24] = 2, 0, 0
    affine = np.eye(4)
    affine[:3, :3], affine[:3, 3] = TILT * (-2, 3, 4), (10, 20, 30)
    path = _write_nifti(tmp_path / "v.nii", labels.astype(np.float32), affine)
    whole = Volume.load(path, materials=MATERIALS)
    small = Volume.load(path, materials=MATERIALS, crop=True)
    assert small.labels.shape == (4, 2, 3)
    for label in (1, 2):
        np.testing.assert_allclose(_centers(small, label), _centers(whole, label), atol=1e-12)
    moved = [Volume.from_labels(labels, 0.01, MATERIALS, (1, 2, 3), crop=crop) for crop in (False, True)]
    np.testing.assert_allclose(_centers(moved[1], 1), _centers(moved[0], 1), atol=1e-12)
    labels[0, 0, 0] = 9  # not known: it does not count
    assert Volume.from_labels(labels, 0.01, MATERIALS, drop_unknown=True, crop=True).labels.shape == (4, 2, 3)


def test_a_small_label_in_a_big_image_costs_what_it_is() -> None:
    labels = np.zeros((300, 300, 300), np.uint8)
    labels[40:64, 30:56, 290:293] = 1
    volume = Volume.from_labels(labels, 0.001, {1: FLESH})
    tracemalloc.start()
    fine = volume.resample(20_000)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert fine.labels.size < 40_000
    assert peak < 1e6
    np.testing.assert_allclose(_centers(fine, 1).mean(axis=0), _centers(volume, 1).mean(axis=0), atol=1e-4)


def test_more_voxels_than_can_be_numbered_are_refused() -> None:
    with pytest.raises(MjframesError, match=r"voxels is 1000000000000, .* would have 2\.0e\+12 cells; take less than"):
        Volume.from_labels(_labels(), 0.01, MATERIALS).resample(10**12)


def test_a_volume_is_shown_in_a_line() -> None:
    shown = repr(Volume.from_labels(_labels(), 0.002, MATERIALS))
    assert shown.startswith("<Volume of ")
    assert len(shown) < 200
    assert "\n" not in shown


def test_coordinates_of_an_anatomy_are_ras(tmp_path: Path) -> None:
    """One body written by NIfTI in RAS, by NRRD and MetaImage in LPS coordinates is the same body."""
    steps, origin, turn = TILT * (2, 3, 4), np.array([10.0, 20, 30]), np.diag([-1.0, -1, 1])
    affine = np.eye(4)
    affine[:3, :3], affine[:3, 3] = steps, origin
    nifti = Volume.load(_write_nifti(tmp_path / "v.nii", _labels(), affine), materials=MATERIALS)
    lps = {"space": "left-posterior-superior", "space directions": (turn @ steps).T, "space origin": turn @ origin}
    nrrd = Volume.load(_write_nrrd(tmp_path / "v.nrrd", _labels(), **lps), materials=MATERIALS)
    matrix = " ".join(map(repr, (turn @ TILT).T.ravel().tolist()))
    nx, ny, nz = _labels().shape
    header = (
        f"NDims = 3\nDimSize = {nx} {ny} {nz}\nElementType = MET_UCHAR\nElementSpacing = 2 3 4\nBinaryData = True\n"
        f"TransformMatrix = {matrix}\nOffset = -10 -20 30\nAnatomicalOrientation = RAI\nElementDataFile = LOCAL\n"
    )
    (tmp_path / "v.mha").write_bytes(header.encode() + _labels().astype(np.uint8).tobytes(order="F"))
    meta = Volume.load(tmp_path / "v.mha", materials=MATERIALS)
    for other in (nrrd, meta):
        for label in (1, 2):
            np.testing.assert_allclose(_centers(other, label), _centers(nifti, label), atol=1e-9)


def test_nifti_labels_of_any_size_are_read_slice_by_slice(tmp_path: Path) -> None:
    labels = np.zeros((4, 3, 6), np.int16)
    labels[1, 2, 2], labels[2, 1, 4], labels[3, 0, 5] = 7, 300, 2
    volume = Volume.load(
        _write_nifti(tmp_path / "v.nii.gz", labels, np.eye(4)),
        drop_unknown=True,
        materials={7: FLESH, 300: FLESH, 2: BONE},
    )
    np.testing.assert_array_equal(volume.labels, labels)
    labels[0, 0, 3] = -1
    with pytest.raises(MjframesError, match=r"v\.nii: labels run from -1 to 300"):
        Volume.load(_write_nifti(tmp_path / "v.nii", labels, np.eye(4)), materials=MATERIALS)


def test_unknown_units_are_said(tmp_path: Path) -> None:
    path = _write_nifti(tmp_path / "v.nii", _labels(), np.diag([2.0, 2, 2, 1]), "unknown")
    with pytest.warns(ImageWarning, match=r"v\.nii: its header has no unit of length; voxels of 2 are taken as mill"):
        Volume.load(path, materials=MATERIALS)


def test_soft_bodies_are_no_volumes(tmp_path: Path) -> None:
    np.savez(tmp_path / "body.npz", kind="mjframes soft body", labels=_labels())
    with pytest.raises(MjframesError, match=r"body\.npz: this is a soft body, which is built already"):
        Volume.load(tmp_path / "body.npz", spacing=0.01, materials=MATERIALS)


@pytest.mark.parametrize("axes", [np.diag([1, 1, -1]), np.ones((3, 3)), np.eye(2)])
def test_constructor_refuses_axes_that_are_no_rotation(axes: NDArray[Any]) -> None:
    with pytest.raises(MjframesError, match=r"^axes are"):
        Volume(_labels(), np.ones(3), np.zeros(3), axes, MATERIALS)


def test_constructor_refuses_labels_that_may_be_negative() -> None:
    with pytest.raises(MjframesError, match="from_labels"):
        Volume(_labels().astype(np.int64), np.ones(3), np.zeros(3), np.eye(3), MATERIALS)  # pyright: ignore


# ---- .npz


def test_saved_volume_comes_back_whole(tmp_path: Path) -> None:
    volume = Volume(_labels(), np.array([0.001, 0.002, 0.003]), np.array([1.0, 2, 3]), TILT, MATERIALS)
    volume.save(tmp_path / "v.npz")
    again = Volume.load(tmp_path / "v.npz")
    for name in ("labels", "spacing", "origin", "axes"):
        np.testing.assert_allclose(getattr(again, name), getattr(volume, name), rtol=1e-15, atol=1e-15)
    assert again.materials == MATERIALS


def test_given_arguments_override_the_file(tmp_path: Path) -> None:
    Volume.from_labels(_labels(), 0.002, MATERIALS, origin=(1, 2, 3)).save(tmp_path / "v.npz")
    swapped = {1: BONE, 2: FLESH}
    volume = Volume.load(str(tmp_path / "v.npz"), spacing=0.004, materials=swapped, origin=(0, 0, 1))
    assert volume.spacing[0] == 0.004
    assert volume.origin.tolist() == [0, 0, 1]
    assert volume.materials == swapped


def test_save_leaves_the_old_file_if_it_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    volume = Volume.from_labels(_labels(), 0.002, MATERIALS)
    volume.save(tmp_path / "v.npz")
    before = (tmp_path / "v.npz").read_bytes()

    def disk_full(file: Any, **arrays: Any) -> None:
        file.write(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez_compressed", disk_full)
    with pytest.raises(MjframesError, match=r"v\.npz: .*No space left"):
        volume.save(tmp_path / "v.npz")
    assert (tmp_path / "v.npz").read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["v.npz"]


def test_save_names_a_path_it_cannot_write(tmp_path: Path) -> None:
    volume = Volume.from_labels(_labels(), 0.002, MATERIALS)
    (tmp_path / "nowhere").write_text("no folder")
    with pytest.raises(MjframesError, match=r"nowhere.v\.npz: the volume cannot be written there"):
        volume.save(tmp_path / "nowhere" / "v.npz")
    with pytest.raises(MjframesError, match=r"saved as \.npz"):
        volume.save(tmp_path / "v.nrrd")


@pytest.mark.parametrize("name", ["labels", "segmentation"])
def test_any_npz_with_labels_is_read(tmp_path: Path, name: str) -> None:
    arrays: dict[str, Any] = {name: _labels(), "age": np.int64(7)}
    np.savez(tmp_path / "v.npz", **arrays)
    volume = Volume.load(tmp_path / "v.npz", spacing=0.002, materials=MATERIALS)
    np.testing.assert_array_equal(volume.labels, _labels())
    assert volume.origin.tolist() == [0, 0, 0]  # an .npz file's origin is a corner


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"a": np.ones((2, 2, 2), int), "b": np.ones((2, 2, 2), int)}, "no array 'labels' and 2 three-dim"),
        ({"a": np.ones((2, 2))}, "no array 'labels' and 0 three-dim"),
        ({"labels": np.ones((2, 2), int)}, r"labels have shape \(2, 2\)"),
        ({"labels": np.ones((2, 2, 2), int), "format_version": 99}, "format version 99"),
        ({"labels": np.ones((2, 2, 2), int), "materials": "{"}, "'materials' is not what"),
        ({"labels": np.ones((2, 2, 2), int), "materials": '{"1": {"young": 1}}'}, "'materials' is not what"),
        ({"labels": np.ones((2, 2, 2), int), "materials": "[]"}, "'materials' is not what"),
        ({"labels": np.ones((2, 2, 2), int), "axes": np.ones((3, 3))}, "not\\s+perpendicular"),
        ({"labels": np.ones((2, 2, 2), int), "origin": np.ones(2)}, "origin is"),
        ({"labels": np.ones((2, 2, 2), int), "spacing": -1.0}, "spacing is"),
        ({"labels": np.array([{}], dtype=object)}, "damaged, truncated or not of its type"),
    ],
)
def test_unusable_npz_is_refused(tmp_path: Path, arrays: dict[str, Any], message: str) -> None:
    np.savez(tmp_path / "v.npz", **{"spacing": 1.0, **arrays})
    with pytest.raises(MjframesError, match=rf"v\.npz: .*{message}"):
        Volume.load(tmp_path / "v.npz")


# ---- images


def _write_nrrd(path: Path, labels: NDArray[Any], **header: Any) -> Path:
    pytest.importorskip("nrrd").write(str(path), labels, header)
    return path


def _write_nifti(
    path: Path, labels: NDArray[Any], affine: NDArray[Any] | None, unit: str = "mm", code: int = 1
) -> Path:
    nibabel = pytest.importorskip("nibabel")
    image = nibabel.Nifti1Image(labels, affine)
    image.header.set_xyzt_units(xyz=unit)
    image.set_sform(affine, code)
    image.set_qform(None, 0)
    nibabel.save(image, path)
    return path


def test_nrrd_directions_origin_and_units(tmp_path: Path) -> None:
    steps = TILT * (2, 3, 4)  # columns, millimetres
    header = {"space": "right-anterior-superior", "space directions": steps.T, "space origin": [10.0, 20, 30]}
    volume = Volume.load(_write_nrrd(tmp_path / "v.nrrd", _labels(), **header), materials=MATERIALS)
    np.testing.assert_array_equal(volume.labels, _labels())
    np.testing.assert_allclose(volume.spacing, [0.002, 0.003, 0.004], rtol=1e-12)
    np.testing.assert_allclose(volume.axes, TILT, atol=1e-12)
    np.testing.assert_allclose(volume.origin, [0.01 - 0.0008 + 0.0009, 0.02 - 0.0006 - 0.0012, 0.03 - 0.002])

    header["space units"] = ["cm"] * 3
    volume = Volume.load(_write_nrrd(tmp_path / "cm.nrrd", _labels(), **header), materials=MATERIALS)
    np.testing.assert_allclose(volume.spacing, [0.02, 0.03, 0.04], rtol=1e-12)
    assert volume.origin[2] == pytest.approx(0.3 - 0.02)


def test_nrrd_with_spacings_only_has_its_corner_at_zero(tmp_path: Path) -> None:
    path = _write_nrrd(tmp_path / "v.nrrd", _labels(), spacings=[1.0, 2, 3])
    volume = Volume.load(path, materials=MATERIALS)
    np.testing.assert_allclose(volume.spacing, [0.001, 0.002, 0.003])
    assert volume.origin.tolist() == [0, 0, 0]


def test_nrrd_without_spacing_needs_one(tmp_path: Path) -> None:
    path = _write_nrrd(tmp_path / "v.nrrd", _labels())
    with pytest.raises(MjframesError, match=r"v\.nrrd: spacing is missing"):
        Volume.load(path, materials=MATERIALS)
    assert Volume.load(path, spacing=0.002, materials=MATERIALS).spacing[0] == 0.002


def test_left_handed_nrrd_space_is_mirrored(tmp_path: Path) -> None:
    """One body written in RAS and in LAS coordinates is the same body."""
    directions, origin = np.diag([1.0, 2, 3]), np.array([10.0, 20, 30])
    ras = {"space": "right-anterior-superior", "space directions": directions, "space origin": origin}
    mirror = np.array([-1.0, 1, 1])
    las = {"space": "left-anterior-superior", "space directions": directions * mirror, "space origin": origin * mirror}
    one, two = (
        Volume.load(_write_nrrd(tmp_path / f"{k}.nrrd", _labels(), **header), materials=MATERIALS)
        for k, header in enumerate((ras, las))
    )
    np.testing.assert_allclose(_centers(one, 2), _centers(two, 2), atol=1e-12)


@pytest.mark.parametrize("suffix", [".nii", ".nii.gz"])
@pytest.mark.parametrize(("unit", "metre"), [("mm", 1e-3), ("unknown", 1e-3), ("meter", 1.0), ("micron", 1e-6)])
def test_nifti_affine_and_units(tmp_path: Path, suffix: str, unit: str, metre: float) -> None:
    affine = np.eye(4)
    affine[:3, :3], affine[:3, 3] = TILT * (2, 3, 4), (10, 20, 30)
    path = _write_nifti(tmp_path / f"v{suffix}", _labels(), affine, unit)
    volume = Volume.load(path, materials=MATERIALS)
    np.testing.assert_array_equal(volume.labels, _labels())
    np.testing.assert_allclose(volume.spacing / metre, [2, 3, 4], rtol=1e-6)
    np.testing.assert_allclose(volume.axes, TILT, atol=1e-6)
    np.testing.assert_allclose(volume.origin / metre, [10 - 0.8 + 0.9, 20 - 0.6 - 1.2, 30 - 2], rtol=1e-6)


def test_explicit_spacing_keeps_the_first_voxels_center(tmp_path: Path) -> None:
    path = _write_nifti(tmp_path / "v.nii", _labels(), np.diag([1.0, 1, 1, 1]))
    volume = Volume.load(path, spacing=0.004, materials=MATERIALS)
    np.testing.assert_allclose(volume.origin, -0.002)
    assert Volume.load(path, spacing=0.004, materials=MATERIALS, origin=(0, 0, 0)).origin.tolist() == [0, 0, 0]


@pytest.mark.parametrize("signs", [(-1, 1, 1), (1, -1, 1), (1, 1, -1), (-1, -1, -1), (-1, -1, 1)])
def test_left_handed_axes_are_made_proper_where_they_are(tmp_path: Path, signs: tuple[int, int, int]) -> None:
    affine = np.eye(4)
    affine[:3, :3], affine[:3, 3] = TILT * signs * (2, 3, 4), (10, 20, 30)
    volume = Volume.load(_write_nifti(tmp_path / "v.nii", _labels(), affine), materials=MATERIALS)
    assert np.linalg.det(volume.axes) == pytest.approx(1)
    for label in (1, 2):
        expected = 1e-3 * (np.argwhere(_labels() == label) @ affine[:3, :3].T + affine[:3, 3])
        expected = expected[np.lexsort(np.round(expected, 9).T)]
        np.testing.assert_allclose(_centers(volume, label), expected, atol=1e-8)


def test_a_single_mirrored_axis_leaves_no_rotation(tmp_path: Path) -> None:
    path = _write_nifti(tmp_path / "v.nii", _labels(), np.diag([1.0, -1, 1, 1]))
    np.testing.assert_array_equal(Volume.load(path, materials=MATERIALS).axes, np.eye(3))


def test_nifti_without_a_coded_transform_has_spacing_only(tmp_path: Path) -> None:
    path = _write_nifti(tmp_path / "v.nii", _labels(), np.diag([2.0, 3, 4, 1]), code=0)
    volume = Volume.load(path, materials=MATERIALS)
    np.testing.assert_allclose(volume.spacing, [0.002, 0.003, 0.004])
    np.testing.assert_array_equal(volume.axes, np.eye(3))
    assert volume.origin.tolist() == [0, 0, 0]


def test_nifti_time_axis_of_one_is_dropped_and_a_longer_one_refused(tmp_path: Path) -> None:
    path = _write_nifti(tmp_path / "v.nii", _labels()[..., None], np.eye(4))
    np.testing.assert_array_equal(Volume.load(path, materials=MATERIALS).labels, _labels())
    path = _write_nifti(tmp_path / "w.nii", np.stack([_labels()] * 2, axis=-1), np.eye(4))
    with pytest.raises(MjframesError, match=r"w\.nii: labels have shape \(3, 4, 5, 2\)"):
        Volume.load(path, materials=MATERIALS)


def test_sheared_axes_are_refused(tmp_path: Path) -> None:
    affine = np.eye(4)
    affine[0, 1] = 0.05
    with pytest.raises(MjframesError, match=r"v\.nii: .*perpendicular"):
        Volume.load(_write_nifti(tmp_path / "v.nii", _labels(), affine), materials=MATERIALS)
    affine[0, 1] = 1e-4  # rounding
    Volume.load(_write_nifti(tmp_path / "w.nii", _labels(), affine), materials=MATERIALS)


def test_zero_steps_are_refused(tmp_path: Path) -> None:
    header = {"space": "LPS", "space directions": np.diag([1.0, 0, 1]), "space origin": [0.0, 0, 0]}
    with pytest.raises(MjframesError, match=r"v\.nrrd: the voxel steps"):
        Volume.load(_write_nrrd(tmp_path / "v.nrrd", _labels(), **header), materials=MATERIALS)


def test_an_unknown_unit_is_named(tmp_path: Path) -> None:
    header = {"space directions": np.eye(3), "space": "LPS", "space units": ["furlong"] * 3}
    with pytest.raises(MjframesError, match=r"v\.nrrd: its length unit is 'furlong'"):
        Volume.load(_write_nrrd(tmp_path / "v.nrrd", _labels(), **header), materials=MATERIALS)


def test_labels_of_an_image_without_material_are_named(tmp_path: Path) -> None:
    with pytest.raises(MjframesError, match=r"v\.nii: label 2 has no material"):
        Volume.load(_write_nifti(tmp_path / "v.nii", _labels(), np.eye(4)), materials={1: FLESH})


@pytest.mark.parametrize("name", ["v.npz", "v.nrrd", "v.nii", "v.nii.gz"])
@pytest.mark.parametrize("keep", [0.0, 0.3, 0.9])
def test_truncated_files_are_refused(tmp_path: Path, name: str, keep: float) -> None:
    labels = np.random.default_rng(0).integers(0, 3, (20, 20, 20)).astype(np.uint8)
    path = tmp_path / name
    if name == "v.npz":
        Volume.from_labels(labels, 0.002, MATERIALS).save(path)
    elif name == "v.nrrd":
        _write_nrrd(path, labels, spacings=[1.0, 1, 1])
    else:
        _write_nifti(path, labels, np.eye(4))
    content = path.read_bytes()
    path.write_bytes(content[: int(keep * len(content))])
    with pytest.raises(MjframesError, match=rf"{name}: "):
        Volume.load(path, materials=MATERIALS)


@pytest.mark.parametrize("name", ["v.npz", "v.nrrd", "v.nii", "v.nii.gz"])
def test_missing_files_and_folders_are_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(MjframesError, match=rf"{name}: there is no such file"):
        Volume.load(tmp_path / name, materials=MATERIALS)
    (tmp_path / name).mkdir()
    with pytest.raises(MjframesError, match=rf"{name}: there is no such file"):
        Volume.load(tmp_path / name, materials=MATERIALS)


@pytest.mark.parametrize("name", ["v.npz", "v.nrrd", "v.nii", "v.nii.gz"])
def test_files_of_another_type_are_refused(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_bytes(gzip.compress(b"hello " * 100) if name.endswith("gz") else b"hello " * 100)
    with pytest.raises(MjframesError, match=rf"{name}: "):
        Volume.load(path, materials=MATERIALS)


def test_a_damaged_member_of_an_archive_is_refused(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "v.npz", "w") as archive:
        archive.writestr("labels.npy", b"not an array")
    with pytest.raises(MjframesError, match=r"v\.npz: "):
        Volume.load(tmp_path / "v.npz", spacing=0.002, materials=MATERIALS)


@pytest.mark.parametrize(("name", "module", "package"), [("v.nrrd", "nrrd", "pynrrd"), ("v.nii", "nibabel", "nibabel")])
def test_a_missing_reader_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, module: str, package: str
) -> None:
    (tmp_path / name).touch()
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MjframesError, match=rf'{package}, which is not installed; pip install "mjframes\[images\]"'):
        Volume.load(tmp_path / name, materials=MATERIALS)


# ---- connected pieces


def test_voxels_that_share_a_corner_are_connected() -> None:
    labels = np.zeros((2, 2, 2), int)
    labels[0, 0, 0] = labels[1, 1, 1] = 1
    require_connected(Volume.from_labels(labels, 1, MATERIALS))


def test_unconnected_pieces_are_counted_and_the_largest_kept() -> None:
    labels = np.zeros((9, 3, 3), int)
    labels[0], labels[2:6], labels[7, 0, :2] = 1, 2, 1
    labels[3] = 1  # a piece may hold several materials
    volume = Volume.from_labels(labels, 1, MATERIALS)
    with pytest.raises(MjframesError, match=r"3 unconnected pieces, sizes 36, 9, 2 voxels; .*--largest.* --pieces\.$"):
        require_connected(volume)
    kept = volume.largest_component()
    require_connected(kept)
    labels[0] = labels[7:] = 0
    np.testing.assert_array_equal(kept.labels, labels)
    assert kept.labels.dtype == np.uint8


# ---- images from scanners


def _shared(name: str) -> Path:
    if not (SHARED / name).is_file():
        pytest.skip(f"{name} is not there: it is one of the large images that are not part of this repository")
    return SHARED / name


def test_knee_with_oblique_axes() -> None:
    materials = dict.fromkeys(range(1, 11), FLESH)
    volume = Volume.load(_shared("knee_dess_labels.nrrd"), materials=materials)
    assert volume.labels.shape == (384, 384, 160)
    assert volume.labels.dtype == np.uint8
    np.testing.assert_allclose(volume.spacing, [3.6458e-4, 3.6458e-4, 7e-4], rtol=1e-4)
    assert np.linalg.det(volume.axes) == pytest.approx(1)
    header = np.array([[-0.03177554, 0.36319598, 0], [0, 0, -0.36458333], [-0.69733626, -0.06100903, 0]]).T
    np.testing.assert_allclose(volume.axes * volume.spacing, 1e-3 * np.diag([-1, -1, 1]) @ header, atol=1e-9)
    center = volume.origin + volume.axes @ volume.spacing / 2
    np.testing.assert_allclose(center, [6.6536341e-3, 77.413532e-3, 70e-3], atol=1e-9)
    assert [(volume.labels == label).sum() for label in (1, 5, 10)] == [127311, 1532154, 25228]


def test_frog_with_noise_in_its_labels() -> None:
    path = _shared("frog_tissue_labels.nii.gz")
    with pytest.raises(MjframesError, match=r"labels 16, 17, 20, .* have no material"):
        Volume.load(path, materials=dict.fromkeys(range(1, 16), FLESH))
    volume = Volume.load(path, materials=dict.fromkeys(range(1, 30), FLESH))
    assert volume.labels.shape == (500, 470, 136)
    np.testing.assert_allclose(volume.spacing, [1e-3, 1e-3, 1.5e-3])
    with pytest.raises(MjframesError, match="unconnected pieces"):
        require_connected(volume)


def test_other_types_are_refused(tmp_path: Path) -> None:
    (tmp_path / "v.dcm").write_text("DICM")
    with pytest.raises(MjframesError, match=r"v\.dcm: files of type \.dcm cannot be read; label images are \.npz, "):
        Volume.load(tmp_path / "v.dcm", spacing=0.001, materials=MATERIALS)


def test_who_gives_a_mesh_in_place_of_an_image_is_told_how_it_is_read(tmp_path: Path) -> None:
    path = tmp_path / "ring.stl"
    trimesh.creation.box((0.04, 0.02, 0.02)).export(path)
    with pytest.raises(MjframesError, match=r"ring\.stl: this is a mesh, .*Volume\.from_meshes\(\[\(path, m"):
        build(path)
    assert Volume.from_meshes([(path, FLESH)], voxels=100).labels.any()


def test_npy_needs_a_spacing(tmp_path: Path) -> None:
    np.save(tmp_path / "v.npy", _labels())
    np.testing.assert_array_equal(Volume.load(tmp_path / "v.npy", spacing=0.002, materials=MATERIALS).labels, _labels())
    with pytest.raises(MjframesError, match=r"v\.npy: spacing is missing"):
        Volume.load(tmp_path / "v.npy", materials=MATERIALS)


def test_resampling_keeps_places_and_the_share_of_each_label() -> None:
    labels = np.zeros((20, 30, 20), np.uint8)
    labels[:, 4:24, :] = 1
    labels[:10, 4:24, :] = 2
    volume = Volume.from_labels(labels, (0.01, 0.01, 0.02), MATERIALS, origin=(1, 2, 3))
    fine = volume.resample(128_000)
    np.testing.assert_allclose(fine.spacing, 0.005, rtol=1e-6)
    assert np.count_nonzero(fine.labels) == pytest.approx(128_000, rel=0.02)
    for label in (1, 2):
        np.testing.assert_allclose(_centers(fine, label).mean(0), _centers(volume, label).mean(0), atol=2e-3)
    layers = np.full((9, 9, 9), 1)
    layers[4] = 2
    thin = Volume.from_labels(layers, 0.01, MATERIALS)
    with pytest.raises(MjframesError, match="label 2 has parts too thin for 8 voxels"):
        thin.resample(8)


def test_frog_with_a_bad_header_is_refused() -> None:
    with pytest.raises(MjframesError, match=r"badheader\.mhd: its header asks for 260020 bytes .* has 262087"):
        Volume.load(_shared("frog_tissue_badheader.mhd"), spacing=0.001, materials=MATERIALS)


def test_too_many_labels_for_the_memory_are_told_at_once() -> None:
    with pytest.raises(MjframesError, match=r"there is not enough memory \(Unable to allocate .*\); take fewer voxels"):
        Volume.from_labels(np.broadcast_to(np.uint8(1), (10**4, 10**4, 10**4)), 0.01, MATERIALS)


@pytest.mark.parametrize("name", ["build", "resample", "filled", "largest_component"])
def test_too_little_memory_is_told(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    def greedy(*_: object) -> None:
        np.zeros(2**62, np.uint8)

    volume = Volume.from_labels(_labels(), 0.01, MATERIALS)
    calls = {
        "build": ("body.build.voxel_grid", lambda: build(volume, 1)),
        "resample": ("volume.volume._box", lambda: volume.resample(9)),
        "filled": ("volume.volume.in_convex_hull", lambda: volume.filled(FLESH)),
        "largest_component": ("volume.volume.components", volume.largest_component),
    }
    place, call = calls[name]
    monkeypatch.setattr(f"mjframes.{place}", greedy)
    with pytest.raises(MjframesError, match=r"there is not enough memory \(Unable to allocate 4.00 EiB"):
        call()


def test_masks_of_sides_boxes_and_labels() -> None:
    volume = Volume.from_labels(_labels(), (0.01, 0.01, 0.02), MATERIALS, origin=(1, 2, 3))
    inside = np.argwhere(volume.labels > 0)
    last = np.zeros(volume.labels.shape, bool)
    last[:, :, inside[:, 2].max()] = True
    np.testing.assert_array_equal(volume.side("z"), last & (volume.labels > 0))
    lying = volume.upright("-z")  # what was at the top is at the bottom
    np.testing.assert_array_equal(lying.side("-z"), volume.side("z"))
    np.testing.assert_array_equal(volume.side("z", cast(float, np.float32(0.02))), volume.side("z"))
    assert volume.side("-x", 0.03).sum() == np.isin(inside[:, 0], inside[:, 0].min() + np.arange(3)).sum()
    low = volume.centers.min(axis=0)
    np.testing.assert_array_equal(volume.in_box(low - 0.001, [9, 9, low[2] + 0.001]), volume.side("-z"))
    np.testing.assert_array_equal(volume.with_label(1), volume.labels == 1)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda volume: volume.side("up"), "side is 'up'; it must be one of 'x'"),
        (lambda volume: volume.side("z", 0.001), r"depth is 0\.001; it must be a length in metres, .* here 0\.005"),
        (lambda volume: volume.side("z", True), "depth is True; it must be a length in metres"),
        (lambda volume: volume.in_box([5, 5, 5], [6, 6, 6]), r"the box from \[5.* holds no voxel; the voxels' centres"),
        (lambda volume: volume.in_box([5, 5], [6, 6, 6]), r"lower is \[5, 5\]; it must be three coordinates"),
        (lambda volume: volume.with_label(0), "label is 0, which no voxel has; the labels are"),
    ],
)
def test_masks_of_nothing_are_refused(call: Any, words: str) -> None:
    with pytest.raises(MjframesError, match=words):
        call(Volume.from_labels(_labels(), 0.01, MATERIALS))
