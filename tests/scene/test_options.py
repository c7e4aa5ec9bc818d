"""Options of MuJoCo's that take contacts away from soft bodies: said once, by each mjData."""

from __future__ import annotations

import mujoco
import pytest
from builders.scenes import FLOOR, beam, compiled, lump

BODIES = ((beam(), (0, 0, 0.05), (1, 0, 0, 0)), (lump(), (0.5, 0, 0), (1, 0, 0, 0)))


@pytest.mark.parametrize("points", [0, 2, 11])
def test_too_few_points_of_distances_are_said_once(points: int, warnings: list[str]) -> None:
    model, data = compiled(FLOOR, *BODIES)
    mujoco.mj_step(model, data)
    assert not warnings
    model.opt.sdf_initpoints = points
    for _ in range(3):
        mujoco.mj_step(model, data)
    (said,) = warnings
    assert said.startswith(
        f"mjframes: option sdf_initpoints is {points}, and MuJoCo gives a patch of a soft body no more"
    )


def test_bodies_that_touch_nothing_need_no_points(warnings: list[str]) -> None:
    model, data = compiled(FLOOR, *BODIES, contact=False)
    model.opt.sdf_initpoints = 0
    mujoco.mj_step(model, data)
    assert not warnings
