"""A pressed ball comes to Hertz's force with the number of frames."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from examples import hertz


def test_the_force_of_a_pressed_ball_comes_to_that_of_hertz_with_the_number_of_frames(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    found = hertz.run(tmp_path)
    assert (tmp_path / "hertz.png").stat().st_size > 20_000
    assert (np.diff(found.ratio[:, -1]) < 0).all()
    assert found.ratio[1, -1] == pytest.approx(1.77, abs=0.05)  # 20 frames
    assert found.limit == pytest.approx(1, abs=0.1)  # E* of frames that are close against the contact area
    assert (np.diff(found.exponent) > 0).all()
    assert found.exponent[-1] == pytest.approx(1.35, abs=0.05)  # 1.5 where the area grows without a step
