"""A factor for each material of a soft body: how exact, how safe, and the same in every world."""

from __future__ import annotations

import copy
import re
from functools import cache
from typing import Any

import mujoco
import numpy as np
import pytest
from builders.scenes import FLOOR, compiled, in_space, lump
from mujoco import rollout
from mujoco.batch import Batch

from mjframes.base.errors import MjframesError
from mjframes.body.build import build
from mjframes.body.soft_body import SoftBody
from mjframes.elasticity.shares import by_material, factor_of, scaled
from mjframes.frames.supports import Fixed
from mjframes.scene.attach import attach
from mjframes.scene.scaling import materials, scale
from mjframes.scene.sensors import add_sensor
from mjframes.scene.view import soft, soft_names
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

FULL = mujoco.mjtState.mjSTATE_FULLPHYSICS
LAWS = [
    ("corotational", "whole_body"),
    ("corotational", "paper"),
    ("neo_hookean", "whole_body"),
    ("neo_hookean", "paper"),
]


@cache
def layered(
    core: float = 1.0, skin: float = 1.0, law: str = "corotational", method: str = "whole_body", held: bool = True
) -> SoftBody:
    """A soft core with stiffer skins above and below and a bone at its end; their moduli times `core` and `skin`."""
    labels = np.full((16, 5, 6), 4)
    labels[:, :, 0] = labels[:, :, 5] = 7
    labels[14:] = 5
    table = {
        7: Material(2e5 * skin, 0.3, 1100, name="skin"),
        4: Material(2e4 * core, 0.4, 1000, name="core"),
        5: Material.rigid(1900, name="bone"),
    }
    clamp = np.zeros(labels.shape, bool)
    clamp[0] = True
    supports = [Fixed(clamp)] if held else []
    metric = "even"  # as the paper's method would move frames and weights with the moduli
    volume = Volume.from_labels(labels, 0.01, table)
    return build(volume, 3, supports=supports, law=law, method=method, metric=metric)


def compliance(body: SoftBody, factors: dict[str, float] | None = None) -> np.ndarray:
    """How material points move [m] by the body's weight along each axis and by pushes, by the plugin's own forces."""
    model, data = compiled("<mujoco/>", (body, (0, 0, 0), (1, 0, 0, 0)), contact=False)
    scale(model, "soft0", materials=factors)
    view = soft(model, data, "soft0")
    mujoco.mj_forward(model, data)
    loads = []
    for axis in np.eye(3):
        model.opt.gravity[:] = axis
        mujoco.mj_forward(model, data)
        loads.append(-data.qfrc_bias)
        for points in ([[0.14, 0.025, 0.055]], [[0.07, 0.025, 0.055], [0.08, 0.025, 0.055]], [[0.15, 0.045, 0.01]]):
            data.qfrc_applied[:] = 0
            view.apply_force(points, np.tile(axis, (len(points), 1)))
            loads.append(data.qfrc_applied.copy())
    stiffness, small = np.zeros((model.nv, model.nv)), 1e-6
    for i in range(model.nv):
        for sign in (-1, 1):
            data.qpos[:], data.qvel[:] = 0, 0
            data.qpos[i] = sign * small
            mujoco.mj_forward(model, data)
            stiffness[i] -= sign * data.qfrc_passive / (2 * small)
    places = 0.01 * (np.stack(np.meshgrid([2, 6, 10, 14], [1, 4], [0.5, 3, 5.5], indexing="ij"), -1).reshape(-1, 3))
    data.qpos[:] = 0
    mujoco.mj_forward(model, data)
    rest, moved = view.positions(places), []
    for x in np.linalg.solve(stiffness, np.array(loads).T).T:
        data.qpos[:] = x * small / np.abs(x).max()
        mujoco.mj_forward(model, data)
        moved.append((view.positions(places) - rest) * np.abs(x).max() / small)
    return np.array(moved).reshape(len(loads), -1)


