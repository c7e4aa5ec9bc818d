"""`mjframes build --fixed`: what is glued, and the sentence where nothing is."""

from __future__ import annotations

import argparse
from pathlib import Path

import mujoco
import numpy as np
import pytest

import mjframes as mf
from mjframes.base.texts import length
from mjframes.cli.arguments import joined
from mjframes.cli.commands import main
from mjframes.cli.fixed import Chosen, chosen

ROBOT = """<mujoco><worldbody><geom type="plane" size="1 1 .1"/><body name="pad" pos="0 0 .3">
<joint name="up" type="slide" axis="0 0 1" damping="50" stiffness="3000"/><geom type="box" size=".06 .06 .01" mass="1"/>
</body></worldbody></mujoco>"""
PLACE = ["--parent", "pad", "--pos", "-.04,-.02,-.05"]  # its upper face touches the pad's lower one


@pytest.fixture
def robot(tmp_path: Path) -> Path:
    labels = np.ones((8, 4, 4), int)
    labels[:, :, 3] = 2
    materials = {1: mf.Material(1e5, 0.3, 1000), 2: mf.Material(2e5, 0.3, 1000)}
    mf.Volume.from_labels(labels, 0.01, materials).save(tmp_path / "block.npz")
    (tmp_path / "robot.xml").write_text(ROBOT)
    return tmp_path


def built(folder: Path, *options: str) -> int:
    files = [str(folder / "block.npz"), "--into", str(folder / "robot.xml"), "-o", str(folder / "out.xml")]
    return main(["build", *files, *PLACE, "--frames", "3", *options])


@pytest.mark.parametrize(
    "fixed", [["z"], ["z:1cm"], ["near:1mm"], ["label:2"], ["box:-1,-1,.03,1,1,1"], ["x", "-x"]], ids=str
)
def test_what_is_fixed_stays_on_the_robot(robot: Path, fixed: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert built(robot, *[word for one in fixed for word in ("--fixed", one)]) == 0
    assert capsys.readouterr().err == ""
    model = mujoco.MjModel.from_xml_path(str(robot / "out.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=1000)
    view = mf.soft(model, data, "soft")
    assert model.body_parentid[view.holder] == model.body("pad").id
    still = np.linalg.norm((view.control_positions - data.xpos[view.holder]) - view.rest, axis=1)
    assert still.max() < 0.005
    assert still.min() < 1e-6  # the fixed frame's points


def test_without_it_a_sentence_says_that_it_floats_free(robot: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert built(robot) == 0
    assert capsys.readouterr().err == (
        "mjframes: soft: nothing of it is fixed to 'pad', which moves: it starts there and floats free; glue it with "
        "supports=mf.Fixed(mask) in mf.build, or --fixed on the command line.\n"
    )


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--fixed", "q"], "argument --fixed: 'q' is not a side like -z or -z:4mm, box:"),
        (["--fixed", "y:"], "argument --fixed: 'y:' is not a side like -z or -z:4mm, box:"),
        (["--fixed", "near:far"], "argument --fixed: 'near:far' is not a side"),
        (["--fixed", "label:3"], "--fixed: label is 3, which no voxel has; the labels are 1, 2."),
        (["--fixed", "box:0,0,0,1,1"], "argument --fixed: 'box:0,0,0,1,1' is not a side"),
        (["--fixed", "box:1,1,1,2,2,2"], "--fixed: the box from [1.0, 1.0, 1.0] to [2.0, 2.0, 2.0] holds no voxel"),
        (["--fixed", "-z:1mm"], "--fixed: depth is 0.001; it must be a length in metres, half a voxel or more"),
        (["--fixed", "near:1mm", "--pos", "0,0,-1"], "--fixed: no voxel is within 0.001 m of the geoms of 'pad'"),
    ],
)
def test_what_holds_nothing_is_refused(
    robot: Path, options: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert built(robot, *options) == 2
    assert words in capsys.readouterr().err


def test_near_needs_a_scene(robot: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["build", str(robot / "block.npz"), "-o", str(robot / "a.xml"), "--fixed", "near:1mm"]) == 2
    assert "--fixed near:… measures from the geoms of a scene's body; give --into and --parent." in (
        capsys.readouterr().err
    )


def test_it_says_nothing_to_a_body_that_is_built(robot: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = [str(robot / "block.npz"), "-o", str(robot / "body.npz")]
    assert main(["build", *files, "--fixed", "z"]) == 0
    assert mf.SoftBody.load(robot / "body.npz").held == 1
    assert main(["build", str(robot / "body.npz"), "-o", str(robot / "a.xml"), "--fixed", "z"]) == 2
    assert "built already, to which --fixed does nothing" in capsys.readouterr().err


def test_values_that_begin_as_options_do_are_values() -> None:
    words = ["build", "a", "--fixed", "-z:4mm", "--up", "-y", "--pos", "-1,0,0", "-o", "b", "--fragment"]
    assert joined(words) == ["build", "a", "--fixed=-z:4mm", "--up=-y", "--pos=-1,0,0", "-o", "b", "--fragment"]


def test_what_is_chosen() -> None:
    assert chosen("-z:4mm") == Chosen("side", "-z", (0.004,))
    assert chosen("near:0") == Chosen("near", numbers=(0.0,))


@pytest.mark.parametrize(("text", "metres"), [("2mm", 0.002), ("0.5 cm", 0.005), ("3e-3", 0.003), ("1in", 0.0254)])
def test_lengths(text: str, metres: float) -> None:
    assert length(text) == pytest.approx(metres)


@pytest.mark.parametrize("text", ["", "mm", "-1mm", "nan", "2 miles"])
def test_what_is_no_length(text: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError, match="is not a length like 2mm"):
        length(text)
