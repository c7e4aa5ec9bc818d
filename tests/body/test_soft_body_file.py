"""Saved soft bodies come back as they were, and nothing else is taken for one."""

from __future__ import annotations

import io
import re
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from builders.leaves import leaves
from builders.scenes import FLOOR, compiled, lump
from builders.shapes import mixed

from mjframes.base import archive
from mjframes.base.constants import BODY_VERSION
from mjframes.base.errors import MjframesError
from mjframes.base.packing import lower_triangle
from mjframes.body.soft_body import SoftBody


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    path = tmp_path / "lump.npz"
    lump(0.5, 0.01).save(str(path))
    return path


def rewritten(path: Path, changes: dict[str, np.ndarray | None]) -> str:
    """The path, its file with other arrays; None leaves one out."""
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files} | changes
    np.savez(path, allow_pickle=False, **{name: value for name, value in arrays.items() if value is not None})
    return str(path)


def test_a_soft_body_comes_back_to_the_bit(saved: Path) -> None:
    original, loaded = lump(0.5, 0.01), SoftBody.load(str(saved))
    # what is known at the voxels is saved in single or half precision
    rounded = ("weights", "correction", "lifting", "error")
    fields = replace(loaded.fields, **{name: getattr(original.fields, name) for name in rounded})
    for before, after in zip(leaves(original), leaves(replace(loaded, fields=fields)), strict=True):
        np.testing.assert_array_equal(before, after)
    rounding = abs(loaded.fields.weights - original.fields.weights)
    assert rounding.max() < 2e-7
    assert original.fields.correction is not None
    assert original.fields.lifting is not None
    assert original.fields.error is not None
    assert loaded.fields.lifting is not None
    assert loaded.fields.error is not None
    assert abs(loaded.fields.correction - original.fields.correction).max() < 2e-7
    np.testing.assert_allclose(loaded.fields.lifting.mode, original.fields.lifting.mode, atol=5e-4)
    np.testing.assert_allclose(loaded.fields.error, original.fields.error, rtol=1e-3)


def test_a_loaded_body_gives_the_same_model(saved: Path) -> None:
    models = [
        compiled(FLOOR, (body, (0, 0, 1), (1, 0, 0, 0)))[0] for body in (lump(0.5, 0.01), SoftBody.load(str(saved)))
    ]
    np.testing.assert_array_equal(models[0].plugin_attr, models[1].plugin_attr)
    np.testing.assert_array_equal(models[0].skin_vert, models[1].skin_vert)
    np.testing.assert_array_equal(models[0].body_mass, models[1].body_mass)


def test_materials_come_back(saved: Path) -> None:
    assert SoftBody.load(str(saved)).materials == mixed().materials


@pytest.mark.parametrize("kept", [0, 10, 0.5, 0.99], ids="{} of it".format)
def test_a_truncated_file_is_refused(saved: Path, kept: float) -> None:
    content = saved.read_bytes()
    saved.write_bytes(content[: int(kept * len(content) if kept < 1 else kept)])
    with pytest.raises(MjframesError, match=r"lump\.npz: .* truncated or damaged"):
        SoftBody.load(str(saved))