def off(found: np.ndarray, wanted: np.ndarray) -> float:
    """The largest relative error of displacements over the loads."""
    return float((np.linalg.norm(found - wanted, axis=1) / np.linalg.norm(wanted, axis=1)).max())


def turned_away(model: mujoco.MjModel) -> mujoco.MjData:
    data = mujoco.MjData(model)
    data.qpos[:] = 0.003 * np.random.default_rng(0).normal(size=model.nq)
    mujoco.mj_forward(model, data)
    return data


def shaken(model: mujoco.MjModel) -> np.ndarray:
    """Positions after 60 steps from random velocities."""
    data = mujoco.MjData(model)
    data.qvel[:] = np.random.default_rng(0).normal(size=model.nv) * 0.3
    mujoco.mj_step(model, data, nstep=60)
    assert not any(warning.number for warning in data.warning)
    return data.qpos.copy()


def on_floor(body: SoftBody) -> mujoco.MjModel:
    return compiled(FLOOR, (body, (0, 0, 0.03), (1, 0, 0, 0)))[0]


@pytest.mark.parametrize(
    ("law", "factor", "bound"),
    [
        pytest.param("corotational", 0.25, 0.21, marks=pytest.mark.slow),
        ("corotational", 0.5, 0.06),
        ("corotational", 2.0, 0.065),
        pytest.param("corotational", 4.0, 0.19, marks=pytest.mark.slow),
        pytest.param("neo_hookean", 0.5, 0.04, marks=pytest.mark.slow),
        pytest.param("neo_hookean", 2.0, 0.05, marks=pytest.mark.slow),
    ],
)
def test_a_factor_of_one_material_is_close_to_a_body_built_so(law: str, factor: float, bound: float) -> None:
    """Of displacements; without it they would be off by a third and more. A factor of the other is its inverse."""
    wanted, built = compliance(layered(factor, law=law)), layered(law=law)
    assert off(compliance(built), wanted) > 0.3
    assert off(compliance(built, {"core": factor}), wanted) < bound


@pytest.mark.parametrize(("law", "method"), LAWS)
def test_all_materials_alike_are_the_common_factor(law: str, method: str) -> None:
    both, one = (
        on_floor(layered(law=law, method=method, held=False)),
        on_floor(layered(law=law, method=method, held=False)),
    )
    scale(both, "soft0", materials={"core": 1.7, "skin": 1.7})
    scale(one, "soft0", 1.7)
    np.testing.assert_array_equal(both.numeric_data, one.numeric_data)
    near = copy.copy(one)
    scale(near, "soft0", 1.7, materials={"core": 1.7 * (1 + 1e-12)})
    np.testing.assert_allclose(shaken(near), shaken(one), rtol=0, atol=1e-10)


@pytest.mark.parametrize(("law", "method"), LAWS)
def test_the_step_works_with_what_the_equations_say(law: str, method: str) -> None:
    """Forces, energies and sensors, against the regions written as their equations."""
    body, spec = layered(law=law, method=method, held=False), mujoco.MjSpec()
    points = [[0.05, 0.025, 0.005], [0.05, 0.025, 0.03], [0.15, 0.025, 0.03]]
    attach(spec, body, "soft0", contact=False)
    for quantity in ("energy_density", "stress"):
        add_sensor(spec, body, "soft0", quantity, points)
    add_sensor(spec, body, "soft0", "elastic_energy")
    model = spec.compile()
    model.opt.gravity[:] = 0
    densities, seen = [], []
    many: tuple[dict[int | str, float], ...] = ({}, {"core": 0.3, "skin": 2.5})
    for factors in many:
        scale(model, "soft0", materials=factors)
        data = turned_away(model)
        view = soft(model, data, "soft0")
        forces, size = view.elastic_forces, np.abs(data.qfrc_passive).max()
        pushed = data.qfrc_applied
        for j, force in enumerate(forces):
            mujoco.mj_applyFT(model, data, force, np.zeros(3), view.control_positions[j], int(view.bodies[j]), pushed)
        np.testing.assert_allclose(data.qfrc_passive, pushed, rtol=0, atol=1e-10 * size)
        np.testing.assert_allclose(forces.sum(axis=0), 0, atol=1e-11 * np.abs(forces).max())
        densities.append(data.sensordata[:3].copy())
        seen.append(view.energy_densities(points))
        np.testing.assert_allclose(data.sensordata[:3], seen[-1], rtol=1e-6)
        np.testing.assert_allclose(data.sensordata[3:21:6], view.stresses(points)[:, 0, 0], rtol=1e-6)
        np.testing.assert_allclose(data.sensordata[21], view.elastic_energy, rtol=1e-10)
    for of_points in (densities, seen):
        # bone follows the skin; regions turn a little otherwise with other moduli
        np.testing.assert_allclose(of_points[1] / of_points[0], [2.5, 0.3, 2.5], rtol=2e-3)


