"""Geoms whose size changes at run time touch as if they had been compiled so."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from builders.scenes import compiled
from builders.slabs import slab

SIZES = {
    "sphere": ((0.03,), (0.01,)),
    "capsule": ((0.01, 0.03), (0.02, 0.01)),
    "ellipsoid": ((0.02, 0.03, 0.04), (0.03, 0.01, 0.015)),
    "cylinder": ((0.02, 0.02), (0.035, 0.01)),
    "box": ((0.01, 0.02, 0.03), (0.03, 0.015, 0.012)),
}


def at(kind: str, size: tuple[float, ...], z: float) -> tuple[mujoco.MjModel, mujoco.MjData]:
    numbers = " ".join(map(str, size))
    scene = f"""<mujoco><option gravity="0 0 0"/><worldbody><body pos=".1 .1 {z}" euler="20 10 0"><freejoint/>
      <geom name="it" type="{kind}" size="{numbers}" mass="1"/></body></worldbody></mujoco>"""
    return compiled(scene, (slab(), (0, 0, 0), (1, 0, 0, 0)))


@pytest.mark.parametrize("kind", SIZES)
@pytest.mark.parametrize("grows", [False, True])
def test_a_resized_geom_touches_as_one_of_that_size(kind: str, grows: bool) -> None:
    before, after = SIZES[kind][::-1] if grows else SIZES[kind]
    touched = 0
    for z in np.linspace(0.05, 0.1, 11):
        model, data = at(kind, before, z)
        mujoco.mj_forward(model, data)
        model.geom("it").size[: len(after)] = after
        mujoco.mj_forward(model, data)
        wanted = at(kind, after, z)
        mujoco.mj_forward(*wanted)
        assert data.ncon == wanted[1].ncon
        touched += data.ncon
        for name in ("pos", "dist", "frame"):
            np.testing.assert_array_equal(getattr(data.contact, name), getattr(wanted[1].contact, name))
    assert touched > 2


def test_a_ball_made_small_lets_go() -> None:
    model, data = at("sphere", (0.03,), 0.068)
    mujoco.mj_forward(model, data)
    assert data.ncon > 0
    model.geom("it").size[0] = 0.01
    mujoco.mj_forward(model, data)
    assert data.ncon == 0
