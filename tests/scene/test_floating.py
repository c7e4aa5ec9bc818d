"""Soft bodies of which nothing is held, put into bodies that move: they start there and float free."""

from __future__ import annotations

import warnings
from functools import cache

import mujoco
import numpy as np
import pytest
from builders.scenes import TILTED

import mjframes as mf
from mjframes.body.soft_body import SoftBody

SCENE = """<mujoco><option gravity="0 0 0"/><compiler angle="degree"/><worldbody><frame pos=".1 0 0" euler="10 0 0">
<body name="base" pos="0 .1 .5" euler="0 20 0"><freejoint/><geom type="box" size=".05 .05 .02" contype="0"
 conaffinity="0"/>
<body name="arm" pos="0 0 .1"><joint axis="0 1 0"/><geom size=".02" contype="0" conaffinity="0"/></body></body></frame>
<body name="mocap" mocap="true"/><body name="table"><geom size=".01"/></body></worldbody></mujoco>"""


@cache
def block() -> SoftBody:
    volume = mf.Volume.from_labels(np.ones((6, 6, 6), int), 0.01, {1: mf.Material(1e5, 0.3, 1000)})
    return mf.build(volume, 3)


def put(parent: str) -> tuple[mujoco.MjModel, mujoco.MjData]:
    spec = mujoco.MjSpec.from_string(SCENE)
    mf.attach(spec, block(), "soft", parent, pos=(0.02, 0, 0.03), quat=TILTED)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


@pytest.mark.parametrize("parent", ["base", "arm", "mocap"])
def test_it_starts_in_what_moves_and_floats_free_of_it(parent: str) -> None:
    model, data = put(parent)
    view = mf.soft(model, data, "soft")
    axes, turn = data.xmat[model.body(parent).id].reshape(3, 3), np.zeros(9)
    mujoco.mju_quat2Mat(turn, np.array(TILTED) / np.linalg.norm(TILTED))
    place = data.xpos[model.body(parent).id] + (view.rest @ turn.reshape(3, 3).T + (0.02, 0, 0.03)) @ axes.T
    np.testing.assert_allclose(view.control_positions, place, atol=1e-6)
    data.qvel[3:6] = 3, -20, 60  # of the base
    data.mocap_pos += 0.2
    for _ in range(500):
        mujoco.mj_step(model, data)
    np.testing.assert_allclose(view.control_positions, place, atol=1e-6)
    assert view.kinetic_energy < 1e-12
    assert view.elastic_energy < 1e-12


def test_in_what_stands_still_it_stays() -> None:
    model, data = put("table")
    assert model.body_parentid[mf.soft(model, data, "soft").holder] == model.body("table").id


def test_a_warning_says_that_it_floats() -> None:
    spec = mujoco.MjSpec.from_string(SCENE)
    with pytest.warns(mf.FloatWarning, match="soft: nothing of it is fixed to 'arm', which moves: it starts there and"):
        mf.attach(spec, block(), "soft", "arm")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mf.attach(spec, block(), "other", "table")