def test_a_flipped_bit_is_found(saved: Path) -> None:
    content = bytearray(saved.read_bytes())
    content[len(content) // 2] ^= 1
    saved.write_bytes(content)
    with pytest.raises(MjframesError, match="truncated or damaged"):
        SoftBody.load(str(saved))


def test_text_is_refused(saved: Path) -> None:
    saved.write_text("<mujoco/>")
    with pytest.raises(MjframesError, match="no soft body"):
        SoftBody.load(str(saved))


def test_a_volume_is_no_soft_body(saved: Path) -> None:
    mixed().save(str(saved))
    with pytest.raises(MjframesError, match=r"holds no soft body; give one that"):
        SoftBody.load(str(saved))


def test_an_array_is_no_soft_body(saved: Path) -> None:
    with saved.open("wb") as file:
        np.save(file, np.zeros(3))
    with pytest.raises(MjframesError, match="no soft body"):
        SoftBody.load(str(saved))


def test_another_version_is_refused(saved: Path) -> None:
    with pytest.raises(MjframesError, match=f"format version 99, this mjframes reads {BODY_VERSION}; build it again"):
        SoftBody.load(rewritten(saved, {"version": np.array(99)}))


@pytest.mark.parametrize(
    "changes",
    [
        {"control.frame": None},
        {"fields.volume.materials": None},
        {"fields.volume.materials": np.array("{")},
        {"damping": np.zeros(1)},
        {"stiffness.matrix.shape": np.array([[4]])},
    ],
    ids=str,
)
def test_missing_and_damaged_arrays_are_one_sentence(saved: Path, changes: dict[str, np.ndarray | None]) -> None:
    with pytest.raises(MjframesError, match=r"lump\.npz: arrays of the soft body are missing or damaged"):
        SoftBody.load(rewritten(saved, changes))


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(MjframesError, match=r"none\.npz: .*No such file"):
        SoftBody.load(str(tmp_path / "none.npz"))
    with pytest.raises(MjframesError, match="directory"):
        SoftBody.load(str(tmp_path))


def test_a_failed_save_leaves_the_old_file(saved: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = saved.read_bytes()

    def no_space(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez_compressed", no_space)
    with pytest.raises(MjframesError, match="No space left"):
        lump().save(str(saved))
    assert saved.read_bytes() == before
    assert list(saved.parent.iterdir()) == [saved]


def test_the_lower_triangle_goes_row_by_row() -> None:
    np.testing.assert_array_equal(lower_triangle(np.array([[1, 2, 4], [2, 3, 5], [4, 5, 6]])), [1, 2, 3, 4, 5, 6])


def altered(array: np.ndarray) -> dict[str, np.ndarray]:
    """What a damaged or forged file may have in an array's place, by how."""
    wrong = {
        "a scalar": np.array(1),
        "another shape": np.zeros((2, 3)),
        "one less": array.ravel()[:-1],
        "text": np.array("x"),
        "complex": array.astype(complex) if array.dtype.kind in "iuf" else np.zeros(2, complex),
        "records": np.zeros(2, [("a", "i4")]),
    }
    if array.dtype.kind in "iu" and array.size:
        wrong |= {name: np.full_like(array, value, np.int64) for name, value in (("huge", 2**62), ("low", -(2**62)))}
    if array.dtype.kind == "f" and array.size:
        wrong["nan"] = np.full_like(array, np.nan)
        wrong["floats"] = array.astype(np.float64)[..., None]
    return wrong


@pytest.mark.filterwarnings("ignore:invalid value encountered")
@pytest.mark.slow
def test_each_array_is_refused_in_one_sentence_or_does_no_harm(saved: Path) -> None:
    """Damaged in any way: a body that is loaded can be attached, and steps."""
    with np.load(saved) as file:
        arrays = {name: file[name] for name in file.files}
    taken, said = [], []
    for name, array in arrays.items():
        for how, value in altered(array).items():
            np.savez(saved, allow_pickle=False, **(arrays | {name: value}))
            try:
                body = SoftBody.load(saved)
            except MjframesError as error:
                said.append(str(error))
                continue
            taken.append((name, how))
            compiled(FLOOR, (body, (0, 0, 1), (1, 0, 0, 0)))
    assert not [sentence for sentence in said if not re.fullmatch(r"\S+lump\.npz: [^\n]+[^.]\.", sentence)]
    assert len(taken) < len(said) / 5, taken


def test_a_skin_without_a_size_is_refused(saved: Path) -> None:
    with np.load(saved) as file:
        vertices = file["skin.vertices"]
    with pytest.raises(MjframesError, match=r"lump\.npz: .*skin\.vertices does not fit"):
        SoftBody.load(rewritten(saved, {"skin.vertices": np.zeros_like(vertices)}))


@pytest.mark.parametrize("weights", ["skin.weights", "contact.weights", "distance_field.weights"])
@pytest.mark.parametrize("factor", [0.0, 2.0, 1e300])
def test_weights_of_surfaces_sum_to_one(saved: Path, weights: str, factor: float) -> None:
    with np.load(saved) as file:
        data = file[f"{weights}.data"]
    with pytest.raises(MjframesError, match=rf"lump\.npz: .*{weights} has rows that do not sum to 1"):
        SoftBody.load(rewritten(saved, {f"{weights}.data": factor * data}))


def test_objects_are_not_read(saved: Path) -> None:
    with np.load(saved) as file:
        arrays = {name: file[name] for name in file.files}
    np.savez(saved, allow_pickle=True, **(arrays | {"parent": np.array([print], object)}))
    with pytest.raises(MjframesError, match=r"lump\.npz: .* holds Python objects"):
        SoftBody.load(saved)


@pytest.mark.parametrize("bomb", ["header", "zeros"])
def test_no_memory_is_taken_for_what_a_file_does_not_hold(
    saved: Path, monkeypatch: pytest.MonkeyPatch, bomb: str
) -> None:
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (2**40,)})
    content = header.getvalue() + (b"" if bomb == "header" else bytes(2**21))
    if bomb == "zeros":
        monkeypatch.setattr(archive, "LARGEST", 2**20)
    with zipfile.ZipFile(saved, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("kind.npy", content)
    with pytest.raises(MjframesError, match=r"asks for 8796093022208 bytes|and 0.000977 can be read"):
        SoftBody.load(saved)
