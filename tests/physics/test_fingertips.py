"""Soft fingertips hold a soft peach: it comes along, hardly slips, and falls where there is no friction."""

from __future__ import annotations

import mujoco
import pytest

import mjframes as mf
from examples import fingertips


@pytest.fixture(scope="module")
def scene() -> tuple[mujoco.MjModel, mf.SoftBody]:
    return fingertips.hand_and_peach()


def test_the_peach_comes_along(scene: tuple[mujoco.MjModel, mf.SoftBody]) -> None:
    found = fingertips.grip(*scene)
    assert found.rise == pytest.approx(fingertips.HEIGHT, abs=3e-3)  # [m]: the lift sags under the hand's weight
    assert found.slip < 2e-3  # [m]
    assert 0.8e-3 < found.squeeze < 4e-3  # [m]
    assert not any(warning.number for warning in found.data.warning)


@pytest.mark.slow
def test_without_friction_it_stays(scene: tuple[mujoco.MjModel, mf.SoftBody]) -> None:
    model = scene[0].__copy__()
    model.geom_friction[:, 0] = 0.02
    assert fingertips.grip(model, scene[1]).rise < 0.01