@pytest.mark.parametrize(("law", "method"), LAWS)
def test_shares_add_up_and_keep_every_region_positive(law: str, method: str) -> None:
    body, generator = layered(law=law, method=method), np.random.default_rng(2)
    matrices = body.cells.remainder if body.cells else body.stiffness.matrix
    shares = body.cells.shares if body.cells else body.stiffness.shares
    for matrix, own in zip(matrices, shares, strict=True):
        size = np.linalg.eigvalsh(matrix)[-1]
        np.testing.assert_allclose(by_material(matrix, own).sum(axis=0), matrix, rtol=0, atol=1e-12 * size)
        np.testing.assert_allclose(scaled(matrix, own, np.full(2, 3.0)), 3 * matrix, rtol=0, atol=1e-10 * size)
        for factors in 10 ** generator.uniform(-3, 3, (20, 2)):
            values = np.linalg.eigvalsh(scaled(matrix, own, factors))
            assert values[0] > -1e-9 * values[-1]
        step = 1e-5
        slopes = [(scaled(matrix, own, 1 + s) - scaled(matrix, own, 1 - s)) / (2 * step) for s in step * np.eye(2)]
        np.testing.assert_allclose(slopes, by_material(matrix, own), rtol=0, atol=1e-6 * size)


def test_rigid_materials_follow_the_stiffest_that_deforms() -> None:
    body = layered()
    assert body.deformable == {4: "core", 7: "skin"}
    assert body.factor_of.tolist() == [0, 1, 1]
    assert factor_of([Material.rigid(1000)]).tolist() == [0]
    model = on_floor(body)
    assert materials(model, "soft0") == soft(model, mujoco.MjData(model), "soft0").materials == body.deformable
    assert model.numeric("soft0:stiffness").data.shape == (2,)


def test_factors_are_of_what_was_built() -> None:
    model = on_floor(layered(held=False))
    built = shaken(model)
    scale(model, "soft0", materials={"skin": 3.0})
    once = shaken(model)
    scale(model, "soft0", materials={4: 0.5})
    scale(model, "soft0", materials={7: 3.0})
    np.testing.assert_array_equal(shaken(model), once)
    scale(model, "soft0", materials={"core": 0.5, 7: 3.0})
    np.testing.assert_array_equal(model.numeric("soft0:stiffness").data, [0.5, 3.0])
    scale(model, "soft0", 2.0, materials={"skin": 3.0})
    np.testing.assert_array_equal(model.numeric("soft0:stiffness").data, [2.0, 3.0])
    scale(model, "soft0", damping=(2, 3))
    np.testing.assert_array_equal(model.numeric("soft0:stiffness").data, [2.0, 3.0])
    scale(model, "soft0", materials={}, damping=(1, 1))
    np.testing.assert_array_equal(shaken(model), built)
    assert np.abs(once - built).max() > 1e-4


def worlds(count: int = 16) -> tuple[np.ndarray, np.ndarray]:
    generator = np.random.default_rng(5)
    return generator.uniform(0.5, 2, count), generator.uniform(0.5, 2, count)


