"""A free soft body is put somewhere as it is at rest, whatever its frames are."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from builders.lengthwise import block
from builders.scenes import FLOOR

import mjframes as mf
from mjframes.base.errors import MjframesError

POS, QUAT = (0.1, -0.2, 0.7), (0.5, 0.1, -0.7, 0.5)


@pytest.mark.parametrize("types", ["affine", "quadratic", ("rigid", "affine", "rigid")])
def test_a_body_is_where_it_was_put(types: str | tuple[str, ...]) -> None:
    spec = mujoco.MjSpec.from_string(FLOOR)
    mf.attach(spec, block(frame_type=types), "meat", pos=(0.3, 0, 0.1), quat=(0.8, 0.6, 0, 0))
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qvel[:] = 1
    mf.place(model, data, "meat", POS, QUAT)
    mujoco.mj_forward(model, data)
    view, turn = mf.soft(model, data, "meat"), np.zeros(9)
    mujoco.mju_quat2Mat(turn, np.array(QUAT) / np.linalg.norm(QUAT))
    expected = view.rest @ turn.reshape(3, 3).T + POS
    np.testing.assert_allclose(view.control_positions, expected, atol=1e-6)  # MuJoCo has places in six digits
    assert not data.qvel.any()
    assert view.elastic_energy == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize("types", ["affine", "quadratic", ("rigid", "affine", "rigid"), "rigid"])
def test_a_body_that_is_thrown_flies_and_spins(types: str | tuple[str, ...]) -> None:
    spec = mujoco.MjSpec.from_string(FLOOR)
    mf.attach(spec, block(frame_type=types), "meat", pos=(0.3, 0, 0.1), quat=(0.8, 0.6, 0, 0))
    model = spec.compile()
    data = mujoco.MjData(model)
    velocity, spin = np.array([1.0, -2, 0.5]), np.array([3.0, 1, -2])
    mf.place(model, data, "meat", POS, QUAT, velocity, spin)
    mujoco.mj_forward(model, data)
    view = mf.soft(model, data, "meat")
    x, mass = view.control_positions, view.mass
    wanted = velocity + np.cross(spin, x - mass @ x / mass.sum())
    np.testing.assert_allclose(view.linear_momentum, mass.sum() * velocity, rtol=1e-6)
    jacobian = np.zeros((3, model.nv))
    for body, place, expected in zip(view.bodies, x, wanted, strict=True):
        mujoco.mj_jac(model, data, jacobian, None, place, int(body))
        np.testing.assert_allclose(jacobian @ data.qvel, expected, atol=1e-5)


def test_where_it_was_attached_all_coordinates_are_zero() -> None:
    spec = mujoco.MjSpec.from_string(FLOOR)
    mf.attach(spec, block(), "meat", pos=POS, quat=QUAT)
    model = spec.compile()
    data = mujoco.MjData(model)
    mf.place(model, data, "meat", POS, QUAT)
    np.testing.assert_allclose(data.qpos, 0, atol=1e-6)


def test_what_cannot_be_placed_is_said() -> None:
    spec = mujoco.MjSpec.from_string(FLOOR)
    mask = np.zeros((12, 4, 4), bool)
    mask[:2] = True
    mf.attach(spec, block(), "meat")
    mf.attach(spec, block(supports=(mf.Fixed(mask),)), "shelf", pos=(0, 1, 0))
    model = spec.compile()
    data = mujoco.MjData(model)
    for name, pos, spin, words in (
        ("shelf", POS, (0, 0, 0), "is held by the scene"),
        ("other", POS, (0, 0, 0), "the model's soft bodies are: 'meat', 'shelf'"),
        ("meat", (0, 0), (0, 0, 0), "give three metres"),
        ("meat", POS, (0, 0, np.nan), "^spin is .* give three radians a second"),
    ):
        with pytest.raises(MjframesError, match=words):
            mf.place(model, data, name, pos, spin=spin)
