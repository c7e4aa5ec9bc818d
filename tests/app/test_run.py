"""Runs: what is measured is right, what is written is whole, and what fails leaves nothing behind."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from builders.pictures import picture, share
from builders.scenes import FLOOR, compiled
from builders.stacked import block

from mjframes.app.log.read import read_log
from mjframes.app.measure import kinetic_energy, penetration
from mjframes.app.recording import Instant, Recording, summary
from mjframes.app.run import record
from mjframes.app.video import find_camera
from mjframes.base.errors import MjframesError
from mjframes.body.build import build
from mjframes.scene.load import load_scene, mujoco_warnings
from mjframes.scene.scene_file import standalone_scene
from mjframes.scene.view import soft
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

SCENE = """
<mujoco>
  <worldbody>
    <light pos="0 0 3"/>
    <camera name="side" pos="0 -2 .5" xyaxes="1 0 0 0 0 1"/>
    <camera name="top" pos="0 0 3"/>
    <geom type="plane" size="1 1 .1" rgba=".2 .3 .4 1"/>
    <body pos="0 0 .3"><freejoint/><geom type="box" size=".1 .1 .1" mass="2" rgba="1 0 0 1"/></body>
  </worldbody>
</mujoco>
"""
PENDULUM = """
<mujoco>
  <option timestep="1e-4"/>
  <worldbody>
    <body pos="0 0 1" euler="0 40 0">
      <joint axis="0 1 0" stiffness="3" armature=".02"/><geom type="capsule" size=".03" fromto="0 0 0 .3 0 0"/>
      <body pos=".3 0 0">
        <joint axis="0 0 1"/><joint type="slide" axis="0 1 0" stiffness="50"/>
        <geom type="box" size=".1 .02 .05" pos=".1 0 0"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def model_of(xml: str) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(xml)


def test_kinetic_energy_is_mujocos_where_the_mass_matrix_is_plain() -> None:
    model = model_of(PENDULUM)
    model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_ENERGY)
    data = mujoco.MjData(model)
    data.qpos[:] = 0.3, -0.7, 0.05
    data.qvel[:] = 2.0, -3.0, 0.4
    mujoco.mj_forward(model, data)
    assert kinetic_energy(model, data, data.qvel) == pytest.approx(data.energy[1], rel=1e-12)


def test_energy_of_a_spring_pendulum_is_conserved() -> None:
    recording = record(model_of(PENDULUM), 0.5)
    kinetic = [instant.kinetic for instant in recording.instants]
    assert max(kinetic) > 0.5
    assert np.ptp(recording.energy) < 1e-3 * max(kinetic)
    assert len(recording.instants) == recording.steps == 5000


def test_instants_of_a_long_run_are_spread_and_end_with_it() -> None:
    recording = record(model_of(PENDULUM), 1.2)
    times = np.array([instant.time for instant in recording.instants])
    assert recording.steps == 12000
    assert len(times) <= 5000
    assert times[0] == 0
    assert times[-1] == pytest.approx(1.2 - 1e-4)
    assert np.diff(times)[:-1] == pytest.approx(3e-4)


def test_a_box_that_falls_and_rests() -> None:
    recording = record(model_of(SCENE), 2.0)
    first, last = recording.instants[0], recording.instants[-1]
    fall = np.array([i.speed for i in recording.instants if i.contacts == 0 and i.time < 0.19])
    assert fall.max() == pytest.approx(9.81 * 0.188, rel=0.02)
    assert first.potential - last.potential == pytest.approx(2 * 9.81 * 0.2, rel=0.01)
    assert last.normal_force == pytest.approx(recording.weight, rel=1e-3)
    assert recording.weight == pytest.approx(2 * 9.81)
    assert last.contacts == 4
    assert recording.penetration > 5 * recording.final_penetration > 0
    assert recording.energy_gain < 1e-6
    assert recording.penetration == max(i.penetration for i in recording.instants) >= last.penetration


def test_penetration_is_the_deepest_of_the_contacts() -> None:
    model = model_of(
        '<mujoco><worldbody><geom type="plane" size="1 1 1"/><body pos="0 0 .09"><freejoint/><geom size=".1"/></body>'
        '<body pos="1 0 .07"><freejoint/><geom size=".1"/></body></worldbody></mujoco>'
    )
    data = mujoco.MjData(model)
    assert penetration(data) == 0
    mujoco.mj_forward(model, data)
    assert penetration(data) == pytest.approx(0.03)