def alone(model: mujoco.MjModel, start: np.ndarray, steps: int) -> np.ndarray:
    state, data = np.zeros_like(start), mujoco.MjData(model)
    mujoco.mj_setState(model, data, start, FULL)
    mujoco.mj_step(model, data, nstep=steps)
    mujoco.mj_getState(model, data, state, FULL)
    return state


def started(model: mujoco.MjModel) -> np.ndarray:
    data, start = mujoco.MjData(model), np.zeros(mujoco.mj_stateSize(model, FULL))
    data.qvel[:] = np.random.default_rng(0).normal(size=model.nv) * 0.3
    mujoco.mj_getState(model, data, start, FULL)
    return start


@pytest.mark.parametrize("law", ["corotational", "neo_hookean"])
@pytest.mark.parametrize("threads", [1, 2])
def test_worlds_of_a_batch_are_the_single_runs(law: str, threads: int) -> None:
    """Bit by bit, though few mjDatas serve many worlds."""
    model = on_floor(layered(law=law, held=False))
    core, skin = worlds()
    core[3] = skin[3] = 1.0
    core[4] = skin[4] = 1.5
    start, batch = started(model), Batch(model, 16, threads)
    scale(batch, "soft0", materials={"core": core, "skin": skin})
    batch.state[:, : len(start)] = start
    for _ in range(4):
        batch.step(nstep=5)
    for i in range(16):
        single = copy.copy(model)
        scale(single, "soft0", materials={"core": core[i], "skin": skin[i]})
        np.testing.assert_array_equal(batch.state[i, : len(start)], alone(single, start, 20))
    assert np.abs(np.diff(batch.bind("qpos"), axis=0)).max(axis=1).min() > 1e-6


def test_worlds_of_a_rollout_are_the_single_runs() -> None:
    model = on_floor(layered(held=False))
    core, skin = worlds()
    models = [copy.copy(model) for _ in core]
    for some, c, s in zip(models, core, skin, strict=True):
        scale(some, "soft0", materials={"core": c, "skin": s})
    start = started(model)
    states, _ = rollout.rollout(models, [mujoco.MjData(model) for _ in range(2)], np.tile(start, (16, 1)), nstep=30)
    for some, rolled in zip(models, states, strict=True):
        np.testing.assert_array_equal(rolled[-1], alone(some, start, 30))


def test_worlds_of_a_batch_are_scaled_one_by_one() -> None:
    model = on_floor(layered(held=False))
    batch = Batch(model, 4, 1)
    place = slice(0, 2)
    scale(batch, "soft0", materials={"core": 2.0})
    scale(batch, "soft0", 3.0, worlds=1)
    scale(batch, "soft0", materials={"skin": [0.5, 0.25]}, worlds=[2, 0])
    wanted = [[1, 0.25], [3, 3], [1, 0.5], [2, 1]]
    np.testing.assert_array_equal(batch.expand("numeric_data")[:, place], wanted)
    scale(batch, "soft0", damping=np.full((4, 2), 2.0))
    np.testing.assert_array_equal(batch.expand("numeric_data")[:, 2:], 2)
    np.testing.assert_array_equal(model.numeric_data, 1)
    batch = Batch(model, 4, 1)
    batch.set_models(model)
    with pytest.raises(MjframesError, match="the batch cannot have a material a world"):
        scale(batch, "soft0", 2.0)


