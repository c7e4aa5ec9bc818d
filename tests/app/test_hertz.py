"""Hertz's force, and where it does not hold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mjframes.app.hertz import Ground, hertz_force, where_it_fails

FLAT = Ground(young=1e5, poisson=0.3, materials=1, curvature=0.0, slope=0.0, size=0.1)


def test_the_force_is_that_of_the_closed_form() -> None:
    force = hertz_force(np.array([-1.0, 0.0, 0.002]), 0.02, FLAT)
    assert force[:2].tolist() == [0, 0]
    assert force[2] == pytest.approx(4 / 3 * 1e5 / 0.91 * 0.02**0.5 * 0.002**1.5)


def test_two_equal_balls_are_one_of_half_the_radius_on_a_plane() -> None:
    ball = replace(FLAT, curvature=1 / 0.02)
    assert ball.radius(0.02) == pytest.approx(0.01)
    assert hertz_force(np.array([0.001]), 0.02, ball)[0] == pytest.approx(hertz_force(np.array([0.001]), 0.01, FLAT)[0])


@pytest.mark.parametrize(
    ("ground", "depth", "words"),
    [
        (FLAT, 1e-4, ""),
        (FLAT, 5e-3, "more than 0.3 of the ball's"),
        (replace(FLAT, size=0.01), 1e-4, "only 7.1 contact radii thick"),
        (replace(FLAT, materials=2), 1e-4, "2 materials that deform"),
        (replace(FLAT, slope=1.0), 1e-4, "inclined by 45°"),
    ],
)
def test_it_is_told_where_it_does_not_hold(ground: Ground, depth: float, words: str) -> None:
    found = where_it_fails(depth, 0.02, ground)
    assert (not found) if not words else any(words in clause for clause in found)