def test_video_log_and_plot(tmp_path: Path) -> None:
    av = pytest.importorskip("av")
    folder = tmp_path / "new" / "folder"
    video, log, plot = folder / "out.mp4", folder / "out.mcap", folder / "out.png"
    recording = record(model_of(SCENE), 0.5, video=video, log=log, plot=plot, camera="top", fps=20, size=(96, 64))
    assert set(folder.iterdir()) == {video, log, plot}
    with av.open(str(video)) as container:
        stream = container.streams.video[0]
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]
    assert stream.codec_context.name == "h264"
    assert stream.average_rate == 20
    assert stream.pix_fmt == "yuv420p"
    assert len(frames) == 10
    assert frames[0].shape == (64, 96, 3)
    red = frames[-1].astype(int)
    assert 8 < (red[..., 0] - red[..., 2] > 60).sum() < 100  # the box from above, on a blue floor
    assert video.read_bytes().find(b"moov") < video.read_bytes().find(b"mdat")  # streams at once
    assert min(share(picture(plot), color) for color in ("C0", "C1", "tab:red", "tab:green")) > 3e-4

    messages = read_log(log).messages
    assert [message["time"] for message in messages["/energy"]] == [i.time for i in recording.instants]
    assert len(messages["/state"]) == 11  # of each frame, and the last


