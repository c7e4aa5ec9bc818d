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
from builders.lengthwise import block
from builders.linked import body as bar
from builders.scenes import beam, compiled, lump
from mujoco import rollout

from mjframes.body.soft_body import SoftBody
from mjframes.frames.supports import Attached
from mjframes.scene import plugin
from mjframes.scene.attach import BranchWarning, attach
from mjframes.scene.sensors import add_sensor
from mjframes.scene.view import soft_names

FULL = mujoco.mjtState.mjSTATE_FULLPHYSICS
INTEGRATION = mujoco.mjtState.mjSTATE_INTEGRATION
STEPS = 300
ARM = """<mujoco><worldbody><geom name="floor" type="plane" size="1 1 .1"/>
<body name="upper" pos=".6 .02 .1"><joint name="shoulder" type="ball" damping="0.01"/><geom size=".01" mass=".3"/>
  <body name="lower" pos=".08 0 0"><joint name="elbow" axis="0 1 .2"/><geom size=".01" mass=".2"/></body></body>
</worldbody><actuator><motor joint="elbow" ctrlrange="-1 1"/></actuator></mujoco>"""


@cache
def held() -> SoftBody:
    """0.12 × 0.04 × 0.04 m, whose ends two links hold."""
    ends = np.zeros((2, 12, 4, 4), bool)
    ends[0, :2], ends[1, -2:] = True, True
    pieces = [Attached(link, mask) for link, mask in zip(("upper", "lower"), ends, strict=True)]
    return block(supports=tuple(pieces), damping=(0.5, 0.002))


@cache
def scene() -> str:
    """Soft bodies that fall on a floor, one of them of rigid frames, one on an arm, and a keyframe in mid-air."""
    spec = mujoco.MjSpec.from_string(ARM)
    attach(spec, beam(beta=0.001), "soft0", pos=(0, 0, 0.05), quat=(0.8, 0, -0.6, 0))
    attach(spec, lump(), "soft1", pos=(0.3, 0, -0.2))
    attach(spec, block(frame_type=("rigid", "affine", "rigid")), "soft2", pos=(0, 0.5, 0.05), quat=(0.8, 0, -0.6, 0))
    attach(spec, held(), "soft3", pos=(0.6, 0, 0.08))
    add_sensor(spec, lump(), "soft1", "elastic_energy")
    add_sensor(spec, held(), "soft3", "stress", [[0.06, 0.02, 0.02]])
    model = spec.compile()
    qpos = model.qpos0.copy()
    mujoco.mj_integratePos(model, qpos, 0.01 * np.random.default_rng(0).normal(size=model.nv), 1)
    spec.add_key(name="bent", qpos=qpos, time=3.0)
    spec.compile()
    return spec.to_xml()


@cache
def loaded() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(scene())


def started() -> tuple[mujoco.MjModel, mujoco.MjData]:
    model = copy.copy(loaded())
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
    owners = set(model.body_plugin.tolist())
    assert len(owners) == 5  # four soft bodies, and −1
    assert {int(model.body_plugin[model.geom_bodyid[g]]) for c in data.contact for g in c.geom} == owners


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


@pytest.mark.slow
@pytest.mark.dm_control
def test_dm_control_steps_to_the_same_bits() -> None:
    from dm_control import mujoco as dm_mujoco

    physics = dm_mujoco.Physics.from_xml_string(scene())
    physics.step(1000)
    model, data = started()
    stepped(model, data, 1000)
    np.testing.assert_array_equal(physics.data.qpos, data.qpos)
    np.testing.assert_array_equal(physics.data.qvel, data.qvel)
    assert physics.named.data.xpos["soft0:3"].shape == (3,)


@pytest.mark.slow
@pytest.mark.dm_control
def test_pymjcf_reads_soft_bodies_where_they_were_put(tmp_path: Path) -> None:
    from dm_control import mjcf

    path = tmp_path / "scene.xml"
    path.write_text(scene())
    read = mjcf.Physics.from_mjcf_model(mjcf.from_path(str(path))).model.ptr
    model = loaded()
    assert model.body("soft2").quat[0] == 0.8
    assert soft_names(read) == soft_names(model)
    for own in ("body_pos", "body_quat", "body_ipos", "body_parentid", "skin_bonebodyid", "skin_bonebindpos"):
        np.testing.assert_array_equal(getattr(read, own), getattr(model, own), own)
    data, again = mujoco.MjData(model), mujoco.MjData(read)
    np.testing.assert_array_equal(stepped(read, again), stepped(model, data))


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
        stepped(model, data, 10)
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


