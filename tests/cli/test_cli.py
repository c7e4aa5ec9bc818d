"""The command line: exit codes, one sentence for a mistake, outputs."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh
from builders.pictures import film, share

from mjframes.app.log.read import read_log
from mjframes.body.build import build
from mjframes.cli.commands import main
from mjframes.scene import solver
from mjframes.scene.load import load_scene
from mjframes.scene.view import soft, soft_names
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

SCENE = """
<mujoco><worldbody><geom type="plane" size="1 1 .1"/>
<body pos="0 0 .11"><freejoint/><geom type="box" size=".1 .1 .1" rgba="1 0 0 1"/></body></worldbody></mujoco>
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
    assert [line.split()[0] for line in captured.out.splitlines()] == [
        *("steps", "speed", "penetration", "energy", "log")
    ]
    assert "100 of 2 ms" in captured.out
    assert log.is_file()


def test_a_log_is_replayed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "scene.xml").write_text(SCENE)
    log, plot, video = (tmp_path / f"run{ending}" for ending in (".mcap", ".svg", ".mp4"))
    command = ["run", str(tmp_path / "scene.xml"), "--duration", "0.2", "--log", str(log)]
    assert main([*command, "--log-rate", "100", "--log-topics", "state,energy,contacts"]) == 0
    (tmp_path / "scene.xml").unlink()
    capsys.readouterr()
    asked = ["--state", "0.1", "--plot", str(plot), "--video", str(video), "--size", "64x48"]
    assert main(["replay", str(log), *asked]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    state = json.loads(captured.out)
    assert state["time"] == pytest.approx(0.1)
    assert len(state["qpos"]) == 7
    assert state["qpos"][2] == pytest.approx(0.1, abs=2e-3)
    assert {"#1f77b4", "#ff7f0e", "#d62728"} <= set(re.findall(r"#[0-9a-f]{6}", plot.read_text()))  # of its curves
    shown = film(video)
    assert len(shown) == 6
    assert min(share(frame, "red") for frame in shown) > 0.1
    assert main(["replay", str(log)]) == 2
    assert "nothing is asked for; give --video, --plot or --state" in capsys.readouterr().err
    log.write_bytes(log.read_bytes()[:-500])  # as a killed run leaves it
    assert main(["replay", str(log), "--state", "0"]) == 0
    assert re.search(r"^mjframes: .*run\.mcap: the log was cut off at 0\.19 s; .*\n$", capsys.readouterr().err)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", "none.xml"], "none.xml: there is no such scene"),
        (["run", "scene.xml", "--duration", "-1"], "duration is -1.0"),
        (["run", "scene.xml", "--size", "big"], "'big' is not WIDTHxHEIGHT"),
        (["run", "scene.xml", "--duration", ".1", "--video", "a.mp4", "--camera", "x"], "it has no named cameras"),
        (["run", "scene.xml", "--log-rate", "5"], "--log-rate and --log-topics are of a log; give --log FILE.mcap"),
        (["run", "scene.xml", "--log", "a.mcap", "--log-topics", "state,sound"], "'sound' is none of state, energy"),
        (["replay", "none.mcap"], "none.mcap: the log cannot be read (No such file or directory)"),
        (["replay", "none.mcap", "--state", "0"], "none.mcap: the log cannot be read"),
        (["view", "scene.xml", "--port", "80"], "--host and --port are of a page; give --web as well"),
        (["view", "scene.xml", "--web", "--port", "x"], "'x' is not a whole number from 0 to 65535"),
        (["view", "scene.xml", "--web", "--host", "nowhere.invalid"], "nothing can be served at nowhere.invalid:8080"),
        (["run"], "the following arguments are required: SCENE; see mjframes run --help."),
        (["build", "none.npz", "-o", "a.xml"], "none.npz"),
        (["build", "none.npz", "-o", "a.obj"], "a.obj: the output is"),
        (["build", "none.npz", "-o", "a.xml", "--frames", "0"], "'0' is not a whole number"),
        (["build", "none.npz", "-o", "a.xml", "--spacing", "1,2"], "'1,2' is not one length"),
        (["build", "none.npz", "-o", "a.xml", "--material", "1"], "--material '1'"),
        (["build", "none.obj", "-o", "a.xml", "--fill", "lard"], "--fill 'lard' has no values"),
        (["build", "none.obj", "-o", "a.xml", "--materials", "no.yaml"], "no.yaml: the materials cannot be read"),
        (["build", "none.obj", "-o", "a.xml", "--unit", "mm", "--scale", "2"], "not allowed with"),
        (["build", "none.obj", "-o", "a.xml", "--scale", "-2"], "'-2' is not a positive number"),
        (["build", "none.obj", "-o", "a.xml", "--voxels", "9", "--material", FLESH], "none.obj: there is no such file"),
        (["build", "none.stl", "-o", "a.xml"], "none.stl: there is no such file; give the path of a mesh"),
        (["build", "none.npz", "-o", "a.xml", "--seed", "-1"], "'-1' is not a whole number from 0 on"),
        (["build", "none.npz", "-o", "new/folder/a.xml"], "none.npz: there is no such file"),
        (["build", "none.npz", "-o", "a.npz", "--fragment"], "--into and --fragment write MJCF"),
        (["build", "none.npz", "-o", "a.xml", "--pos", "1,2"], "'1,2' is not three coordinates"),
        (["build", "none.npz", "-o", "a.xml", "--quat", "1,0,0"], "'1,0,0' is not a quaternion"),
        (["build", "none.npz", "-o", "a.xml", "--quat", "0,0,0,0"], "'0,0,0,0' is not a quaternion"),
        (["build", "none.npz", "-o", "a.xml", "--quat", "1,0,nan,0"], "'1,0,nan,0' is not a quaternion"),
        (["build", "none.npz", "-o", "a.xml", "--quat", "1,0,1,0"], "--quat places the body in the scene of --into"),
        (["build", "none.npz", "-o", "a.xml", "--up", "w"], "argument --up: invalid choice: 'w'"),
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


@pytest.mark.parametrize("options", [(), ("--no-dents",), ("--no-contact",)], ids=" ".join)
def test_build_says_how_a_body_touches(body: Path, tmp_path: Path, options: tuple[str, ...]) -> None:
    assert main(["build", str(body), "-o", str(tmp_path / "scene.xml"), *options]) == 0
    text = (tmp_path / "scene.xml").read_text()
    assert ("patch_dent" in text) == (not options)
    assert ("patch_size" in text) == ("--no-contact" not in options)


def test_build_saves_a_soft_body(volume: Path, tmp_path: Path) -> None:
    from mjframes.body.soft_body import SoftBody

    assert main(["build", str(volume), "-o", str(tmp_path / "body.npz"), "--frames", "2"]) == 0
    assert isinstance(SoftBody.load(str(tmp_path / "body.npz")), SoftBody)
    assert {path.name for path in tmp_path.iterdir()} == {"bar.npz", "body.npz"}


@pytest.fixture
def body(volume: Path) -> Path:
    path = volume.with_name("body.npz")
    build(volume, 2, damping=(0.5, 0)).save(str(path))
    return path


def test_a_better_solver_is_recommended_where_the_scene_is_the_users(
    body: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "empty.xml").write_text("<mujoco/>")
    scene = str(tmp_path / "scene.xml")
    monkeypatch.setattr(solver, "FEW", 23)
    assert main(["build", str(body), "--into", str(tmp_path / "empty.xml"), "-o", scene]) == 0
    better = '<option solver="CG" jacobian="sparse"><flag midphase="disable"/></option>'
    assert f"faster with {better}" in capsys.readouterr().out
    assert main(["run", scene, "--duration", "0.01"]) == 0
    assert better in capsys.readouterr().out
    assert main(["build", str(body), "-o", scene]) == 0
    assert main(["run", scene, "--duration", "0.01"]) == 0
    assert "<option" not in capsys.readouterr().out


def test_build_takes_a_soft_body_as_it_is(body: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = tmp_path / "scene.xml"
    assert main(["build", str(body), "-o", str(scene)]) == 0
    assert "2 frames, 3 regions, 288 voxels, 24 degrees of freedom" in capsys.readouterr().out
    model = mujoco.MjModel.from_xml_path(str(scene))
    assert soft(model, mujoco.MjData(model), "soft").configuration["alpha"] == "0.5"
    before = scene.read_bytes()
    assert main(["build", str(body), "-o", str(scene), "--frame-type", "rigid"]) == 2
    assert "body.npz: this is a soft body, built already, to which --frame-type does nothing" in sentence(capsys)
    assert main(["build", str(body), str(body), "-o", str(scene)]) == 2
    assert "more than one file beside a soft body" in sentence(capsys)
    assert main(["build", str(body), "-o", str(tmp_path / "again.npz")]) == 2
    assert "this is a soft body already" in sentence(capsys)
    assert scene.read_bytes() == before


KITCHEN = """
<mujoco><compiler meshdir="parts"/><asset><mesh name="box" file="box.stl"/></asset>
<worldbody><body name="lift" pos="0 0 .1">
<joint name="up" type="slide" axis="0 0 1"/><geom type="mesh" mesh="box"/></body>
<body name="shelf" pos="0 1 .1"/>
<body name="ball" pos="1 0 .1"><freejoint name="free"/><geom size=".1"/></body></worldbody>
<keyframe><key name="raised" qpos=".5 1 2 3 0 1 0 0" qvel="1 2 3 4 5 6 7"/><key name="start"/></keyframe></mujoco>
"""


@pytest.mark.parametrize(
    ("parent", "below", "place"),
    [("world", "world", (0, 0, 1)), ("shelf", "shelf", (0, 0, 1)), ("lift", "world", (0, 0, 1.1))],
)
def test_build_puts_a_body_into_a_scene(
    body: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    parent: str,
    below: str,
    place: tuple[float, float, float],
) -> None:
    (tmp_path / "parts").mkdir()
    trimesh.creation.box(extents=(0.2, 0.2, 0.2)).export(tmp_path / "parts" / "box.stl")
    kitchen = tmp_path / "kitchen.xml"
    kitchen.write_text(KITCHEN)
    command = ["build", str(body), "--into", str(kitchen), "--name", "bar", "--parent", parent, "--pos=0,0,1"]
    command += ["--quat=1,0,0,-1"]
    for output in (tmp_path / "elsewhere" / "new.xml", kitchen):
        assert kitchen.read_text() == KITCHEN
        assert main([*command, "-o", str(output)]) == 0
        model = mujoco.MjModel.from_xml_path(str(output))
        assert model.body("bar").parentid == model.body(below).id
        assert model.body("bar").pos.tolist() == pytest.approx(place)
        assert model.body("bar").quat.tolist() == pytest.approx((0.5**0.5, 0, 0, -(0.5**0.5)))
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, 0)
        assert data.joint("up").qpos == 0.5
        assert data.joint("free").qpos.tolist() == [1, 2, 3, 0, 1, 0, 0]
        assert data.joint("free").qvel.tolist() == [2, 3, 4, 5, 6, 7]
        assert np.abs(data.qpos).sum() == pytest.approx(7.5)
        mujoco.mj_step(model, data)
    assert [path.name for path in (tmp_path / "elsewhere").iterdir()] == ["new.xml"]
    assert capsys.readouterr().out.count('faster with <option><flag midphase="disable"/></option>') == 2
    kept = kitchen.read_text()
    for wrong, message in (
        ([], "--name is 'bar', which .*kitchen.xml has already"),
        (
            ["--name", "other", "--parent", "table"],
            "--parent is 'table', but the bodies of .*kitchen.xml are: 'world', ",
        ),
        (["--name", "a b"], "name is 'a b'; use one or more letters"),
        (["--into", str(tmp_path / "none.xml")], "none.xml: there is no such scene"),
    ):
        assert main([*command, *wrong, "-o", str(kitchen)]) == 2
        assert re.search(message, sentence(capsys))
        assert kitchen.read_text() == kept


def test_a_fragment_can_be_attached_in_mjcf(body: Path, tmp_path: Path) -> None:
    assert main(["build", str(body), "--fragment", "--name", "bar", "-o", str(tmp_path / "bar.xml")]) == 0
    alone = mujoco.MjModel.from_xml_path(str(tmp_path / "bar.xml"))
    assert (alone.nlight, alone.ncam, alone.nmat) == (0, 0, 0)
    scene = """
    <mujoco><asset><model name="bar" file="bar.xml"/></asset><worldbody><geom type="plane" size="1 1 1"/>
    <frame pos="0 0 .1"><attach model="bar" body="bar" prefix="left_"/></frame>
    <frame pos="1 0 .1"><attach model="bar" body="bar" prefix="right_"/></frame></worldbody></mujoco>"""
    (tmp_path / "scene.xml").write_text(scene)
    model = load_scene(tmp_path / "scene.xml")[0]
    assert soft_names(model) == ["left_bar", "right_bar"]
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=200)
    assert data.ncon > 0
    assert not any(warning.number for warning in data.warning)


