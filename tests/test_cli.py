"""The command line: exit codes, one sentence for a mistake, outputs."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh

from mjframes.cli import main
from mjframes.material import Material
from mjframes.volume import Volume

SCENE = """
<mujoco><worldbody><geom type="plane" size="1 1 .1"/>
<body pos="0 0 .11"><freejoint/><geom type="box" size=".1 .1 .1"/></body></worldbody></mujoco>
"""
FLESH = "1=flesh:young=3e4,poisson=0.45,density=1050"
BONE = "2:rigid,density=1900,rgba=.9/.9/.8"


@pytest.fixture
def volume(tmp_path: Path) -> Path:
    labels = np.ones((12, 6, 4), int)
    labels[:3] = 2
    path = tmp_path / "bar.npz"
    materials = {1: Material(3e4, 0.45, 1050), 2: Material.rigid(1900)}
    Volume.from_labels(labels, spacing=0.01, materials=materials).save(path)
    return path


def sentence(capsys: pytest.CaptureFixture[str]) -> str:
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("mjframes: ")
    assert captured.err.count("\n") == 1
    return captured.err


def test_run_prints_what_it_measured(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "scene.xml").write_text(SCENE)
    log = tmp_path / "out" / "run.mcap"
    assert main(["run", str(tmp_path / "scene.xml"), "--duration", "0.2", "--log", str(log)]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    assert [line.split()[0] for line in captured.out.splitlines()] == ["steps", "speed", "penetration", "energy"]
    assert "100 of 2 ms" in captured.out
    assert log.is_file()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", "none.xml"], "none.xml: there is no such scene"),
        (["run", "scene.xml", "--duration", "-1"], "duration is -1.0"),
        (["run", "scene.xml", "--size", "big"], "'big' is not WIDTHxHEIGHT"),
        (["run", "scene.xml", "--duration", ".1", "--video", "a.mp4", "--camera", "x"], "it has no named cameras"),
        (["run"], "the following arguments are required: SCENE; see mjframes run --help."),
        (["build", "none.npz", "-o", "a.xml"], "none.npz"),
        (["build", "none.npz", "-o", "a.obj"], "a.obj: the output is"),
        (["build", "none.npz", "-o", "a.xml", "--frames", "0"], "'0' is not a whole number"),
        (["build", "none.npz", "-o", "a.xml", "--spacing", "1,2"], "'1,2' is not one length"),
        (["build", "none.npz", "-o", "a.xml", "--material", "1"], "--material '1'"),
        (["build", "none.obj", "-o", "a.xml", "--fill", "fat"], "--fill 'fat' has no values"),
        (["build", "none.obj", "-o", "a.xml", "--materials", "no.yaml"], "no.yaml: the materials cannot be read"),
        (["build", "none.obj", "-o", "a.xml", "--unit", "mm", "--scale", "2"], "not allowed with"),
        (["build", "none.obj", "-o", "a.xml", "--scale", "-2"], "'-2' is not a positive number"),
        (["build", "none.obj", "-o", "a.xml", "--voxels", "9", "--material", FLESH], "none.obj: there is no such file"),
        (["dance"], "invalid choice: 'dance'"),
    ],
)
def test_mistakes_end_in_one_sentence(
    arguments: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "scene.xml").write_text(SCENE)
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    assert message in sentence(capsys)
    assert [path.name for path in tmp_path.iterdir()] == ["scene.xml"]


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere a display is taken for granted")
def test_view_needs_a_display(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "scene.xml").write_text(SCENE)
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert main(["view", str(tmp_path / "scene.xml")]) == 2
    assert "there is no display" in sentence(capsys)


def test_build_writes_a_scene_that_runs(volume: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = tmp_path / "new" / "scene.xml"
    command = ["build", str(volume), "--frames", "2", "--material", FLESH, "--material", BONE]
    command += ["--method", "paper", "--samples", "4"]
    assert main([*command, "-o", str(scene)]) == 0
    assert "2 frames, 4 regions, 288 voxels, 24 degrees of freedom" in capsys.readouterr().out
    assert [path.name for path in scene.parent.iterdir()] == ["scene.xml"]
    model = mujoco.MjModel.from_xml_path(str(scene))
    assert model.body_mass.sum() == pytest.approx((216 * 1050 + 72 * 1900) * 1e-6, rel=1e-6)
    assert main(["run", str(scene), "--duration", "0.5"]) == 0
    assert "energy" in capsys.readouterr().out


def test_build_saves_a_soft_body(volume: Path, tmp_path: Path) -> None:
    from mjframes.body import SoftBody

    assert main(["build", str(volume), "-o", str(tmp_path / "body.npz"), "--frames", "2"]) == 0
    assert isinstance(SoftBody.load(str(tmp_path / "body.npz")), SoftBody)
    assert {path.name for path in tmp_path.iterdir()} == {"bar.npz", "body.npz"}


def test_build_takes_meshes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    trimesh.creation.box(extents=(120, 60, 60)).export(tmp_path / "flesh.stl")
    bone = trimesh.creation.box(extents=(40, 40, 40))
    trimesh.Trimesh(bone.vertices, bone.faces[:, ::-1], process=False).export(tmp_path / "bone.ply")
    (tmp_path / "materials.yaml").write_text(
        "1: {young: 3e4, poisson: 0.45, density: 1000}\n2: {rigid: true, density: 9}"
    )
    command = ["build", str(tmp_path / "flesh.stl"), str(tmp_path / "bone.ply"), "-o", str(tmp_path / "scene.xml")]
    command += ["--materials", str(tmp_path / "materials.yaml"), "--material", "2=bone:rigid,density=2000"]
    assert main([*command, "--unit", "mm", "--spacing", "0.01", "--frames", "2"]) == 0
    captured = capsys.readouterr()
    assert "432 voxels" in captured.out
    assert captured.err == f"mjframes: {tmp_path / 'bone.ply'}: it is inside out; the triangles were turned.\n"
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "scene.xml"))
    assert model.body_mass.sum() == pytest.approx(0.368 * 1 + 0.064 * 2, rel=1e-5)


def test_build_can_drop_small_pieces(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    labels = np.zeros((9, 4, 4), np.uint8)
    labels[:6], labels[7:] = 1, 1
    np.save(tmp_path / "two.npy", labels)
    command = ["build", str(tmp_path / "two.npy"), "--spacing", "0.01", "--material", FLESH, "--frames", "2"]
    command += ["-o", str(tmp_path / "body.npz")]
    assert main(command) == 2
    assert "2 unconnected pieces" in sentence(capsys)
    assert main([*command, "--largest"]) == 0
    captured = capsys.readouterr()
    assert "96 voxels" in captured.out
    assert captured.err == "mjframes: 32 of 128 voxels, not connected to the others, are dropped.\n"


def test_the_package_is_the_command() -> None:
    shown = subprocess.run([sys.executable, "-m", "mjframes", "--help"], capture_output=True, text=True, check=True)
    assert shown.stdout.startswith("usage: mjframes [-h] COMMAND")