def test_copies_of_data_and_models_have_their_own() -> None:
    model = on_floor(layered(held=False))
    scale(model, "soft0", materials={"core": 0.5})
    other = copy.copy(model)
    scale(other, "soft0", materials={"core": 2.0})
    data = mujoco.MjData(model)
    data.qvel[:] = 0.2 * np.random.default_rng(1).normal(size=model.nv)
    mujoco.mj_step(model, data, nstep=10)
    copied = copy.copy(data)
    mujoco.mj_step(other, copied, nstep=10)  # the copy's plugin has seen no factor yet
    fresh = mujoco.MjData(other)
    state = np.zeros(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_INTEGRATION))
    mujoco.mj_getState(model, data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
    mujoco.mj_setState(other, fresh, state, mujoco.mjtState.mjSTATE_INTEGRATION)
    mujoco.mj_step(other, fresh, nstep=10)
    np.testing.assert_array_equal(copied.qpos, fresh.qpos)


@pytest.mark.parametrize("around", [None, ("left_", ""), ("left_", "_end")])
@pytest.mark.parametrize("name", ["steak", "s"])
def test_materials_survive_prefixes_suffixes_and_files(around: tuple[str, str] | None, name: str) -> None:
    spec = mujoco.MjSpec()
    attach(spec, layered(held=False), name)
    if around:
        outer = mujoco.MjSpec.from_string(FLOOR)
        outer.attach(spec, prefix=around[0], suffix=around[1], frame=outer.worldbody.add_frame())
        spec = outer
    reference = on_floor(layered(held=False))
    for model in (spec.compile(), mujoco.MjModel.from_xml_string(spec.to_xml())):
        (called,) = soft_names(model)
        assert materials(model, called) == {4: "core", 7: "skin"}
        energies = []
        for some, own in ((model, called), (reference, "soft0")):
            scale(some, own, materials={"core": 0.5, "skin": 2.0})
            energies.append(soft(some, turned_away(some), own).elastic_energy)
        np.testing.assert_allclose(*energies, rtol=1e-5)


def test_a_material_may_be_called_as_an_argument_is() -> None:
    table = {1: Material(1e4, 0.3, 1000, name="damping"), 2: Material(2e4, 0.3, 1000, name="worlds")}
    labels = np.ones((6, 3, 3), int)
    labels[3:] = 2
    model = on_floor(build(Volume.from_labels(labels, 0.01, table), 2))
    scale(model, "soft0", materials={"damping": 2.0, "worlds": 3.0})
    np.testing.assert_array_equal(model.numeric("soft0:stiffness").data, [2, 3])
    np.testing.assert_array_equal(model.numeric("soft0:damping").data, [1, 1])


def test_names_may_have_any_letters() -> None:
    labels = np.ones((8, 3, 3), int)
    labels[4:] = 2
    labels[:, 2] = 9
    table = {
        1: Material(1e4, 0.3, 1000, name="a=b, c"),
        2: Material(2e4, 0.3, 1000, name='süß"<'),
        9: Material(3e4, 0.3, 1000),
    }
    body, spec = build(Volume.from_labels(labels, 0.01, table), 2), mujoco.MjSpec()
    attach(spec, body, "soft0")
    model = mujoco.MjModel.from_xml_string(spec.to_xml())
    assert materials(model, "soft0") == {1: "a=b, c", 2: 'süß"<', 9: ""}
    scale(model, "soft0", materials={"a=b, c": 2.0, 'süß"<': 3.0, 9: 4.0})
    np.testing.assert_array_equal(model.numeric("soft0:stiffness").data, [2, 3, 4])


def test_a_saved_body_keeps_its_shares(tmp_path: Any) -> None:
    for law in ("corotational", "neo_hookean"):
        body = layered(law=law)
        body.save(tmp_path / "body.npz")
        read = SoftBody.load(tmp_path / "body.npz")
        for some, kept in ((body.stiffness, read.stiffness), (body.cells, read.cells)):
            for old, new in zip(some.shares if some else (), kept.shares if kept else (), strict=True):
                np.testing.assert_array_equal(old, new)
        assert read.deformable == body.deformable


@pytest.mark.parametrize("wrong", [0.0, -1.0, np.nan, np.inf])
def test_a_factor_that_cannot_be_is_told_of_once_and_counts_as_one(wrong: float, warnings: list[str]) -> None:
    model = on_floor(layered(held=False))
    scale(model, "soft0", materials={"core": 2.0})
    wanted = shaken(model)
    model.numeric("soft0:stiffness").data[1] = wrong
    data = mujoco.MjData(model)
    data.qvel[:] = np.random.default_rng(0).normal(size=model.nv) * 0.3
    mujoco.mj_step(model, data, nstep=60)
    np.testing.assert_array_equal(data.qpos, wanted)
    assert len(warnings) == 1
    assert f"'soft0:stiffness' is {wrong:g}, but has to be a positive factor" in warnings[0]
    assert np.isfinite(soft(model, data, "soft0").elastic_energy)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"materials": {"bone": 2.0}}, "'bone' is no material that deforms: 'soft0' has 4 ('core'), 7 ('skin')."),
        ({"materials": {5: 2.0}}, "5 is no material that deforms: 'soft0' has 4 ('core'), 7 ('skin')."),
        ({"materials": {True: 2.0}}, "True is no material that deforms"),
        ({"materials": {"core": 0.0}}, "the factor of material 'core' is 0.0; give a positive factor"),
        ({"materials": {"core": "2"}}, "the factor of material 'core' is '2'; give a positive factor"),
        ({"materials": {"core": [1.0, 2.0]}}, "the factor of material 'core' is [1.0, 2.0]; give a positive factor"),
        ({"materials": {"core": True}}, "the factor of material 'core' is True; give a positive factor"),
        ({"materials": {"core": np.nan, "skin": 2.0}}, "the factor of material 'core' is nan; give a positive factor"),
        ({"materials": {"core": 2.0}, "damping": 1.0}, "damping is 1.0; give two positive factors"),
        ({"factor": {"core": 2.0}}, "factor is {'core': 2.0}; it must be one for all materials"),
        ({"materials": 2.0}, "materials is 2.0; it must map names or labels to factors"),
        ({"materials": {"core": 2.0}, "worlds": 0}, "worlds is given, but the model is that of one"),
    ],
)
def test_bad_factors_are_refused_in_a_sentence(arguments: dict[str, Any], sentence: str) -> None:
    model, _ = in_space(layered(held=False))
    with pytest.raises(MjframesError, match=re.escape(sentence)):
        scale(model, "soft0", **arguments)
    np.testing.assert_array_equal(model.numeric_data, 1)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (
            {"materials": {"core": np.ones(3)}},
            "the factor of material 'core' is array([1., 1., 1.]); give a positive factor of the moduli",
        ),
        ({"materials": {"core": 2.0}, "worlds": 4}, "worlds is 4; give numbers of worlds from 0 to 3"),
        ({"materials": {"core": 2.0}, "worlds": [-1]}, "worlds is [-1]; give numbers of worlds from 0 to 3"),
        ({"materials": {"core": [1.0, 2.0]}, "worlds": [0]}, "or 1 of them, one a world"),
    ],
)
def test_bad_factors_of_worlds_are_refused_in_a_sentence(arguments: dict[str, Any], sentence: str) -> None:
    batch = Batch(in_space(layered(held=False))[0], 4, 1)
    with pytest.raises(MjframesError, match=re.escape(sentence)):
        scale(batch, "soft0", **arguments)
    np.testing.assert_array_equal(batch.expand("numeric_data"), 1)


def test_several_materials_of_one_name_need_their_labels() -> None:
    model, _ = in_space(lump())
    with pytest.raises(MjframesError, match=re.escape("'' is the name of several materials; give their labels")):
        scale(model, "soft0", materials={"": 2.0})


def test_bodies_of_one_material_have_one_factor() -> None:
    body = build(
        Volume.from_labels(
            np.ones((6, 3, 3), int),
            0.01,
            {3: Material(1e4, 0.3, 1000, name="gum")} | {1: Material(1e4, 0.3, 1000, name="gel")},
        ),
        2,
    )
    model = on_floor(body)
    assert "materials" not in soft(model, mujoco.MjData(model), "soft0").configuration
    scale(model, "soft0", materials={"gel": 2.0})
    np.testing.assert_array_equal(model.numeric("soft0:stiffness").data, [2.0])
