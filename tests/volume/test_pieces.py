"""Mesh files of several pieces, and file types that other packages read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import meshio
import mujoco
import nibabel
import numpy as np
import pytest
import trimesh

import mjframes as mf
from mjframes.cli.commands import main

FLESH = mf.Material(2e4, 0.45, 1000)


def box(size: float, x: float) -> trimesh.Trimesh:
    made = trimesh.creation.box((size,) * 3)
    made.apply_translation((x, 0, 0))
    return made


@pytest.fixture
def parts(tmp_path: Path) -> Path:
    path = tmp_path / "parts.stl"
    shell, hole = box(4, 0), box(2, 0)
    hole.invert()
    trimesh.util.concatenate([box(2, 9), shell, hole]).export(path)
    return path


def scene() -> Any:
    made = trimesh.Scene()
    for name, x in (("left", 0.0), ("right", 9.0)):
        made.add_geometry(box(2, x), geom_name=name, node_name=name)
    return made


def test_surfaces_that_are_not_connected_are_pieces_and_cavities_stay_in_theirs(parts: Path) -> None:
    pieces = mf.load_pieces(parts)
    assert list(pieces) == ["1", "2"]
    assert [len(piece.faces) for piece in pieces.values()] == [24, 12]
    assert pieces["1"].volume == pytest.approx(64 - 8)
    volume = mf.Volume.from_meshes([(pieces["2"], FLESH)], 0.001, scale=1e-3)
    assert volume.labels.size == 8
    assert volume.origin[0] == pytest.approx(0.008)


@pytest.mark.parametrize(("kind", "unit"), [("3mf", 1e-3), ("glb", 1.0)])
def test_objects_have_the_names_and_the_unit_of_the_file(tmp_path: Path, kind: str, unit: float) -> None:
    path = tmp_path / f"two.{kind}"
    path.write_bytes(scene().export(file_type=kind))
    pieces = mf.load_pieces(path)
    assert set(pieces) == {"left", "right"}
    assert pieces["right"].bounds[0, 0] == pytest.approx(8)
    assert (mf.Volume.from_meshes([(path, FLESH)], 0.5 * unit).labels != 0).sum() == 2 * 64
    assert (mf.Volume.from_meshes([(path, FLESH)], 0.05, scale=0.1).labels != 0).sum() == 2 * 64
    assert mf.Volume.from_meshes([(pieces["right"], FLESH)], 0.5 * unit).origin[0] == pytest.approx(8 * unit)


def test_a_3mf_of_one_object_is_taken_apart_in_its_unit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "one.3mf"
    content: Any = trimesh.Scene(trimesh.util.concatenate([box(4, 0), box(2, 9)])).export(file_type="3mf")
    path.write_bytes(content)
    pieces = mf.load_pieces(path)
    assert [piece.units for piece in pieces.values()] == ["millimeter"] * 2
    command = ["build", str(path), "--pieces", "--frames", "1", "--material", "default=fat"]
    command += ["-o", str(tmp_path / "a.npz")]
    assert main([*command, "--spacing", "0.001"]) == 0
    assert "size: 4 × 4 × 4 mm" in capsys.readouterr().out
    assert main([*command, "--spacing", "0.01", "--unit", "cm"]) == 0
    assert "size: 40 × 40 × 40 mm" in capsys.readouterr().out


def test_a_unit_that_nobody_knows_is_refused() -> None:
    strange = box(2, 0)
    strange.units = "ells"
    with pytest.raises(mf.MjframesError, match="mesh 1: its unit is 'ells'; give its length in metres as scale"):
        mf.Volume.from_meshes([(strange, FLESH)], 0.5)
    assert mf.Volume.from_meshes([(strange, FLESH)], 0.5, scale=1.0).labels.size == 64


def test_gltf_is_read(tmp_path: Path) -> None:
    for name, content in scene().export(file_type="gltf").items():
        (tmp_path / name).write_bytes(content)
    assert set(mf.load_pieces(tmp_path / "model.gltf")) == {"left", "right"}


def test_a_body_is_built_of_each_piece(parts: Path, tmp_path: Path) -> None:
    command = ["build", str(parts), "--pieces", "--unit", "mm", "--voxels", "60", "--frames", "1"]
    command += ["--material", "default=stuff:young=1e5,poisson=.4,density=1000"]
    assert main([*command, "-o", str(tmp_path / "a.npz")]) == 0
    masses = [mf.SoftBody.load(tmp_path / f"a-{number}.npz").control.mass.sum() for number in (1, 2)]
    assert masses == pytest.approx([56e-6, 8e-6], rel=0.1)
    (tmp_path / "empty.xml").write_text("<mujoco/>")
    into = ["--into", str(tmp_path / "empty.xml"), "--name", "part"]
    assert main([*command, *into, "-o", str(tmp_path / "both.xml")]) == 0
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "both.xml"))
    assert model.body("part_1").id > 0
    assert model.body("part_2").id > 0
    assert main([*command, str(parts), "-o", str(tmp_path / "c.npz")]) == 2


@pytest.mark.parametrize("kind", ["stl", "glb"])
def test_warnings_name_the_file_and_the_piece(tmp_path: Path, kind: str, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / f"large.{kind}"
    content = scene().to_mesh() if kind == "stl" else scene()
    content.apply_scale(50).export(path)
    first, second = mf.load_pieces(path)
    command = ["build", str(path), "--pieces", "--spacing", "25", "--frames", "1", "--material", "default=fat"]
    assert main([*command, "-o", str(tmp_path / "a.npz")]) == 0
    for line, name in zip(capsys.readouterr().err.splitlines(), (first, second), strict=True):
        assert line.startswith(f"mjframes: {path}, piece {name}: the body is 100 m long; if its unit is another, ")
    copied = path.rename(path.with_stem("other"))  # has the same contents, not the same name
    with pytest.warns(mf.MeshWarning, match=rf"other\.{kind}, piece {second}: the body is"):
        mf.Volume.from_meshes([(mf.load_pieces(copied)[second], FLESH)], 25)


def test_each_piece_may_have_its_own_material(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "two.glb"
    path.write_bytes(scene().export(file_type="glb"))
    first, second = mf.load_pieces(path)
    command = ["build", str(path), "--pieces", "--unit", "mm", "--voxels", "30", "--frames", "1"]
    command += ["-o", str(tmp_path / "a.npz")]

    def built(*materials: str) -> list[str]:
        assert main([*command, *(word for text in materials for word in ("--material", text))]) == 0
        return [mf.SoftBody.load(tmp_path / f"a-{name}.npz").materials[1].name for name in (first, second)]

    assert built(f"{second}=fat", f"{first}=liver") == ["liver", "fat"]
    assert built("2=fat", "1=liver") == ["liver", "fat"]
    assert built("default=fat", f"{first}=liver:young=9e3") == ["liver", "fat"]
    (tmp_path / "m.yaml").write_text("2: fat\ndefault: liver")
    command += ["--materials", str(tmp_path / "m.yaml")]
    assert built() == ["liver", "fat"]
    capsys.readouterr()
    for text, sentence in (
        ("middle=fat", f"--material 'middle=fat' is of no piece of {path}; its pieces are {first}, {second}: write a "),
        ("3=fat", f"--material '3=fat' is of no piece of {path}; its pieces are {first}, {second}: write a "),
    ):
        assert main([*command, "--material", text]) == 2
        assert sentence in capsys.readouterr().err
    (tmp_path / "m.yaml").write_text("2: fat")
    assert main(command) == 2
    assert f"piece {first!r} has no material; give one with --material {first}=NAME:" in capsys.readouterr().err
    (tmp_path / "m.yaml").write_text("3: fat\ndefault: liver")
    assert main(command) == 2
    assert f"material 3 has no piece; {path} has 2: {first}, {second}." in capsys.readouterr().err


@pytest.mark.parametrize("kind", ["vtu", "msh", "vtk"])
def test_solid_elements_are_read_by_their_outer_faces(tmp_path: Path, kind: str) -> None:
    corners = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1, 2)], float)
    brick = np.array([[0, 1, 4, 3, 6, 7, 10, 9], [1, 2, 5, 4, 7, 8, 11, 10]])
    tetra = np.array([[0, 1, 3, 4], [1, 2, 3, 6], [1, 3, 4, 6], [1, 4, 5, 6], [3, 4, 6, 7]])
    meshio.write(tmp_path / f"brick.{kind}", meshio.Mesh(corners, [("hexahedron", brick)]))
    meshio.write(tmp_path / f"tetra.{kind}", meshio.Mesh(corners[[0, 1, 4, 3, 6, 7, 10, 9]], [("tetra", tetra)]))
    for name, voxels in (("brick", 2 * 64), ("tetra", 64)):
        volume = mf.Volume.from_meshes([(tmp_path / f"{name}.{kind}", FLESH)], 0.25)
        assert np.count_nonzero(volume.labels) == voxels


def test_freesurfers_images_are_read(tmp_path: Path) -> None:
    labels: Any = np.zeros((4, 3, 2), np.uint8)
    labels[1:, :, :] = 7
    affine = np.diag([1.0, 1.0, 2.0, 1.0])
    nibabel.save(nibabel.MGHImage(labels, affine), tmp_path / "seg.mgz")
    volume = mf.Volume.load(tmp_path / "seg.mgz", materials={7: FLESH})
    np.testing.assert_array_equal(volume.labels, labels)
    np.testing.assert_allclose(volume.spacing, (1e-3, 1e-3, 2e-3))


def test_a_wrong_type_is_named(tmp_path: Path) -> None:
    with pytest.raises(mf.MjframesError, match=r"a\.step: meshes of type \.step cannot be read; give \.obj, .*\.vtu"):
        mf.Volume.from_meshes([(tmp_path / "a.step", FLESH)])
    with pytest.raises(mf.MjframesError, match=r"a\.dcm: files of type \.dcm .* label images are \.npz, .* meshes are"):
        mf.Volume.load(tmp_path / "a.dcm")
    (tmp_path / "bad.vtu").write_text("no")
    with pytest.raises(mf.MjframesError, match=r"bad\.vtu: the file is damaged"):
        mf.Volume.from_meshes([(tmp_path / "bad.vtu", FLESH)])
