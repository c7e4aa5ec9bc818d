"""Other users of MuJoCo run a scene to the same bits as a loop of mj_step: rollouts, dm_control, a bare process."""

from __future__ import annotations

import copy
import hashlib
import subprocess
import sys
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest
from mujoco import rollout
from scenes import FLOOR, beam, lump

from mjframes import plugin
from mjframes.mjcf import attach

FULL = mujoco.mjtState.mjSTATE_FULLPHYSICS
STEPS = 300


@cache
def scene() -> str:
    """Two soft bodies that fall on a floor, and a keyframe in mid-air."""
    spec = mujoco.MjSpec.from_string(FLOOR)
    attach(spec.worldbody, beam(beta=0.001), "soft0", (0, 0, 0.05), (0.8, 0, -0.6, 0))
    attach(spec.worldbody, lump(), "soft1", (0.3, 0, -0.2))
    model = spec.compile()
    spec.add_key(name="bent", qpos=0.01 * np.random.default_rng(0).normal(size=model.nq), time=3.0)
    spec.compile()
    return spec.to_xml()


def started() -> tuple[mujoco.MjModel, mujoco.MjData]:
    model = mujoco.MjModel.from_xml_string(scene())
    return model, mujoco.MjData(model)


def state(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    values = np.zeros(mujoco.mj_stateSize(model, FULL))
    mujoco.mj_getState(model, data, values, FULL)
    return values


def stepped(model: mujoco.MjModel, data: mujoco.MjData, steps: int = STEPS) -> np.ndarray:
    for _ in range(steps):
        mujoco.mj_step(model, data)
    return state(model, data)


@cache
def reference() -> np.ndarray:
    """The state after STEPS steps of MuJoCo alone."""
    return stepped(*started())


def test_the_scene_has_contact() -> None:
    model, data = started()
    stepped(model, data)
    assert {int(model.geom_plugin[g]) for c in data.contact for g in c.geom} == {-1, 0, 1}


def test_two_runs_are_equal() -> None:
    np.testing.assert_array_equal(stepped(*started()), reference())


def test_rollouts_in_threads_are_equal_to_a_loop() -> None:
    model, data = started()
    starts = np.tile(state(model, data), (4, 1))
    starts[:, 1 + model.nq :] = 0.1 * np.arange(4)[:, None]  # velocities, after the time and positions
    expected = []
    for start in starts:
        data = mujoco.MjData(model)
        mujoco.mj_setState(model, data, start, FULL)
        expected.append(stepped(model, data, 100))
    found, _ = rollout.rollout(model, [mujoco.MjData(model) for _ in range(2)], starts, nstep=100)
    np.testing.assert_array_equal(found[:, -1], expected)


@pytest.mark.dm_control
def test_dm_control_steps_to_the_same_bits() -> None:
    from dm_control import mujoco as dm_mujoco

    physics = dm_mujoco.Physics.from_xml_string(scene())
    physics.step(1000)
    model, data = started()
    stepped(model, data, 1000)
    np.testing.assert_array_equal(physics.data.qpos, data.qpos)
    np.testing.assert_array_equal(physics.data.qvel, data.qvel)
    assert physics.named.data.xpos["soft0_3"].shape == (3,)


def test_a_process_with_nothing_but_mujoco_runs_the_scene(tmp_path: Path) -> None:
    path = tmp_path / "scene.xml"
    path.write_text(scene())
    code = f"""
import hashlib, sys
import mujoco
mujoco.mj_loadPluginLibrary({str(plugin.library_path())!r})
assert "mjframes" not in sys.modules or mujoco.mj_versionString() >= "4"  # which loads plugins by itself
model = mujoco.MjModel.from_xml_path({str(path)!r})
data = mujoco.MjData(model)
for _ in range({STEPS}):
    mujoco.mj_step(model, data)
print(hashlib.sha256(data.qpos.tobytes() + data.qvel.tobytes()).hexdigest())
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path, check=False)
    assert done.returncode == 0, done.stderr
    model, data = started()
    stepped(model, data)
    assert done.stdout.strip() == hashlib.sha256(data.qpos.tobytes() + data.qvel.tobytes()).hexdigest()


def test_a_reset_restores_the_bits() -> None:
    model, data = started()
    stepped(model, data)
    mujoco.mj_resetData(model, data)
    np.testing.assert_array_equal(stepped(model, data), reference())


def test_a_keyframe_restores_the_bits() -> None:
    model, data = started()
    runs = []
    for _ in range(2):
        mujoco.mj_resetDataKeyframe(model, data, 0)
        assert data.time == 3.0
        runs.append(stepped(model, data))
    np.testing.assert_array_equal(*runs)
    assert not np.array_equal(runs[0][1:], reference()[1:])


def test_a_copy_continues_with_the_same_bits() -> None:
    model, data = started()
    stepped(model, data, STEPS // 2)
    made, filled = copy.copy(data), mujoco.MjData(model)
    mujoco.mj_copyData(filled, model, data)
    for each in (made, filled, data):
        np.testing.assert_array_equal(stepped(model, each, STEPS - STEPS // 2), reference())


def test_a_saved_state_continues_with_the_same_bits() -> None:
    model, data = started()
    stepped(model, data, STEPS // 2)
    everything = mujoco.mjtState.mjSTATE_INTEGRATION
    saved = np.zeros(mujoco.mj_stateSize(model, everything))
    mujoco.mj_getState(model, data, saved, everything)
    other = mujoco.MjData(model)
    mujoco.mj_setState(model, other, saved, everything)
    np.testing.assert_array_equal(stepped(model, other, STEPS - STEPS // 2), reference())


def test_a_binary_model_steps_to_the_same_bits(tmp_path: Path) -> None:
    path = str(tmp_path / "scene.mjb")
    mujoco.mj_saveModel(started()[0], path)
    model = mujoco.MjModel.from_binary_path(path)
    np.testing.assert_array_equal(stepped(model, mujoco.MjData(model)), reference())


def test_many_datas_come_and_go() -> None:
    model, _ = started()
    for _ in range(20):
        datas = [mujoco.MjData(model) for _ in range(3)]
        for data in datas:
            mujoco.mj_step(model, data)
        del datas[1]