@pytest.mark.parametrize("what", [INTEGRATION, FULL | mujoco.mjtState.mjSTATE_WARMSTART], ids=["all", "physics"])
def test_a_saved_state_continues_with_the_same_bits(what: int) -> None:
    model, data = started()
    stepped(model, data, STEPS // 2)
    saved = np.zeros(mujoco.mj_stateSize(model, what))
    mujoco.mj_getState(model, data, saved, what)
    other = mujoco.MjData(model)
    stepped(model, other, 20)
    mujoco.mj_setState(model, other, saved, what)
    np.testing.assert_array_equal(stepped(model, other, STEPS - STEPS // 2), reference())


def test_sensors_are_restored_with_the_state() -> None:
    model, data = started()
    stepped(model, data, STEPS // 2)
    mujoco.mj_forward(model, data)
    other = copy.copy(data)
    stepped(model, other, 20)
    saved = np.zeros(mujoco.mj_stateSize(model, INTEGRATION))
    mujoco.mj_getState(model, data, saved, INTEGRATION)
    mujoco.mj_setState(model, other, saved, INTEGRATION)
    mujoco.mj_forward(model, other)
    assert np.all(data.sensordata != 0)
    np.testing.assert_array_equal(other.sensordata, data.sensordata)


def test_a_thread_pool_steps_to_the_same_bits() -> None:
    model, data = started()
    mujoco.mju_threadpool(data, 2)
    np.testing.assert_array_equal(stepped(model, data), reference())


def test_a_thread_pool_steps_soft_bodies_on_each_other_to_the_same_bits() -> None:
    xml = "<mujoco><worldbody><geom type='plane' size='1 1 .1'/></worldbody></mujoco>"
    stack = [(beam(beta=0.001), (0.01 * i, 0.02 * i, 0.001 + 0.05 * i), (1.0, 0, 0, 0.1 * i)) for i in range(3)]
    model, data = compiled(xml, *stack)
    ends, between = [], 0
    for threads in (0, 2):
        data = mujoco.MjData(model)
        if threads:
            mujoco.mju_threadpool(data, threads)
        for _ in range(STEPS):
            mujoco.mj_step(model, data)
            between += sum(bool((model.geom_plugin[c.geom] >= 0).all()) for c in data.contact)
        ends.append(state(model, data))
    np.testing.assert_array_equal(*ends)
    assert between > 1000


@pytest.mark.parametrize("threads", [1, 2])
def test_a_batch_is_equal_to_a_loop(threads: int) -> None:
    batch = pytest.importorskip("mujoco.batch")
    model, _ = started()
    speed = 0.1 * np.arange(3)[:, None] * np.ones(model.nv)
    expected, sensed = [], []
    for each in speed:
        data = mujoco.MjData(model)
        data.qvel[:] = each
        stepped(model, data, 100)
        expected.append([*data.qpos, *data.qvel])
        sensed.append(data.sensordata.copy())
    simulations = batch.Batch(model, nsim=3, nthread=threads)
    qpos, qvel, sensors = (simulations.bind(name) for name in ("qpos", "qvel", "sensordata"))
    qvel[:] = speed
    for _ in range(100):
        simulations.step()
    np.testing.assert_array_equal(np.hstack([qpos, qvel]), expected)
    np.testing.assert_array_equal(sensors, sensed)


@pytest.mark.parametrize("integrator", ["EULER", "IMPLICITFAST", "IMPLICIT"])
def test_derivatives_are_those_of_a_step(integrator: str) -> None:
    model, data = started()
    model.opt.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator}")
    data.qvel[:] = 0.1 * np.random.default_rng(0).normal(size=model.nv)
    stepped(model, data, 5)
    start = np.zeros(mujoco.mj_stateSize(model, INTEGRATION))
    mujoco.mj_getState(model, data, start, INTEGRATION)
    n, eps = 2 * model.nv, 1e-6
    A, B, C, D = (np.zeros(shape) for shape in ((n, n), (n, model.nu), (model.nsensordata, n),
                                                (model.nsensordata, model.nu)))  # fmt: skip
    mujoco.mjd_transitionFD(model, data, eps, True, A, B, C, D)
    assert all(np.isfinite(matrix).all() for matrix in (A, B, C, D))
    after = np.zeros_like(start)
    mujoco.mj_getState(model, data, after, INTEGRATION)
    np.testing.assert_array_equal(after, start)

    def ahead(direction: np.ndarray, control: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        other = mujoco.MjData(model)
        mujoco.mj_setState(model, other, start, INTEGRATION)
        mujoco.mj_integratePos(model, other.qpos, direction[: model.nv], 1)
        other.qvel += direction[model.nv :]
        other.ctrl += control
        mujoco.mj_step(model, other)
        return other.qpos.copy(), other.qvel.copy(), other.sensordata.copy()

    def slope(direction: np.ndarray, control: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        (q0, v0, s0), (q1, v1, s1) = (ahead(sign * eps * direction, sign * eps * control) for sign in (-1, 1))
        moved = np.zeros(model.nv)
        mujoco.mj_differentiatePos(model, moved, 2 * eps, q0, q1)
        return np.concatenate([moved, (v1 - v0) / (2 * eps)]), (s1 - s0) / (2 * eps)

    for column in np.random.default_rng(1).choice(n, 20, replace=False):
        state_slope, sensor_slope = slope(np.eye(n)[column])
        np.testing.assert_allclose(A[:, column], state_slope, atol=1e-6 * np.abs(A[:, column]).max())
        np.testing.assert_allclose(C[:, column], sensor_slope, atol=1e-6 * max(1, np.abs(C[:, column]).max()))
    np.testing.assert_allclose(B[:, 0], slope(np.zeros(n), 1.0)[0], atol=1e-6 * np.abs(B).max())
    assert np.abs(B).max() > 0


def test_islands_change_nothing_but_rounding() -> None:
    ends = []
    for flags in (0, mujoco.mjtDisableBit.mjDSBL_ISLAND):
        model, data = started()
        model.opt.disableflags |= flags
        model.opt.tolerance = 0
        ends.append(stepped(model, data, 100))
    assert data.ncon > 0
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-9)


SLEEPY = """<mujoco><option><flag sleep="enable"/></option><worldbody>
<geom name="floor" type="plane" size="1 1 .1"/>
<body name="ball" pos=".06 .02 .6"><freejoint/><geom size=".02" mass=".05"/></body>
</worldbody></mujoco>"""


def test_a_soft_body_falls_asleep_and_is_woken() -> None:
    model, data = compiled(SLEEPY, (block(damping=(2.0, 0.005)), (0, 0, 0.001), (1, 0, 0, 0)))
    awake_model = copy.copy(model)
    awake_model.opt.enableflags = 0
    other = mujoco.MjData(awake_model)
    tree = model.body_treeid[model.geom_bodyid[-1]]
    coordinates, dofs, entries = slice(7, None), slice(6, None), slice(21, None)  # all but the ball's

    def own() -> list[np.ndarray]:
        return [data.qpos[coordinates].copy(), data.qfrc_passive[dofs].copy(), data.M[entries].copy()]

    def steps_while(asleep: bool) -> int:
        for step in range(300):
            if (data.tree_asleep[tree] >= 0) != asleep:
                return step
            if asleep:
                for found, expected in zip(own(), resting, strict=True):
                    np.testing.assert_array_equal(found, expected)
            mujoco.mj_step(model, data)
        return 300

    resting = own()
    steps = steps_while(asleep=False)
    until = stepped(awake_model, other, steps - 1)
    np.testing.assert_array_equal(stepped(model, mujoco.MjData(model), steps - 1), until)
    mujoco.mj_step(awake_model, other)
    assert 20 < steps < 150
    resting = own()
    np.testing.assert_allclose(resting[0], other.qpos[coordinates], atol=1e-5)  # but for the step that it sleeps in
    assert 20 < steps_while(asleep=True) < 150  # until the ball comes
    saved = np.zeros(mujoco.mj_stateSize(model, INTEGRATION))
    mujoco.mj_getState(model, data, saved, INTEGRATION)
    mujoco.mj_setState(awake_model, other, saved, INTEGRATION)
    for _ in range(20):  # woken, it goes on as one that never slept
        mujoco.mj_step(model, data)
        mujoco.mj_step(awake_model, other)
    np.testing.assert_allclose(data.qpos, other.qpos, atol=1e-9)
    assert np.abs(data.qvel[dofs]).max() > 0.01


@pytest.mark.parametrize("sleep", ["auto", "never"])
def test_sleep_is_refused_where_one_body_would_sleep_and_the_other_not(sleep: str, warnings: list[str]) -> None:
    links = f"""<mujoco><option gravity="0 0 0"><flag sleep="enable"/></option><worldbody>
        <body name="upper" pos="0 .03 .03" sleep="{sleep}"><joint axis="0 1 0"/><geom size=".01" mass=".3"/></body>
        <body name="lower" pos=".2 .03 .03" sleep="{sleep}"><joint axis="0 1 0"/><geom size=".01" mass=".3"/></body>
        </worldbody></mujoco>"""

    spec = mujoco.MjSpec.from_string(links)
    with pytest.warns(BranchWarning):
        attach(spec, bar("affine", ("upper", "lower")), "soft0", contact=False)
    if sleep == "never":
        mujoco.MjData(spec.compile())
        return
    with pytest.raises((ValueError, mujoco.FatalError), match="init failed"):
        mujoco.MjData(spec.compile())
    assert "give the root body of each tree" in warnings[-1]


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
