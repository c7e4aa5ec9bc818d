"""Skins show the dents of contacts."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from mjframes.app.dented import draw_dents, skin_vertices
from mjframes.body.build import build
from mjframes.frames.supports import Fixed
from mjframes.scene.attach import attach
from mjframes.scene.contact import Contact
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

SCENE = """<mujoco><worldbody><body pos="0.0025 0.0025 .0205"><joint type="slide" axis="0 0 1" damping="1"/>
  <geom type="box" size=".01 .01 .01" mass=".9" condim="1"/></body></worldbody></mujoco>"""


def pressed(dents: bool) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """A box on the middle of a pad that is held at its bottom."""
    volume = Volume.box((0.1, 0.1, 0.02), Material(5e4, 0.45, 1000), spacing=0.005)
    held = np.zeros(volume.labels.shape, bool)
    held[:, :, 0] = True
    spec = mujoco.MjSpec.from_string(SCENE)
    attach(spec, build(volume, 1, supports=Fixed(held), damping=(0, 0.02)), "pad", contact=Contact(dents=dents))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 2000)
    mujoco.mj_forward(model, data)
    return model, data


def plain(model: mujoco.MjModel, data: mujoco.MjData) -> mujoco.MjvScene:
    scene = mujoco.MjvScene(model, 10)
    mujoco.mjv_updateScene(model, data, mujoco.MjvOption(), None, mujoco.MjvCamera(), 0, scene)
    return scene


def test_the_skin_below_a_box_is_where_the_box_is() -> None:
    model, data = pressed(dents=True)
    scene = plain(model, data)
    before = scene.skinvert.reshape(-1, 3).copy()
    draw_dents(model, data, scene)
    after = scene.skinvert.reshape(-1, 3)
    bottom = data.geom_xpos[0, 2] - 0.01
    below = (np.abs(before[:, :2] - data.geom_xpos[0, :2]) < 0.008).all(axis=1) & (before[:, 2] > 0)
    far = np.linalg.norm(before - data.geom_xpos[0], axis=1) > 0.04
    sunk = before[below, 2].mean() - bottom
    assert sunk > 5e-4
    assert np.abs(after[below, 2] - bottom).mean() < 0.1 * sunk
    assert np.abs(after - before)[far].max() < 0.1 * sunk
    normals = scene.skinnormal.reshape(-1, 3)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-5)
    assert np.ptp(normals[below, 0]) > 0.05  # they follow the dent


def test_skins_of_logs_and_of_the_viewer_are_dented_too() -> None:
    model, data = pressed(dents=True)
    scene = plain(model, data)
    draw_dents(model, data, scene)
    shown = np.concatenate(skin_vertices(model, data, mujoco.MjvScene(model, 0)))
    np.testing.assert_array_equal(shown, scene.skinvert.reshape(-1, 3))


@pytest.mark.parametrize("forces", [False, True])
def test_without_dents_or_forces_skins_are_mujocos(forces: bool) -> None:
    model, data = pressed(dents=not forces)
    if not forces:
        mujoco.mj_resetData(model, data)
        mujoco.mj_kinematics(model, data)
    scene = plain(model, data)
    before = scene.skinvert.copy(), scene.skinnormal.copy()
    draw_dents(model, data, scene)
    np.testing.assert_array_equal(scene.skinvert, before[0])
    np.testing.assert_array_equal(scene.skinnormal, before[1])
