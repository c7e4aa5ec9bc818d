"""A material of its own for each world: factors of stiffness and damping that a model says, not the built body."""

from __future__ import annotations

import copy
import re
from typing import Any

import mujoco
import numpy as np
import pytest
from builders.scenes import FLOOR, beam, compiled, in_space, lump
from mujoco import rollout

from mjframes.base.errors import MjframesError
from mjframes.body.build import build
from mjframes.body.soft_body import SoftBody
from mjframes.scene.attach import attach
from mjframes.scene.scaling import scale
from mjframes.scene.sensors import add_sensor
from mjframes.scene.view import soft, soft_names
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

FULL = mujoco.mjtState.mjSTATE_FULLPHYSICS


def bar(factor: float, law: str = "corotational", method: str = "whole_body", beta: float = 0.001) -> SoftBody:
    """Of two materials, both of them `factor` times as stiff."""
    labels = np.ones((8, 4, 4), int)
    labels[:3] = 2
    materials = {1: Material(3e4 * factor, 0.4, 1000), 2: Material(1e5 * factor, 0.3, 1500)}
    damping = (0.5, beta)
    return build(Volume.from_labels(labels, 0.01, materials), 3, law=law, method=method, damping=damping)


def dropped(body: SoftBody) -> tuple[mujoco.MjModel, mujoco.MjData]:
    return compiled(FLOOR, (body, (0, 0, 0.03), (1, 0, 0, 0)))


def moved(model: mujoco.MjModel) -> np.ndarray:
    return moved_by(model, mujoco.MjData(model))


