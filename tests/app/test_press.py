"""Pressing: forces against closed forms, outputs, and what cannot be pressed."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from builders.pictures import picture, share

import mjframes as mf
from mjframes.app.press import Indenter, Pressed, press
from mjframes.base.errors import MjframesError
from mjframes.cli.commands import main
from mjframes.scene import scaling
from mjframes.scene.load import load_scene

YOUNG, POISSON, EDGE = 1e5, 0.3, 0.08
SCENE = """<mujoco><worldbody><light pos="0 0 2"/><body pos="{x} 0 .079" gravcomp="1">
<joint type="slide" axis="0 0 1" stiffness="10"/><geom name="button" size=".01"/></body></worldbody></mujoco>"""


@cache
def cube(frames: int) -> mf.SoftBody:
    material = mf.Material(YOUNG, POISSON, 1000, name="rubber")
    volume = mf.Volume.from_labels(np.ones((16, 16, 16), int), EDGE / 16, {1: material}, origin=(-EDGE / 2,) * 3)
    return mf.build(volume, frames, supports=mf.Fixed(volume.side("-z")), damping=(0.0, 0.01))


def scene(folder: Path, frames: int = 6, button: float = 1.0, twice: bool = False, dents: bool = True) -> Path:
    spec = mujoco.MjSpec.from_string(SCENE.format(x=button))
    mf.attach(spec, cube(frames), "block", pos=(0, 0, EDGE / 2), contact=mf.Contact(dents=dents))
    if twice:
        mf.attach(spec, cube(frames), "other", pos=(0.5, 0, 0))
    mf.choose_solver(spec)
    spec.compile()
    path = folder / "cube.xml"
    path.write_text(spec.to_xml())
    return path


def pressed(folder: Path, kind: str, size: float, depth: float, frames: int = 6, **options: Any) -> Pressed:
    return press(scene(folder, frames), Indenter(kind, size), depth, **options)


def test_a_punch_wider_than_the_body_finds_its_stiffness(tmp_path: Path) -> None:
    found = pressed(tmp_path, "punch", 0.1, 0.002)
    expected = YOUNG * EDGE**2 / EDGE * found.depth  # E A δ / L
    rows = found.depth > 0.001
    np.testing.assert_allclose(found.force[rows], expected[rows], rtol=0.12)  # its floor is glued: a little stiffer
    assert found.held == pytest.approx(found.force[-1], rel=0.03)
    assert found.hertz is None
    assert found.notes == ()
    assert found.touched == pytest.approx([0, 0, EDGE], abs=5e-4)  # it sags by 0.3 mm


def test_from_the_side_it_bends(tmp_path: Path) -> None:
    """The cube is glued below: pushed near its upper edge it gives way, and the far side with it."""
    found = pressed(tmp_path, "punch", 0.02, 0.002, direction=(1, 0, 0), at=(0, 0, 0.07))
    from_above = pressed(tmp_path, "punch", 0.02, 0.002)
    assert found.force[-1] < 0.7 * from_above.force[-1]
    assert any("the far side moved by" in note for note in found.notes)


def test_what_a_ball_only_bends_is_told(tmp_path: Path) -> None:
    """A flap over an edge, as an animal's ear is in the middle above its body: 0.001 of Hertz's force."""
    volume = mf.Volume.box((0.12, 0.03, 0.006), mf.Material(YOUNG, POISSON, 100), spacing=0.003)
    spec = mujoco.MjSpec()
    spec.option.gravity = [0, 0, 0]
    body = mf.build(volume, 4, supports=mf.Fixed(volume.side("-x")), damping=(0.0, 0.01))
    mf.attach(spec, body, "flap")
    spec.compile()
    path = tmp_path / "flap.xml"
    path.write_text(spec.to_xml())
    found = press(path, Indenter("ball", 0.01), 0.002, at=(0.05, 0, 0))
    assert any(note.startswith("the contact is far softer than Hertz says") for note in found.notes)


@pytest.mark.slow
def test_a_ball_is_pressed_beside_hertz(tmp_path: Path) -> None:
    found = pressed(tmp_path, "ball", 0.02, 0.002, frames=30)
    assert found.hertz is not None
    np.testing.assert_allclose(found.hertz, 4 / 3 * YOUNG / (1 - POISSON**2) * 0.02**0.5 * found.depth**1.5, rtol=1e-2)
    assert found.depth[-1] == pytest.approx(0.002, rel=0.02)
    coarse = pressed(tmp_path, "ball", 0.02, 0.002, frames=6)
    firm = press(scene(tmp_path, dents=False), Indenter("ball", 0.02), 0.002)
    times = [some.force[-1] / found.hertz[-1] for some in (coarse, found, firm)]
    assert 1 < times[0] < times[1] < 2.5  # dents of many frames are too narrow
    assert times[2] > 3.2
    assert found.notes[0].startswith("Hertz's force does not hold at 2 mm: the contact's radius of 6.3")
    assert found.notes[1].startswith("the contact is stiffer than Hertz says")


@pytest.mark.slow
def test_the_surface_of_a_soft_ball_counts_with_its_curvature(tmp_path: Path) -> None:
    center = (np.arange(20) + 0.5) * 0.004 - 0.04
    inside = (np.stack(np.meshgrid(center, center, center, indexing="ij")) ** 2).sum(axis=0) < 0.04**2
    material = mf.Material(YOUNG, POISSON, 1000)
    volume = mf.Volume.from_labels(inside.astype(int), 0.004, {1: material}, origin=(-0.04,) * 3)
    spec = mujoco.MjSpec()
    mf.attach(spec, mf.build(volume, 4, supports=mf.Fixed(volume.side("-z", 0.016)), damping=(0.0, 0.01)), "ball")
    spec.compile()
    (tmp_path / "ball.xml").write_text(spec.to_xml())
    found = press(tmp_path / "ball.xml", Indenter("ball", 0.02), 0.001)
    radius = 1 / (1 / 0.02 + 1 / 0.04)
    expected = 4 / 3 * YOUNG / (1 - POISSON**2) * radius**0.5 * found.depth**1.5
    assert found.hertz is not None
    np.testing.assert_allclose(found.hertz, expected, rtol=0.1)


def test_a_cylinder_finds_more_than_a_ball_of_its_radius(tmp_path: Path) -> None:
    forces = [pressed(tmp_path, kind, 0.02, 0.001).force[-1] for kind in ("ball", "cylinder")]
    rigid = 2 * 0.02 * YOUNG / (1 - POISSON**2) * 0.001  # of a flat cylinder on a half-space
    assert forces[0] < forces[1]
    assert 0.9 * rigid < forces[1] < 2 * rigid


def test_the_command_writes_plot_and_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("matplotlib")
    path = scene(tmp_path)
    assert (
        main(["press", str(path), "--with", "ball:2cm", "--depth", "1mm", "--direction", "-z", "--speed", "2e-3"]) == 0
    )
    out = capsys.readouterr().out
    assert out.startswith(f"{tmp_path / 'cube-press.png'}, {tmp_path / 'cube-press.csv'}: ")
    assert "× Hertz's 0.65" in out
    assert share(picture(tmp_path / "cube-press.png"), "C0") > 3e-4
    table = np.genfromtxt(tmp_path / "cube-press.csv", delimiter=",", names=True)
    assert table.dtype.names == ("depth_m", "force_N", "hertz_N")
    assert len(table) > 90
    assert table["depth_m"][-1] == pytest.approx(0.001, rel=0.02)


def test_stiff_contacts_are_told_with_what_is_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mjframes.app.press.STIFF", 0.5)  # what is as firm as Hertz says counts, too
    for dents, words in ((True, "dents below so small a ball are too firm"), (False, "its dents are off")):
        found = press(scene(tmp_path, dents=dents), Indenter("ball", 0.01), 0.001)
        (note,) = [one for one in found.notes if "stiffer" in one]
        assert note.startswith(f"the contact is stiffer than Hertz says: {words}")


@pytest.mark.slow
def test_an_indenter_that_goes_through_the_body_is_told_of(tmp_path: Path) -> None:
    found = pressed(tmp_path, "ball", 0.01, 0.2)
    assert found.held == found.force[-1] == 0
    (note,) = [one for one in found.notes if "nothing" in one]
    assert re.fullmatch(r"the force fell to nothing at \S+ mm: the indenter went through the body or past it\.", note)
    assert not any("nothing" in one for one in pressed(tmp_path, "ball", 0.01, 0.001).notes)


def test_what_else_is_touched_is_told(tmp_path: Path) -> None:
    found = press(scene(tmp_path, button=0.052), Indenter("punch", 0.1), 0.002)
    assert any("also touched button" in note for note in found.notes)


def test_a_written_scene_tells_the_moduli(tmp_path: Path) -> None:
    model = load_scene(scene(tmp_path))[0]
    assert scaling.moduli(model, "block") == {1: (YOUNG, POISSON)}


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"body": "cat"}, "body is 'cat', but the soft bodies of the scene are: 'block', 'other'; name one of them."),
        ({}, "body is None, but the soft bodies of the scene are: 'block', 'other'"),
        ({"body": "block", "at": (1, 1, 1)}, "misses 'block'; give at"),
        ({"body": "block", "direction": (0, 0, 0)}, "direction is .* give three numbers that are not all 0"),
        ({"body": "block", "speed": -1}, "speed is -1; it must be a positive speed"),
    ],
)
def test_what_cannot_be_pressed_is_refused(tmp_path: Path, options: dict[str, Any], words: str) -> None:
    with pytest.raises(MjframesError, match=words):
        press(scene(tmp_path, twice=True), Indenter("ball", 0.01), 0.001, **options)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--with", "ball", "--depth", "1mm"], "'ball' is not ball:RADIUS, cylinder:RADIUS or punch:WIDTH"),
        (["--with", "cone:1mm", "--depth", "1mm"], "'cone:1mm' is not ball:RADIUS"),
        (["--with", "ball:1mm", "--depth", "0"], "depth is 0.0; it must be a positive length"),
        (["--with", "ball:1mm", "--depth", "1mm", "--direction", "up"], "'up' is not an axis like -z"),
        (["--with", "ball:1mm", "--depth", "1mm", "--plot", "a.txt"], "a.txt: a plot is written as .png, .pdf or .svg"),
    ],
)
def test_mistakes_end_in_a_sentence(arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["press", "none.xml", *arguments]) == 2
    assert words in capsys.readouterr().err
