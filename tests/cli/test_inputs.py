"""Materials from flags and files, and which files go together."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from mjframes.base.errors import MjframesError, Notice
from mjframes.cli.inputs import Materials, parse_fill, parse_material, parse_materials, read_materials, read_volume
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

FLESH = Material(3e4, 0.45, 1050, name="flesh")
BONE = Material.rigid(1900, rgba=(0.9, 0.9, 0.8, 1.0))


def volume(*files: str, materials: Materials | None = None, **options: Any) -> Volume:
    given = {"spacing": None, "voxels": None, "scale": None, **options}
    return read_volume(files, Materials({1: FLESH}) if materials is None else materials, **given)


@pytest.fixture(autouse=True)
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    trimesh.creation.box(extents=(40, 20, 20)).export("box.stl")
    trimesh.creation.box(extents=(10, 10, 10)).export("small.ply")
    np.save("labels.npy", np.ones((4, 4, 4), np.uint8))


def test_flags() -> None:
    assert parse_material("1=flesh:young=3e4,poisson=0.45,density=1050") == (1, FLESH)
    assert parse_material("2:rigid,density=1900,rgba=.9/.9/.8") == (2, BONE)
    assert parse_material("3 = fat : density=900, young=1e4, poisson=.4, rgba=1/1/0/.5")[1].rgba[3] == 0.5
    assert parse_fill("flesh:young=3e4,poisson=0.45,density=1050") == FLESH


def test_constants_of_a_law_are_values_of_a_material() -> None:
    material = parse_material("1=gum:young=3e4,poisson=0.45,density=1050,c10=2e3,segments=9")[1]
    assert material.law_constants == {"c10": 2e3, "segments": 9.0}
    named = parse_material("1=silicone-00-30:mu=2e4")[1]
    assert named.law_constants == {"mu": 2e4}
    for wrong in ("1:rigid,density=1900,c10=2e3", "1:young=3e4,poisson=0.45,density=1050,c20=2e3"):
        with pytest.raises(MjframesError, match="with --law also bulk, c01, c10, mu, segments"):
            parse_material(wrong)


@pytest.mark.parametrize(
    "text",
    [
        "flesh:young=3e4,poisson=0.45,density=1050",
        "0:rigid,density=1900",
        "1:young=3e4,density=1050",
        "1:rigid,young=3e4,density=1050",
        "1:rigid=yes,density=1050",
        "1:young=much,poisson=0.45,density=1050",
        "1:young=-1,poisson=0.45,density=1050",
        "1:rigid,density=1900,rgba=red",
        "1:rigid,density=1900,rgba=1/1",
        "1:rigid,density=1900,rgba=1/1/2",
        "1:rigid,density=1900,colour=red",
        "1:young=3e4,poisson=0.45,density=1050,young=4e4",
        "1",
    ],
)
def test_bad_flags(text: str) -> None:
    with pytest.raises(MjframesError, match="--material"):
        parse_material(text)


def test_materials_in_a_file() -> None:
    Path("m.yaml").write_text(
        "1: {name: flesh, young: 3e4, poisson: 0.45, density: 1050}  # YAML reads 3e4 as text\n"
        "2: {rigid: true, density: 1900, rgba: [0.9, 0.9, 0.8]}\n"
        "fill: {name: flesh, young: 30000, poisson: 0.45, density: 1050}\n"
    )
    assert read_materials("m.yaml") == Materials({1: FLESH, 2: BONE}, FLESH)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "it holds no materials"),
        ("- 1", "it holds no materials"),
        ("1: {", "this is no YAML"),
        ("flesh: {rigid: true, density: 9}", "material flesh must be called by a label"),
        ("1: flesh", "material 1 is 'flesh'"),
        ("1: {rigid: yes please, density: 9}", "material 1 has density; it needs"),
        ("1: {rigid: true, density: heavy}", "material 1 has a value that is no number"),
        ("1: {young: true, poisson: 0.3, density: 9}", "material 1 has a value that is no number"),
        ("1: {rigid: true, density: 9}\n1: {rigid: true, density: 8}", "1 stands there twice, again in line 2; leave"),
        ("1: {rigid: true, density: 9,\n density: 8}", "'density' stands there twice, again in line 2; leave one"),
        ("[1]: {rigid: true}", "this is no YAML"),
        ("1: {rigid: true, density: -9}", "material 1: density is -9"),
    ],
)
def test_bad_files_of_materials(text: str, message: str) -> None:
    Path("m.yaml").write_text(text)
    with pytest.raises(MjframesError, match=message) as error:
        read_materials("m.yaml")
    assert str(error.value).startswith("m.yaml: ")
    assert "\n" not in str(error.value)


def test_meshes_get_the_materials_of_their_places() -> None:
    both = volume("box.stl", "small.ply", materials=Materials({1: FLESH, 2: BONE}), spacing=(0.005,) * 3, scale=1e-3)
    assert [int((both.labels == label).sum()) for label in (1, 2)] == [120, 8]
    assert both.materials == {1: FLESH, 2: BONE}


def test_the_rest_of_an_images_hull_can_be_filled_and_its_noise_dropped() -> None:
    labels = np.zeros((9, 4, 4), np.uint8)
    labels[:3], labels[6:] = 1, 1
    labels[4, 1, 1] = 7
    np.save("two.npy", labels)
    options = {"spacing": (0.01,) * 3, "materials": Materials({1: BONE}, FLESH)}
    with pytest.raises(MjframesError, match=r"label 7 has no material; .* --drop-unknown"):
        volume("two.npy", **options)
    filled = volume("two.npy", **options, drop_unknown=True)
    assert [int((filled.labels == label).sum()) for label in (0, 1, 2)] == [0, 96, 48]
    assert filled.materials == {1: BONE, 2: FLESH}


def test_a_number_of_voxels_is_chosen_for_meshes_and_said() -> None:
    with pytest.warns(Notice, match=r"about 20000 voxels are made; choose with --spacing METRES or --voxels N"):
        assert np.count_nonzero(volume("box.stl", scale=1e-3).labels) == pytest.approx(20_000, rel=0.1)


@pytest.mark.parametrize("name", ["box.stl", "labels.npy"])
@pytest.mark.parametrize(("up", "upwards"), [("y", 1), ("-y", 1), ("x", 0), ("-x", 0), ("-z", 2)])
def test_what_points_up_can_be_said(name: str, up: str, upwards: int) -> None:
    np.save("labels.npy", np.ones((4, 2, 3), np.uint8))
    plain, turned = (volume(name, spacing=(5.0,) * 3, up=some) for some in ("z", up))
    sign = -1 if up[0] == "-" else 1
    np.testing.assert_allclose(turned.axes[2], sign * plain.axes[upwards], atol=1e-12)
    np.testing.assert_allclose(turned.origin[2], sign * plain.origin[upwards], atol=1e-12)
    assert np.linalg.det(turned.axes) == pytest.approx(1)
    np.testing.assert_array_equal(turned.labels, plain.labels)
    with pytest.raises(MjframesError, match=r"^up is 'w'; it must be one of 'x', 'y', 'z', '-x'"):
        volume(name, spacing=(5.0,) * 3, up="w")


def test_a_label_has_one_material() -> None:
    same = ["1:rigid,density=1900", "2:rigid,density=1900", "1=bone:rigid,density=1900"]
    with pytest.raises(MjframesError, match=r"^--material '1=bone:.*' is the second one for label 1; give each"):
        parse_materials(same)
    assert set(parse_materials(same[:2])) == {1, 2}


def test_an_image_can_be_resampled() -> None:
    assert volume("labels.npy", spacing=(0.01,) * 3, voxels=512).labels.shape == (8, 8, 8)


@pytest.mark.parametrize(
    ("names", "options", "message"),
    [
        (["box.stl", "labels.npy"], {}, "labels.npy: meshes are given and this is none"),
        (["labels.npy", "labels.npy"], {}, "more than one label image"),
        (["labels.npy"], {"spacing": (1, 1, 1), "scale": 0.1}, "--unit and --scale are for meshes"),
        (["box.stl"], {"voxels": 9, "drop_unknown": True}, "every mesh needs a material"),
        (["box.stl", "box.stl"], {}, "box.stl: mesh 2 has no material"),
        (
            ["box.stl", "small.ply"],
            {"materials": Materials()},
            "box.stl: mesh 1 has no material, small.ply: mesh 2 has no material; give one with --material 1=NAME:… ",
        ),
        (
            ["labels.npy"],
            {"spacing": (1, 1, 1), "materials": Materials({1: FLESH, 2: BONE})},
            "labels.npy: material 2 is given, but no voxel has this label; the labels are 1.",
        ),
        (["box.stl"], {"materials": Materials({1: FLESH, 2: BONE})}, "material 2 has no mesh"),
        (["box.stl"], {"spacing": (1, 1, 1), "voxels": 9}, "give exactly one"),
    ],
)
def test_what_does_not_go_together(names: list[str], options: dict[str, Any], message: str) -> None:
    with pytest.raises(MjframesError, match=message):
        volume(*names, **options)