def moved_by(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Positions after 100 steps."""
    data.qvel[:] = np.random.default_rng(0).normal(size=model.nv) * 0.3
    mujoco.mj_step(model, data, nstep=100)
    assert not any(warning.number for warning in data.warning)
    return data.qpos.copy()


@pytest.mark.parametrize(
    ("law", "method"), [("corotational", "whole_body"), ("neo_hookean", "whole_body"), ("neo_hookean", "paper")]
)
def test_a_factor_is_as_good_as_stiffer_materials(law: str, method: str) -> None:
    stiff, soft_one, scaled = (dropped(bar(factor, law, method))[0] for factor in (2.0, 1.0, 1.0))
    scale(scaled, "soft0", 2.0)
    wanted = moved(stiff)
    assert np.abs(moved(soft_one) - wanted).max() > 1e-4
    np.testing.assert_allclose(moved(scaled), wanted, rtol=0, atol=1e-14)


def test_damping_is_scaled_as_if_built_so() -> None:
    model = dropped(lump(0.5, 0.001))[0]
    wanted = moved(dropped(lump(1.0, 0.004))[0])
    assert np.abs(moved(model) - wanted).max() > 1e-4
    scale(model, "soft0", damping=(2.0, 4.0))
    np.testing.assert_array_equal(moved(model), wanted)


def test_factors_do_not_add_up_and_one_is_what_was_built() -> None:
    model = dropped(lump(0.5, 0.001))[0]
    built = moved(model)
    scale(model, "soft0", 3.0, damping=(2.0, 2.0))
    scale(model, "soft0", 1.5)
    once = dropped(lump(0.5, 0.001))[0]
    scale(once, "soft0", 1.5, damping=(2.0, 2.0))
    np.testing.assert_array_equal(moved(model), moved(once))
    scale(model, "soft0", 1.0, damping=(1.0, 1.0))
    np.testing.assert_array_equal(moved(model), built)


def test_only_the_body_that_is_named_changes() -> None:
    model, data = compiled(FLOOR, (lump(), (0, 0, 0.1), (1, 0, 0, 0)), (lump(), (1, 0, 0.1), (1, 0, 0, 0)))
    data.qpos[:] += 0.01 * np.random.default_rng(0).normal(size=model.nq)
    mujoco.mj_forward(model, data)
    views = [soft(model, data, name) for name in ("soft0", "soft1")]
    before = [view.elastic_energy for view in views]
    scale(model, "soft1", 2.0)
    assert [view.elastic_energy for view in views] == [before[0], 2 * before[1]]


def test_views_and_sensors_tell_what_the_step_works_with() -> None:
    point = [[0.025, 0.025, 0.025]]
    body, spec = beam(), mujoco.MjSpec()
    attach(spec, body, "soft0", contact=False)
    for quantity in ("stress", "energy_density"):
        add_sensor(spec, body, "soft0", quantity, point)
    add_sensor(spec, body, "soft0", "elastic_energy")
    model = spec.compile()
    model.opt.gravity[:] = 0
    data = mujoco.MjData(model)
    data.qpos[:] = 0.003 * np.random.default_rng(0).normal(size=model.nq)
    view = soft(model, data, "soft0")

    def told() -> list[np.ndarray]:
        mujoco.mj_forward(model, data)
        values = view.stresses(point), view.energy_densities(point), view.elastic_energy, view.elastic_forces
        return [np.array(some).ravel() for some in (data.sensordata, data.qfrc_passive, *values)]

    before = told()
    s = before[2].reshape(3, 3)
    by_view = [s[0, 0], s[1, 1], s[2, 2], s[1, 2], s[0, 2], s[0, 1], *before[3], *before[4]]
    np.testing.assert_allclose(before[0], by_view, rtol=1e-6)
    scale(model, "soft0", 2.0)
    for scaled, built in zip(told(), before, strict=True):
        assert np.abs(built).max() > 0
        np.testing.assert_allclose(scaled, 2 * built, rtol=1e-12, atol=1e-12 * np.abs(built).max())


def test_rollouts_of_models_of_different_factors_are_the_single_runs() -> None:
    model = dropped(lump(0.5, 0.001))[0]
    models = [copy.copy(model) for _ in range(16)]
    for i, some in enumerate(models):
        scale(some, "soft0", 0.5 + 0.1 * i, damping=(1.0, 1 + i))
    data = mujoco.MjData(model)
    data.qvel[:] = np.random.default_rng(0).normal(size=model.nv) * 0.3
    start = np.zeros(mujoco.mj_stateSize(model, FULL))
    mujoco.mj_getState(model, data, start, FULL)
    states, _ = rollout.rollout(models, [mujoco.MjData(model) for _ in range(2)], np.tile(start, (16, 1)), nstep=60)
    for some, rolled in zip(models, states, strict=True):
        single, alone = np.zeros_like(start), mujoco.MjData(some)
        mujoco.mj_setState(some, alone, start, FULL)
        mujoco.mj_step(some, alone, nstep=60)
        mujoco.mj_getState(some, alone, single, FULL)
        np.testing.assert_array_equal(rolled[-1], single)
    assert np.abs(np.diff(states[:, -1], axis=0)).max(axis=1).min() > 1e-5


@pytest.mark.parametrize("around", [None, ("left_", ""), ("left_", "_end")])
@pytest.mark.parametrize("name", ["steak", "s"])
def test_factors_survive_prefixes_suffixes_and_files(around: tuple[str, str] | None, name: str) -> None:
    spec = mujoco.MjSpec()
    attach(spec, lump(), name)
    if around:
        outer = mujoco.MjSpec.from_string(FLOOR)
        outer.attach(spec, prefix=around[0], suffix=around[1], frame=outer.worldbody.add_frame())
        spec = outer
    for model in (spec.compile(), mujoco.MjModel.from_xml_string(spec.to_xml())):
        np.testing.assert_array_equal(model.numeric_data, np.ones(5))
        (called,) = soft_names(model)
        data = mujoco.MjData(model)
        data.qpos[:] = 0.001 * np.random.default_rng(0).normal(size=model.nq)
        mujoco.mj_forward(model, data)
        view = soft(model, data, called)
        energy, force = view.elastic_energy, data.qfrc_passive.copy()
        scale(model, called, 2.0)
        mujoco.mj_forward(model, data)
        assert view.elastic_energy == 2 * energy
        np.testing.assert_allclose(data.qfrc_passive, 2 * force, rtol=0, atol=1e-12 * np.abs(force).max())


def test_a_saved_factor_is_read_back() -> None:
    spec = mujoco.MjSpec()
    attach(spec, lump(), "steak")
    numeric = spec.numeric("steak:stiffness")
    numeric.data = [1.5, 1.5, 1.5]
    model = mujoco.MjModel.from_xml_string(spec.to_xml())
    scaled = spec.compile()
    np.testing.assert_array_equal(model.numeric("steak:stiffness").data, [1.5, 1.5, 1.5])
    scale(scaled, "steak", 1.5)
    np.testing.assert_allclose(moved(model), moved(scaled), rtol=0, atol=1e-6)  # text has six digits of the masses


@pytest.mark.parametrize("wrong", [0.0, -1.0, np.nan, np.inf])
def test_a_factor_that_cannot_be_is_told_of_once_and_counts_as_one(wrong: float, warnings: list[str]) -> None:
    model = dropped(lump(0.5, 0.001))[0]
    wanted, data = moved(model), mujoco.MjData(model)
    model.numeric("soft0:stiffness").data[:] = wrong
    model.numeric("soft0:damping").data[1] = wrong
    np.testing.assert_array_equal(moved_by(model, data), wanted)
    assert warnings == [
        f"mjframes: numeric 'soft0:stiffness' is {wrong:g}, but has to be a positive factor: it counts as 1."
    ]
    assert np.isfinite(soft(model, data, "soft0").elastic_energy)


def test_a_numeric_of_another_size_is_refused(warnings: list[str]) -> None:
    spec = mujoco.MjSpec()
    attach(spec, lump(), "steak")
    numeric = spec.numeric("steak:stiffness")
    numeric.size, numeric.data = 2, [1.0, 1.0]
    with pytest.raises(ValueError, match="its numeric 'stiffness' has 2 values, but has to have 3"):
        spec.compile()
    assert all(text.startswith("mjframes: soft body 'steak'") for text in warnings)


def test_models_without_numerics_are_as_they_were_built() -> None:
    spec = mujoco.MjSpec.from_string(FLOOR)
    attach(spec, lump(), "soft0", pos=(0, 0, 0.03))
    wanted = moved(spec.compile())
    for key in ("stiffness", "damping"):
        spec.delete(spec.numeric(f"soft0:{key}"))
    model = spec.compile()
    assert not model.nnumeric
    np.testing.assert_array_equal(moved(model), wanted)
    with pytest.raises(MjframesError, match="name is 'soft0' but the soft bodies that the model can scale are: none"):
        scale(model, "soft0", 2.0)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (
            {"name": "flesh", "factor": 2.0},
            "soft bodies that the model can scale are: 'soft0'",
        ),
        ({"name": "soft0", "factor": 0.0}, "factor is 0.0; give a positive factor"),
        ({"name": "soft0", "factor": np.nan}, "factor is nan; give a positive factor"),
        ({"name": "soft0", "factor": "2"}, "factor is '2'; give a positive factor"),
        ({"name": "soft0", "damping": 2.0}, "damping is 2.0; give two positive factors"),
        ({"name": "soft0", "damping": (1.0, -1.0)}, "damping is (1.0, -1.0); give two positive factors"),
    ],
)
def test_bad_factors_are_refused_in_a_sentence(arguments: dict[str, Any], sentence: str) -> None:
    model, _ = in_space(lump())
    with pytest.raises(MjframesError, match=re.escape(sentence)):
        scale(model, **arguments)
    np.testing.assert_array_equal(model.numeric_data, np.ones(5))
