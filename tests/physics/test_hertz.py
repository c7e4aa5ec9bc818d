"""A pressed ball comes near to Hertz's force with the number of frames."""

from __future__ import annotations

from pathlib import Path

import pytest

from examples import hertz


def test_the_force_of_a_pressed_ball_comes_near_to_that_of_hertz(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    found = hertz.run(tmp_path)
    assert (tmp_path / "hertz.png").stat().st_size > 20_000
    assert found.ratio[0, -1] > 1.5  # 5 frames are too few for the dent
    assert found.ratio[1:, -1] == pytest.approx(1.4, abs=0.1)  # what is left of it from ten on
    assert (found.ratio > 1).all()
    assert found.exponent[-1] == pytest.approx(1.38, abs=0.05)  # 1.5 where the area grows without a step