def test_a_diverging_simulation_leaves_nothing(tmp_path: Path) -> None:
    model = model_of(SCENE.replace("<worldbody>", '<option timestep=".001"/><worldbody>'))
    model.opt.gravity[2] = -1e14
    (tmp_path / "out.mcap").write_text("older")
    with pytest.raises(MjframesError, match=r"diverged: Nan, Inf or huge value .* Time = "):
        record(model, 1.0, log=tmp_path / "out.mcap", plot=tmp_path / "out.png")
    assert [path.name for path in tmp_path.iterdir()] == ["out.mcap"]
    assert (tmp_path / "out.mcap").read_text() == "older"


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"duration": 0.0}, "duration is 0.0"),
        ({"duration": float("nan")}, "duration is nan"),
        ({"video": "a.mp4", "camera": "front"}, "camera 'front' is not in the scene; its cameras are side, top"),
        ({"video": "a.mp4", "size": (95, 64)}, "size is 95x64"),
        ({"video": "a.mp4", "fps": 0.0}, "fps is 0.0"),
        ({"video": "a.gif"}, r"a\.gif: a video is written as"),
        ({"plot": "a.txt"}, r"a\.txt: a plot is written as"),
        ({"log": "file/a.mcap"}, r"a\.mcap: the log cannot be written there"),
        ({"log": "folder.mcap"}, r"folder\.mcap: the log cannot be written there \(it is a directory\)"),
    ],
)
def test_refuses(keys: dict, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("")
    (tmp_path / "folder.mcap").mkdir()
    with pytest.raises(MjframesError, match=message):
        record(model_of(SCENE), **{"duration": 0.1, **keys})
    assert {path.name for path in tmp_path.iterdir()} == {"file", "folder.mcap"}


def test_what_is_no_model_or_no_time_is_refused() -> None:
    anything: Any = "floor.xml"
    with pytest.raises(MjframesError, match=r"^model is a str; give the MjModel that spec\.compile\(\) returns\.$"):
        record(anything, 1)
    with pytest.raises(MjframesError, match=r"^duration is 'floor\.xml'; it must be a positive time"):
        record(model_of(SCENE), anything)


@pytest.mark.parametrize(
    ("module", "keys", "extra"),
    [
        ("av", {"video": "a.mp4"}, "video"),
        ("mcap.writer", {"log": "a.mcap"}, "log"),
        ("matplotlib.figure", {"plot": "a.png"}, "plot"),
    ],
)
def test_missing_packages_are_named(module: str, keys: dict, extra: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MjframesError, match=rf'pip install "mjframes\[{extra}\]"'):
        record(model_of(SCENE), 0.1, **keys)


@pytest.mark.parametrize("timestep", [0.0, -0.001])
def test_a_timestep_that_is_none_is_refused(timestep: float) -> None:
    with pytest.raises(MjframesError, match=rf"^the scene's timestep is {timestep}; it must be a positive time"):
        record(model_of(f'<mujoco><option timestep="{timestep}"/></mujoco>'), 1.0)


def test_load_scene(tmp_path: Path) -> None:
    path = tmp_path / "scene.xml"
    path.write_text(SCENE)
    model, spec = load_scene(path)
    assert model.nv == 6
    assert "<worldbody>" in spec.to_xml()
    with pytest.raises(MjframesError, match=r"none\.xml: there is no such scene"):
        load_scene(tmp_path / "none.xml")
    path.write_text(SCENE.replace("plane", "plain"))
    with pytest.raises(MjframesError, match=r"scene\.xml: MuJoCo cannot load the scene \(.*plain.*\)\.$") as caught:
        load_scene(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("option", "value", "reason"),
    [
        ("integrator", mujoco.mjtIntegrator.mjINT_RK4, "RK4"),
        ("solver", mujoco.mjtSolver.mjSOL_PGS, "PGS"),
        ("disableflags", mujoco.mjtDisableBit.mjDSBL_SPRING | mujoco.mjtDisableBit.mjDSBL_DAMPER, "dampers"),
    ],
)
def test_the_plugins_reason_is_told(option: str, value: int, reason: str) -> None:
    rubber = Material(1e5, 0.4, 1000)
    volume = Volume.from_labels(np.ones((6, 3, 3), int), spacing=0.01, materials={1: rubber})
    model = standalone_scene(build(volume, 2), volume).compile()
    setattr(model.opt, option, value)
    with pytest.raises(MjframesError, match=rf"^MuJoCo cannot start the scene \(soft body 'soft': .*{reason}.*\)\.$"):
        record(model, 0.1)


def test_soft_bodies_are_logged_and_their_energy_never_grows(tmp_path: Path) -> None:
    volume = Volume.from_labels(np.ones((6, 3, 3), int), spacing=0.01, materials={1: Material(1e5, 0.4, 1000)})
    model = standalone_scene(build(volume, 2), volume, name="block").compile()
    recording = record(model, 1.0, log=tmp_path / "a.mcap")
    messages = read_log(tmp_path / "a.mcap").messages["/soft/block"]
    assert max(message["elastic"] for message in messages) > 0
    for instant, message in zip(recording.instants, messages, strict=True):
        assert instant.kinetic == pytest.approx(message["kinetic"], rel=1e-4, abs=1e-12)
    assert recording.weight == pytest.approx(54e-6 * 1000 * 9.81, rel=1e-6)
    assert recording.instants[-1].normal_force == pytest.approx(recording.weight, rel=0.01)
    assert recording.energy_gain < 1e-3 * np.ptp(recording.energy)


@pytest.mark.slow
def test_contact_forces_are_told_body_by_body(tmp_path: Path) -> None:
    """A soft block on another, and a rigid box beside them, each with its own curve; in the log as well."""
    slab, small = block((8, 8, 3), 0.01, 1000, beta=0.01), block((4, 4, 3), 0.01, 2000, beta=0.01)
    box = '<body pos=".3 0 .05"><freejoint/><geom type="box" size=".05 .05 .05" mass="2"/></body></worldbody>'
    upright = (1, 0, 0, 0)
    model, _ = compiled(
        FLOOR.replace("</worldbody>", box), (slab, (0, 0, 0.001), upright), (small, (0.02, 0.02, 0.032), upright)
    )
    recording = record(model, 1.0, log=tmp_path / "a.mcap", plot=tmp_path / "a.svg")
    last, weight = recording.instants[-1], 9.81 * np.array([192e-3, 96e-3])
    assert last.soft_force["soft0"] == pytest.approx(weight.sum() + weight[1], rel=0.02)
    assert last.soft_force["soft1"] == pytest.approx(weight[1], rel=0.02)
    assert last.rigid_force == pytest.approx(2 * 9.81, rel=1e-3)
    assert last.normal_force == pytest.approx(recording.weight + weight[1], rel=0.01)
    for instant, other in zip(recording.instants, read_log(tmp_path / "a.mcap").recording().instants, strict=True):
        assert (other.soft_force, other.rigid_force) == (instant.soft_force, instant.rigid_force)
    drawn = (tmp_path / "a.svg").read_text()
    assert [f"<!-- {label} -->" in drawn for label in ("on soft0", "on soft1", "between others")] == [True] * 3


def told(*energies: tuple[float, float, float], driven: bool = False) -> str:
    """The line on energy of instants with kinetic, potential and elastic energies [J].  driven: by actuators."""
    none = {"soft": 0.0}
    instants = [
        Instant(0.0, kinetic, potential, {"soft": elastic}, none, 0, 0.0, 0.0, none, 0.0, 0.0)
        for kinetic, potential, elastic in energies
    ]
    return summary(Recording(tuple(instants), (), 3, 0.5, 0.002, 20.0, driven=driven)).splitlines()[-1]


def test_the_line_on_energy_has_the_elastic_one() -> None:
    assert told((0, 10, 0), (3, 7, 0), (0, 6, 1)) == (
        "energy        4 J moved; kinetic, potential and elastic energy are 3 J less at the end than at the start, "
        "and never above it in between"
    )
    assert "are 1 J more at the end" in told((0, 10, 0), (3.5, 6, 0), (0, 10, 1))
    assert "0.5 J (12.5%) above it in between" in told((0, 10, 0), (3.5, 7, 0), (0, 6, 0))


def test_the_energy_of_stiff_strains_is_told_apart() -> None:
    """5 kJ of a body of 10¹¹ Pa that one step strained by a millionth; and a real gain, which is told as such."""
    text = told((0, 10, 0), (3, 7, 5e3), (0, 6, 0))
    assert text.endswith("between, of elastic energy alone: steps that turn very stiff bodies stretch them a little")
    assert "4 J less at the end" in text
    assert told((0, 10, 0), (3.5, 7, 5e3), (0, 6, 0)).endswith("above it in between")
    assert told((0, 10, 0), (1e-12, 10, 5e3), (0, 10, 0)) == "energy        nothing moved"


def test_what_actuators_bend_moves_elastic_energy() -> None:
    """A cable that pulled made "2020 %" of what moved: kinetic energy alone was said to."""
    line = told((0, 0, 0), (0.4, 0, 8), (0, 0, 8.8), driven=True)
    assert line.startswith("energy        8.8 J moved")
    assert "8.8 J (100.0%) above it in between; the work of the actuators is in it" in line


@pytest.mark.parametrize(("control", "is_told"), [(50.0, True), (0.0, False)])
def test_the_line_on_energy_names_the_work_of_actuators(control: float, is_told: bool) -> None:
    motor = '<actuator><motor name="motor" joint="hinge"/></actuator></mujoco>'
    swing = (
        '<mujoco><worldbody><body><joint name="hinge" axis="0 1 0"/><geom size=".1" pos=".3 0 0"/></body></worldbody>'
    )
    made = record(mujoco.MjModel.from_xml_string(swing + motor), 0.2, ctrl={"motor": -control})
    line = summary(made).splitlines()[-1]
    assert line.endswith("above it in between; the work of the actuators is in it") == is_told


@pytest.mark.parametrize("shape", ["cube", "ball", "rod", "plate"])
def test_the_camera_sees_all_of_the_body_wherever_it_goes(shape: str) -> None:
    a, b, c = np.indices((10, 10, 10)) - 4.5
    inside = {"cube": a > -9, "ball": a**2 + b**2 + c**2 < 25, "rod": (abs(a) < 1) & (abs(b) < 1), "plate": abs(c) < 1}
    labels = np.where(inside[shape], 1, 0)
    volume = Volume.from_labels(labels, spacing=0.01, materials={1: Material(3e4, 0.4, 1000)}, origin=(1, 2, 3))
    body = build(volume, 2)
    model = standalone_scene(body, volume, name="body").compile()
    model.opt.gravity[0] = 3.0  # it rolls or slides away
    model.geom_friction[:] = 1 if shape == "ball" else 0.01
    data = mujoco.MjData(model)
    centers = volume.origin + (np.argwhere(labels) + 0.5) * volume.spacing
    for _ in range(8):
        mujoco.mj_forward(model, data)
        seen = (soft(model, data, "body", body).positions(centers) - data.cam_xpos[0]) @ data.cam_xmat[0].reshape(3, 3)
        half = np.tan(np.radians(model.cam_fovy[0] / 2))
        assert (seen[:, 2] < 0).all()
        assert np.abs(seen[:, :2] / -seen[:, 2:]).max() < half
        mujoco.mj_step(model, data, nstep=100)
    assert data.subtree_com[0][0] > 0.3


def test_warnings_are_caught_and_given_back() -> None:
    def mine(message: str) -> None:
        pass

    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(mine)
    try:
        with mujoco_warnings():
            assert mujoco.get_mju_user_warning() is not mine
        assert mujoco.get_mju_user_warning() is mine
    finally:
        mujoco.set_mju_user_warning(before)


def test_cameras_are_found() -> None:
    model = model_of(SCENE)
    assert [find_camera(model, name) for name in (None, "side", "top")] == [0, 0, 1]
    assert find_camera(model_of(PENDULUM), None) == -1


def test_summary_tells_the_numbers() -> None:
    first = record(model_of(SCENE), 0.004).instants[0]
    depths = [0.003] + [0.001] * 999
    instants = tuple(replace(first, time=0.002 * k, penetration=depth) for k, depth in enumerate(depths))
    text = summary(Recording(instants, (), 1000, 0.5, 0.002, 20.0))
    assert "2000 steps/s, 4.00 × real time" in text
    assert "3.000 mm at most, 1.000 mm in the last second" in text
    assert "log " not in text
    text = summary(Recording(instants, (), 1000, 0.5, 0.002, 20.0, log_seconds=0.02))
    assert text.endswith("log           20.0 µs a step")
