"""Finite elements that an indenter presses, beside others and Hertz; and the command's table."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from builders.punch import punch_stiffness

from benchmarks.accuracy import touch
from benchmarks.solids import pressed
from benchmarks.solids.pressed import Pressed, exact_forces, highest, pressed_bodies
from mjframes.app.press import Indenter
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

EDGE, YOUNG, POISSON = 0.005, 1e5, 0.3


def glued(shape: tuple[int, int, int]) -> Pressed:
    volume = Volume.from_labels(np.ones(shape, np.uint8), EDGE, {1: Material(YOUNG, POISSON, 1000)})
    return Pressed("block", volume, volume.side("-z"))


def test_a_punch_meets_the_force_of_other_finite_elements() -> None:
    some = glued((8, 8, 5))
    one = some.indenters()[0]
    assert one == Indenter("punch", 4 * EDGE)
    assert some.depth == pytest.approx(0.05 * 4 * EDGE)
    stiffness = punch_stiffness(8 * EDGE, 4 * EDGE, 2 * EDGE, YOUNG, POISSON, EDGE)
    assert exact_forces(some)[0] == pytest.approx(stiffness * some.depth, rel=1e-3)


@pytest.mark.slow
def test_a_ball_meets_hertzs_force(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a block much larger than where it touches; what is below makes it firmer."""
    monkeypatch.setattr(pressed, "DEPTH", 0.02)
    monkeypatch.setattr(pressed, "BALL", 30)
    some = glued((16, 16, 14))
    hertz = 4 / 3 * YOUNG / (1 - POISSON**2) * np.sqrt(30 * EDGE) * some.depth**1.5
    assert hertz < exact_forces(some)[2] < 1.4 * hertz


def test_bodies_are_held_and_pressed_where_they_are() -> None:
    found = list(pressed_bodies())
    assert len({some.name for some in found}) == len(found) >= 8
    for some in found:
        assert some.held.any()
        assert not some.held.all()
        assert some.depth > 0


def test_the_highest_nodes_are_those_of_the_top() -> None:
    labels = np.ones((3, 1, 3), np.uint8)
    labels[2, :, 1:] = 0
    volume = Volume.from_labels(labels, EDGE, {1: Material(YOUNG, POISSON, 1000)})
    some = Pressed("step", volume, volume.side("-x"))
    mesh = pressed.bricks(some.grid, some.held, 2, 1)
    heights = mesh.nodes[highest(mesh)]
    assert len(heights) == 7 * 3
    np.testing.assert_allclose(heights[heights[:, 0] > 2.01 * EDGE][:, 2], EDGE)
    np.testing.assert_allclose(heights[heights[:, 0] < 1.99 * EDGE][:, 2], 3 * EDGE)


@pytest.mark.slow
def test_the_command_writes_what_it_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(touch, "pressed_bodies", lambda: [glued((8, 8, 5))])
    assert touch.main(["--frames", "3", "--table", str(tmp_path / "touch.csv")]) == 0
    with (tmp_path / "touch.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["indenter"] for row in rows] == ["punch 20 mm", "punch 40 mm", "ball 100 mm"]
    for row in rows[:2]:
        assert float(row["force"]) == pytest.approx(float(row["exact"]), rel=0.3)
    assert "of 3 within 0.85 to 1.15" in capsys.readouterr().out