def test_results_that_cannot_be_printed_end_in_a_sentence(tmp_path: Path) -> None:
    if not Path("/dev/full").exists():
        pytest.skip("there is no device that is always full")
    (tmp_path / "scene.xml").write_text(SCENE)
    command = [sys.executable, "-m", "mjframes", "run", str(tmp_path / "scene.xml"), "--duration", "0.1"]
    with open("/dev/full", "w") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr == "mjframes: the results cannot be printed (No space left on device).\n"


@pytest.mark.parametrize("closed", [">&-", "2>&-", ">&- 2>&-"])
def test_where_a_stream_is_closed_a_command_does_its_work(tmp_path: Path, closed: str) -> None:
    (tmp_path / "scene.xml").write_text(SCENE)
    script = f'exec "{sys.executable}" -m mjframes run "{tmp_path}/scene.xml" --duration 0.1 --log "{tmp_path}/a.mcap"'
    done = subprocess.run(f"{script} {closed}", shell=True, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert ("steps" in done.stdout) == (closed == "2>&-")
    assert len(read_log(tmp_path / "a.mcap").states()) == 4


def test_too_little_memory_ends_in_a_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def greedy(*_: object) -> None:
        np.zeros(2**62, np.uint8)

    monkeypatch.setattr("mjframes.scene.load.load_scene", greedy)
    assert main(["run", str(tmp_path / "scene.xml")]) == 2
    assert re.match(r"mjframes: there is not enough memory \(Unable to allocate 4.00 EiB .*\); take ", sentence(capsys))


def test_a_run_that_is_terminated_leaves_nothing(tmp_path: Path) -> None:
    (tmp_path / "scene.xml").write_text(SCENE)
    log = tmp_path / "new" / "folder" / "run.mcap"
    command = [sys.executable, "-m", "mjframes", "run", str(tmp_path / "scene.xml"), "--log", str(log)]
    running = subprocess.Popen([*command, "--duration", "1e5"], stderr=subprocess.DEVNULL)
    try:
        while not (log.parent.is_dir() and list(log.parent.iterdir())):
            assert running.poll() is None
            time.sleep(0.05)
        running.terminate()
        assert running.wait(30) == 128 + signal.SIGTERM
    finally:
        running.kill()
    assert [path.name for path in tmp_path.iterdir()] == ["scene.xml"]


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


def test_size_and_mass_are_printed_and_odd_sizes_told_of(
    volume: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["build", str(volume), "--frames", "1", "-o", str(tmp_path / "a.npz")]
    assert main(command) == 0
    printed = capsys.readouterr()
    assert "size: 120 × 60 × 40 mm, mass: 0.364 kg\n" in printed.out
    assert printed.err == ""
    assert main([*command, "--spacing", "0.0003"]) == 0
    assert (
        "bar.npz: the body is 0.0036 m long; if its voxels have another size, give --spacing" in capsys.readouterr().err
    )
    assert main([*command, "--spacing", "1"]) == 0
    assert "the body is 12 m long" in capsys.readouterr().err
    trimesh.creation.box(extents=(4, 4, 4)).export(tmp_path / "box.stl")
    command = ["build", str(tmp_path / "box.stl"), "--voxels", "64", "--frames", "1", "--material", FLESH]
    for unit, is_odd in (("mm", True), ("cm", False), ("m", False), ("ft", False)):
        assert main([*command, "--unit", unit, "-o", str(tmp_path / "b.npz")]) == 0
        assert ("give scale or --unit" in capsys.readouterr().err) == is_odd


def test_commands_that_build_nothing_start_without_what_builds() -> None:
    """It takes twice as long to import as all else."""
    program = (
        "import contextlib, sys; from mjframes.cli.commands import main\n"
        "with contextlib.suppress(SystemExit): main(['run', '--help'])\n"
        "print(*(name for name in ('numba', 'mjframes.body.options') if name in sys.modules), file=sys.stderr)"
    )
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert "usage: mjframes run" in run.stdout
    assert run.stderr.split() == []
