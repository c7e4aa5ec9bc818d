"""Masses that a program changes in a model, as domain randomization does."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from mjframes.body.build import build
from mjframes.scene.attach import attach
from mjframes.scene.view import soft
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume


def falling(density: float, kind: str | tuple[str, ...]) -> mujoco.MjModel:
    labels = np.ones((8, 4, 4), int)
    labels[:3] = 2
    materials = {1: Material(3e4, 0.4, 1000 * density), 2: Material(1e5, 0.3, 1500 * density)}
    body = build(Volume.from_labels(labels, 0.01, materials), 3, frame_type=kind, damping=(0.5, 0.001))
    spec = mujoco.MjSpec.from_string('<mujoco><worldbody><geom type="plane" size="1 1 1"/></worldbody></mujoco>')
    attach(spec, body, "soft", pos=(0, 0, 0.03))
    return spec.compile()


def scale(model: mujoco.MjModel, factor: float) -> None:
    model.body_mass[:] *= factor
    model.body_inertia[:] *= factor
    mujoco.mj_setConst(model, mujoco.MjData(model))


def after(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    data.qvel[:] = np.random.default_rng(0).normal(size=model.nv) * 0.3
    mujoco.mj_step(model, data, nstep=150)
    return data.qpos.copy()


@pytest.mark.parametrize("kind", ["affine", "rigid"])
def test_twice_the_mass_is_twice_the_density(kind: str) -> None:
    wanted = after(heavy := falling(2, kind), mujoco.MjData(heavy))
    before, during = falling(1, kind), falling(1, kind)
    data = mujoco.MjData(during)  # made of the masses of before
    mujoco.mj_forward(during, data)
    scale(before, 2)
    scale(during, 2)
    unchanged = after(light := falling(1, kind), mujoco.MjData(light))
    assert np.abs(unchanged - wanted).max() > 2e-4
    np.testing.assert_allclose(after(before, mujoco.MjData(before)), wanted, rtol=0, atol=1e-6)
    np.testing.assert_allclose(after(during, data), wanted, rtol=0, atol=1e-6)


def test_frames_of_different_factors_stay_stable() -> None:
    model = falling(1, "affine")
    model.body_mass[:] *= np.random.default_rng(1).uniform(0.05, 20, model.nbody)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=2000)
    assert not any(warning.number for warning in data.warning)
    assert np.abs(data.qvel).max() < 0.1


@pytest.mark.parametrize("kind", ["affine", "rigid"])
@pytest.mark.parametrize("wrong", [-1.0, 0.0, np.nan, np.inf])
def test_a_mass_that_cannot_be_is_told_of_once(kind: str, wrong: float) -> None:
    model = falling(1, kind)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    expected, heard = soft(model, data, "soft").elastic_energy, list[str]()
    body, mass = int(soft(model, data, "soft").bodies[-1]), soft(model, data, "soft").mass
    built, model.body_mass[body] = model.body_mass[body], wrong
    mujoco.set_mju_user_warning(heard.append)
    try:
        for _ in range(3):
            mujoco.mj_forward(model, data)
    finally:
        mujoco.set_mju_user_warning(None)
    told = [text for text in heard if text.startswith("mjframes:")]
    name = model.body(body).name
    assert told == [
        f"mjframes: body '{name}' has a mass of {wrong:g} kg, which must be positive: the soft body keeps {built:g} kg "
        "there."
    ]
    np.testing.assert_array_equal(soft(model, data, "soft").mass, mass)
    assert soft(model, data, "soft").elastic_energy == pytest.approx(expected, abs=1e-12)
    model.body_mass[body] = built
    mujoco.mj_resetData(model, data)
    mujoco.mj_step(model, data, nstep=50)
    assert np.isfinite(data.qpos).all()
