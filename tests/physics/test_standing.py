"""Flat sides stand: columns, stacks, cubes on a slope."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from builders.scenes import compiled

from mjframes.body.build import build
from mjframes.body.soft_body import SoftBody
from mjframes.scene.view import soft
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

FLOOR = '<mujoco><option {option}/><worldbody><geom type="plane" size="2 2 .1" friction="1.5"/></worldbody></mujoco>'
UPRIGHT = (1.0, 0.0, 0.0, 0.0)


def block(shape: tuple[int, int, int], spacing: float, young: float, frames: int) -> SoftBody:
    return build(Volume.from_labels(np.ones(shape, int), spacing, {1: Material(young, 0.3, 1000)}), frames)


def middles(model: mujoco.MjModel, data: mujoco.MjData, count: int) -> np.ndarray:
    """The mean of each body's control points (count, 3)."""
    return np.array([soft(model, data, f"soft{i}").control_positions.mean(axis=0) for i in range(count)])


def run(model: mujoco.MjModel, data: mujoco.MjData, seconds: float) -> None:
    for _ in range(round(seconds / model.opt.timestep)):
        mujoco.mj_step(model, data)


def test_a_column_stands_and_rests() -> None:
    """4 × 4 × 12 cm; on a base that bulges it fell over."""
    model, data = compiled(FLOOR.format(option=""), (block((4, 4, 12), 0.01, 1e6, 3), (0, 0, 5e-4), UPRIGHT))
    mujoco.mj_forward(model, data)
    start = middles(model, data, 1)
    run(model, data, 10)
    moved = np.abs(middles(model, data, 1) - start)[0]
    assert (moved < [5e-4, 5e-4, 1.5e-3]).all()  # it falls by half a millimetre
    assert np.abs(data.qvel).max() < 1e-6


@pytest.mark.parametrize("young", [1e5, 1e7])
def test_three_aligned_blocks_stand(young: float) -> None:
    body = block((8, 6, 4), 0.01, young, 3)
    model, data = compiled(FLOOR.format(option=""), *((body, (0, 0, 0.0402 * i + 2e-4), UPRIGHT) for i in range(3)))
    mujoco.mj_forward(model, data)
    start = middles(model, data, 3)
    run(model, data, 5)
    assert np.abs(middles(model, data, 3) - start)[:, :2].max() < 5e-3


@pytest.mark.parametrize(("degrees", "stands"), [(30, True), (47, False)])
@pytest.mark.parametrize("voxels", [4, 12])
def test_a_cube_stands_on_a_slope_and_tips_on_a_steep_one(voxels: int, degrees: float, stands: bool) -> None:
    """A rigid one tips at 45°. These do at 34° to 38°: their four contacts are a little inside of the corners."""
    slope = np.radians(degrees)
    option = f'cone="elliptic" impratio="10" gravity="{-9.81 * np.sin(slope)} 0 {-9.81 * np.cos(slope)}"'
    cube = block((voxels,) * 3, 0.06 / voxels, 1e6, 1)
    model, data = compiled(FLOOR.format(option=option), (cube, (0, 0, 2e-4), UPRIGHT))
    view, highest = soft(model, data, "soft0", body=cube), 0.0
    for _ in range(15):
        run(model, data, 0.1)
        highest = max(highest, float(view.positions([[0.0599, 0.03, 1e-4]])[0, 2]))
    assert (highest < 5e-3) == stands
