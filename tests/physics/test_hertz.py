"""A pressed ball comes near to Hertz's force with the number of frames."""

from __future__ import annotations

from pathlib import Path

import pytest
from builders.pictures import picture, share

from examples import hertz

pytest.importorskip("matplotlib")


def test_dents_bring_a_coarse_ball_nearer_to_hertz(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hertz, "ACROSS", 12)
    monkeypatch.setattr(hertz, "FRAMES", (2, 3, 5))
    found = hertz.run(tmp_path)
    shown = picture(tmp_path / "hertz.png")
    assert min(share(shown, color) for color in hertz.COLORS) > 3e-4
    without, with_dents = found.ratio
    assert (without > 1.4).all()
    assert (abs(with_dents - 1) < 0.8 * abs(without - 1)).all()


@pytest.mark.slow
def test_the_force_of_a_pressed_ball_comes_near_to_that_of_hertz(tmp_path: Path) -> None:
    found = hertz.run(tmp_path)
    shown = picture(tmp_path / "hertz.png")
    assert min(share(shown, color) for color in hertz.COLORS) > 3e-4
    without, with_dents = found.ratio
    assert without[0, -1] > 1.5  # 5 frames are too few for the dent
    assert without[1:, -1] == pytest.approx(1.2, abs=0.1)  # what is left of it from ten on
    assert (without > 1).all()
    # 1.5 if all of the pressed circle were frames or dents; of 5 frames few vertices are in it, and which decides
    assert found.exponent[1, 1:] == pytest.approx(1.3, abs=0.12)
    assert with_dents == pytest.approx(1, abs=0.22)
    assert (with_dents < without).all()
