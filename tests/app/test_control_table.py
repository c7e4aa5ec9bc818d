"""Controls of a run: constant, over time, and what cannot be."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from mjframes.app.control_table import control_table
from mjframes.app.run import record
from mjframes.base.errors import MjframesError, Notice
from mjframes.cli.commands import main

SCENE = """<mujoco><option gravity="0 0 0"/><worldbody>
<body><joint name="x" type="slide" axis="1 0 0"/><geom size=".1" mass="2"/></body>
<body pos="0 1 0"><joint name="y" type="slide" axis="0 1 0"/><geom size=".1" mass="1"/></body></worldbody>
<actuator><motor name="push" joint="x" ctrlrange="-10 10"/><motor name="lift" joint="y"/></actuator>
<keyframe><key name="moving" qvel="3 0" ctrl="0 1" time="5"/><key qpos="0 7"/></keyframe></mujoco>"""
H = 0.002  # [s], MuJoCo's default step


def model() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(SCENE)


def speeds(**options: Any) -> np.ndarray:
    """(t, 2) at the start of each step, and after the last one."""
    return np.array([state.qvel for state in record(model(), 0.1, **options).states])


def test_constant_controls_push() -> None:
    time = H * np.arange(50)
    np.testing.assert_allclose(speeds(ctrl={"push": 4}), np.stack([2 * time, 0 * time], axis=1), atol=1e-12)


def test_controls_over_time_hold_until_the_next_ones(tmp_path: Path) -> None:
    (tmp_path / "push.csv").write_text("time,lift\n0.02, 1\n0.06,-2\n\n")
    time = H * np.arange(50)
    expected = np.clip(time - 0.02, 0, 0.04) - 2 * np.clip(time - 0.06, 0, None)
    np.testing.assert_allclose(speeds(ctrl=tmp_path / "push.csv")[:, 1], expected, atol=1e-12)
    np.save(tmp_path / "timed.npy", [[0, 0, 0], [0.02, 0, 1], [0.06, 0, -2]])
    np.testing.assert_allclose(speeds(ctrl=tmp_path / "timed.npy")[:, 1], expected, atol=1e-12)
    steps = np.zeros((31, 2))
    steps[10:, 1], steps[30:, 1] = 1, -2
    np.save(tmp_path / "steps.npy", steps)
    np.testing.assert_allclose(speeds(ctrl=str(tmp_path / "steps.npy"))[:, 1], expected, atol=1e-12)


def test_a_run_starts_from_a_keyframe() -> None:
    moving = record(model(), 0.1, keyframe="moving", ctrl={"push": 4})
    assert moving.states[0].time == 5
    time = H * np.arange(50)
    expected = np.stack([3 + 2 * time, time], axis=1)  # the keyframe's own control of `lift` stays
    np.testing.assert_allclose([state.qvel for state in moving.states], expected, atol=1e-12)
    assert record(model(), 0.01, keyframe=1).states[0].qpos[1] == 7


def test_the_command_line_takes_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "scene.xml").write_text(SCENE)
    log = str(tmp_path / "run.mcap")
    command = ["run", str(tmp_path / "scene.xml"), "--duration", "0.1", "--log", log]
    assert main([*command, "--ctrl", "push=-4,lift=30", "--keyframe", "1"]) == 0
    assert capsys.readouterr().err == ""
    assert main(["replay", log, "--state", "0.098"]) == 0
    assert '"qvel": [-0.19' in capsys.readouterr().out
    assert main([*command, "--ctrl", "push=40"]) == 0
    assert capsys.readouterr().err == ("mjframes: ctrl of push is 40, outside its range -10 to 10; MuJoCo clamps it.\n")
    for wrong, words in (
        (["--ctrl", "push=a"], "'push=a' is not NAME=VALUE,…"),
        (["--ctrl", "grip=1"], "ctrl has the actuator 'grip', but those of the scene are: 'push', 'lift'."),
        (["--keyframe", "end"], "keyframe is 'end', but those of the scene are: 'moving', 1."),
    ):
        assert main([*command, *wrong]) == 2
        assert words in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "it needs a header like time,push and a row"),
        ("push\n1\n", "it needs a header like time,push and a row"),
        ("time,grip\n0,1\n", "has the actuator 'grip', but those of the scene are"),
        ("time,push,push\n0,1,1\n", "has the actuator 'push' twice"),
        ("time,push\n0,1\n0,2\n", "its times must ascend, but 0 s follows 0 s"),
        ("time,push\n0,1\n1\n", "row 3 is not 2 numbers: '1'"),
        ("time,push\n0,nan\n", "it has values that are not finite"),
    ],
)
def test_files_that_are_no_table_are_refused(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(MjframesError, match=words):
        control_table(model(), tmp_path / "a.csv")


def test_arrays_of_another_shape_and_other_files_are_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.zeros((3, 4)))
    with pytest.raises(MjframesError, match=r"it has the shape \(3, 4\); with 2 controls it must be \(t, 3\), times"):
        control_table(model(), tmp_path / "a.npy")
    with pytest.raises(MjframesError, match=r"none\.csv: the controls cannot be read \(No such file"):
        control_table(model(), tmp_path / "none.csv")
    with pytest.raises(MjframesError, match=r"a\.txt: controls are NAME=VALUE,… or a file \.csv or \.npy"):
        control_table(model(), "a.txt")
    with pytest.raises(MjframesError, match="but the scene has no actuators"):
        control_table(mujoco.MjModel.from_xml_string("<mujoco/>"), {"a": 1})
    with pytest.warns(Notice, match="ctrl of push is -20, outside its range -10 to 10"):
        control_table(model(), {"push": -20})
