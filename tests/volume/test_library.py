"""The library of materials, and the names that images give their labels."""

from __future__ import annotations

import json
import re
from pathlib import Path

import nibabel
import nrrd
import numpy as np
import pytest
import yaml
from nibabel.nifti1 import Nifti1Extension

import mjframes as mf
from mjframes.cli.commands import main
from mjframes.cli.inputs import parse_material, read_materials
from mjframes.volume.label_names import label_names
from mjframes.volume.library import LIBRARY

TOTAL = b'<?xml version="1.0"?><CaretExtension><LabelTable><Label Key="0">out</Label>'
TOTAL += b'<Label Key="1" Red="1"><![CDATA[liver]]></Label><Label Key="5">spleen</Label></LabelTable></CaretExtension>'


@pytest.fixture
def labels() -> np.ndarray:
    found = np.zeros((4, 4, 8), np.uint8)
    found[:, :, :4], found[:, :, 4:] = 1, 5
    return found


@pytest.fixture
def scan(tmp_path: Path, labels: np.ndarray) -> Path:
    header = {"Segment0_LabelValue": "1", "Segment0_Name": "liver", "Segment1_LabelValue": "5", "Segment1_Name": "gall"}
    nrrd.write(str(tmp_path / "seg.nrrd"), labels, {**header, "space directions": np.eye(3), "space": "RAS"})
    return tmp_path / "seg.nrrd"


@pytest.mark.parametrize("name", LIBRARY)
def test_every_material_can_be_made_and_says_where_it_is_from(name: str) -> None:
    material = mf.Material.named(name)
    assert (material.name, material.density) == (name, LIBRARY[name].density)
    assert material.is_rigid == (LIBRARY[name].young is None)
    assert len(LIBRARY[name].source) > 20


def test_silicones_have_the_modulus_that_their_source_gives() -> None:
    found = {name: re.search(r"100 % modulus (\d+) psi", known.source) for name, known in LIBRARY.items()}
    assert sum(match is not None for match in found.values()) == 6
    for name, match in found.items():
        if match is not None:
            assert LIBRARY[name].young == pytest.approx(6894.76 * int(match[1]), rel=0.004)


def test_an_unknown_name_is_told_with_the_known_ones() -> None:
    with pytest.raises(mf.MjframesError, match=r"^name is 'jelly'; the library has silicone-00-10, "):
        mf.Material.named("jelly")


def test_the_command_line_takes_names_and_what_differs() -> None:
    assert parse_material("1=silicone-00-30") == (1, mf.Material.named("silicone-00-30"))
    assert parse_material("2=bone")[1] == mf.Material.named("bone")
    assert parse_material("1=liver:young=9e3")[1].young == 9e3
    assert parse_material("1=liver:young=9e3")[1].density == LIBRARY["liver"].density
    with pytest.raises(mf.MjframesError, match="or a name that `mjframes materials` lists"):
        parse_material("1=jelly")


def test_names_of_3d_slicer(scan: Path) -> None:
    assert label_names(scan) == {1: "liver", 5: "gall"}


def test_names_of_totalsegmentator(tmp_path: Path, labels: np.ndarray) -> None:
    image = nibabel.Nifti1Image(labels, np.eye(4))
    image.header.extensions.append(Nifti1Extension(0, TOTAL))
    nibabel.save(image, tmp_path / "a.nii.gz")
    assert label_names(tmp_path / "a.nii.gz") == {1: "liver", 5: "spleen"}


@pytest.mark.parametrize("content", [{"1": "liver"}, {"labels": {"background": 0, "liver": 1}}])
@pytest.mark.parametrize("beside", ["a.json", "dataset.json"])
def test_names_of_a_file_beside(tmp_path: Path, labels: np.ndarray, content: dict, beside: str) -> None:
    nibabel.save(nibabel.Nifti1Image(labels, np.eye(4)), tmp_path / "a.nii.gz")
    assert label_names(tmp_path / "a.nii.gz") == {}
    (tmp_path / beside).write_text(json.dumps(content))
    assert label_names(tmp_path / "a.nii.gz") == {1: "liver"}


def test_the_library_is_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["materials"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 1 + len(LIBRARY)
    assert lines[2].split()[:4] == ["silicone-00-30", "6.9e+04", "0.49", "1070"]


def test_a_template_names_the_labels_of_an_image(
    scan: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["materials", str(scan)]) == 0
    text = capsys.readouterr().out
    assert yaml.safe_load(text) == {
        1: {"name": "liver"},
        5: {"name": "gall", "young": "1e4"} | {"poisson": 0.45, "density": 1050},
    }
    (tmp_path / "m.yaml").write_text(text)
    found = read_materials(str(tmp_path / "m.yaml")).by_label
    assert found[1] == mf.Material.named("liver")
    assert (found[5].name, found[5].young) == ("gall", 1e4)
    assert main(["materials", str(tmp_path / "none.nrrd")]) == 2


def test_a_template_has_the_materials_that_a_volume_has(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    materials = {
        1: mf.Material(1.2e4, 0.45, 1050, "flesh", (0.6, 0.1, 0.1, 0.5), law_constants={"c10": 2e3}),
        2: mf.Material.rigid(1900, name="bone"),
        3: mf.Material(3e-3, 0.3, 920.5, "fat"),  # another than the library's
        4: mf.Material(1e15, 0, 1e9, "label 4"),
    }
    mf.Volume.from_labels(np.arange(1, 5).reshape(4, 1, 1), 0.01, materials).save(tmp_path / "v.npz")
    assert main(["materials", str(tmp_path / "v.npz")]) == 0
    (tmp_path / "m.yaml").write_text(capsys.readouterr().out)
    assert read_materials(str(tmp_path / "m.yaml")).by_label == materials


def test_labels_that_are_not_named_have_the_default(scan: Path, tmp_path: Path) -> None:
    command = ["build", str(scan), "--frames", "1", "--spacing", "0.01", "-o", str(tmp_path / "a.npz")]
    assert main([*command, "--material", "1=liver", "--material", "default=fat"]) == 0
    materials = mf.SoftBody.load(tmp_path / "a.npz").materials
    assert materials[1] == mf.Material.named("liver")
    assert (materials[5].name, materials[5].young) == ("gall", LIBRARY["fat"].young)
    (tmp_path / "m.yaml").write_text("default: fat\n")
    assert main([*command, "--materials", str(tmp_path / "m.yaml")]) == 0
    assert mf.SoftBody.load(tmp_path / "a.npz").materials[1].young == LIBRARY["fat"].young
    assert main([*command, "--material", "default=fat", "--material", "default=fat"]) == 2


def test_materials_go_on_top_of_those_that_a_volume_has(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    own = {1: mf.Material(1e4, 0.4, 1000, "flesh"), 2: mf.Material(1e6, 0.3, 1200, "gristle")}
    mf.Volume.from_labels(np.repeat([1, 2], 4).reshape(2, 2, 2), 0.01, own).save(tmp_path / "v.npz")
    command = ["build", str(tmp_path / "v.npz"), "--frames", "1", "-o", str(tmp_path / "a.npz")]
    assert main([*command, "--material", "2=fat"]) == 0
    materials = mf.SoftBody.load(tmp_path / "a.npz").materials
    assert (materials[1], materials[2].young) == (own[1], LIBRARY["fat"].young)
    capsys.readouterr()
    assert main([*command, "--material", "default=fat"]) == 2  # it would take the place of what the file says
    assert "there are none: the file has its own; name the labels that you mean, as 1=NAME:…" in capsys.readouterr().err
