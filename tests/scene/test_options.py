"""Options of MuJoCo's that take contacts away from soft bodies: said once, by each mjData."""

from __future__ import annotations

import mujoco
import numpy as np
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


@pytest.mark.parametrize("name", ["friction", "margin", "solref", "solimp"])
def test_numbers_of_contacts_that_are_none_are_refused(name: str, warnings: list[str]) -> None:
    model, _ = compiled(FLOOR, (beam(), (0, 0, 0.01), (1.0, 0, 0, 0)))
    values = getattr(model, f"geom_{name}")
    values[0] = np.nan
    with pytest.raises(mujoco.FatalError):
        mujoco.MjData(model)
    (said,) = warnings
    assert f"geom 0 'floor', which it may touch, has a {name} that is no finite number" in said
    values[0], model.geom_contype[0], model.geom_conaffinity[0] = np.nan, 0, 0
    mujoco.MjData(model)  # it touches nothing
