"""Chambers and fibres as tendons: lengths, virtual work, momentum, MuJoCo's own objects on them, sealed gas."""

from __future__ import annotations

import copy
from collections.abc import Callable

import mujoco
import numpy as np
import pytest
from builders.hollow import (
    CAVITY,
    CENTRE,
    LOW,
    SHAPE,
    SPACING,
    actuated,
    check_momentum,
    check_virtual_work,
    corrected,
    hollow,
    hollow_body,
    row,
)
from builders.linked import ARM, CASES
from builders.linked import body as linked
from builders.scenes import jumble, prefixed

import mjframes as mf
from benchmarks.stability.states import move_points
from mjframes.base.errors import MjframesError
from mjframes.body.soft_body import SoftBody
from mjframes.elasticity.law_table import LAWS
from mjframes.surface.isosurface import kept_surface
from mjframes.volume.grid import voxel_grid

pytestmark = pytest.mark.filterwarnings(
    "ignore::mjframes.scene.attach.FloatWarning",
    "ignore::mjframes.scene.attach.BranchWarning",
    "ignore::mjframes.body.build.TurnWarning",
)

BOTH: dict[str, mf.Chamber | mf.Fibre | mf.Muscle] = {"air": mf.Chamber(CENTRE), "cable": mf.Fibre(LOW)}
ANCHORED = ARM.replace('<body name="mocap"', '<site name="post" pos=".1 .1 .1"/><body name="mocap"').replace(
    '<geom size=".01" mass="0.1"/>', '<geom size=".01" mass="0.1"/><site name="grip" pos="0 .01 .02"/>'
)


@pytest.mark.parametrize("frames", [3, 10, 20])
def test_forces_do_the_work_of_volume_and_length(frames: int) -> None:
    check_virtual_work(actuated(hollow_body(frames), BOTH), ["air", "cable"])


@pytest.mark.parametrize("case", ["point", "rigid", "quadratic", "all types on a moving link", "mocap body and a link"])
def test_fibres_from_links_into_flesh_of_all_types_of_frames_do_the_work_of_their_length(case: str) -> None:
    types, links, parent = CASES[case]
    spec = mujoco.MjSpec.from_string(ANCHORED)
    path = mf.Fibre(["post", (0.03, 0.03, 0.01), (0.1, 0.02, 0.05), (0.2, 0.03, 0.03), "grip"])
    pos = (0, 0, 0) if parent == "world" else (0.01, -0.03, -0.03)
    mf.attach(spec, linked(types, links), "bar", parent, pos=pos, tendons={"cable": path})
    check_virtual_work(spec, ["cable"], 0.01)


def test_a_chamber_of_frames_that_do_not_turn_does_the_work_of_its_volume() -> None:
    """On a link that turns: what such frames leave of the points turns with it."""
    spec = mujoco.MjSpec.from_string(ARM)
    body = mf.build(hollow(), 4, frame_type="point", supports=mf.Fixed(hollow().side("-x")))
    mf.attach(spec, body, "bar", "other", tendons=BOTH)
    check_virtual_work(spec, ["air", "cable"])


@pytest.mark.parametrize("law", LAWS)
def test_lengths_are_those_of_the_moved_points_with_their_correction(law: str) -> None:
    body = hollow_body(5, law)
    spec = actuated(body, BOTH)
    model = spec.compile()
    data = mujoco.MjData(model)
    exact = np.zeros(SHAPE, bool)
    exact[CAVITY] = True
    inside = mf.Volume.from_labels(exact.astype(np.uint8), SPACING, body.materials)
    surface = kept_surface(inside, 500)
    rng = np.random.default_rng(1)
    jumble(model, data, rng, 0.0, 0.0)
    rest = mf.soft(model, data, "bar").control_positions
    assert data.sensor("air").data[0] == pytest.approx(exact.sum() * SPACING**3, rel=1e-6)
    assert model.tendon_length0[0] == pytest.approx(exact.sum() * SPACING**3, rel=1e-5)
    scale = float(next(dict(other.config) for other in spec.plugins if other.name == "air")["scale"])
    assert abs(scale - 1) > 0.01
    start = exact.sum() * SPACING**3
    for _ in range(3):
        jumble(model, data, rng, 0.003, 0.3)
        x = mf.soft(model, data, "bar").control_positions
        a, b, c = (weights_at(body, surface.vertices) @ x)[surface.faces].transpose(1, 0, 2)
        volume = start + scale * ((a * np.cross(b, c)).sum() / 6 - start) + corrected(spec, "air", x, rest)
        growth = corrected(spec, "air", x, rest, "pair_growth")
        assert abs(growth) > 1e-3
        volume += (volume - start) * growth / np.sqrt(1 + 4 * growth**2)
        assert data.sensor("air").data[0] == pytest.approx(volume, rel=1e-9)
        way = np.diff(weights_at(body, np.array(LOW)) @ x, axis=0)
        length = np.linalg.norm(way, axis=1).sum() + corrected(spec, "cable", x, rest)
        assert data.sensor("cable").data[0] == pytest.approx(length, rel=1e-9)


@pytest.mark.parametrize("types", ["affine", "rigid"])
def test_a_chamber_counts_most_of_its_frames_volume(types: str) -> None:
    """Of what frames can do, whatever its type: strains of rigid frames would count it a tenth."""
    spec = actuated(hollow_body(5, types=types), {"air": mf.Chamber(CENTRE)})
    config = next(dict(other.config) for other in spec.plugins if other.name == "air")
    assert 0.6 < float(config["scale"]) < 1.6


def weights_at(body: SoftBody, points: np.ndarray) -> np.ndarray:
    return body.shapes.at(voxel_grid(body.fields.volume), points).toarray()


@pytest.mark.parametrize("frames", [3, 10])
def test_what_acts_inside_a_body_changes_neither_of_its_momenta(frames: int) -> None:
    """A free body; rigid motions do no work, and a second of pressure and tension moves its centre nowhere."""
    check_momentum(actuated(hollow_body(frames, held=False), BOTH), {"air": 3e3, "cable": -0.5})


def test_what_pulls_between_two_trees_pulls_both_equally() -> None:
    spec = mujoco.MjSpec.from_string(ANCHORED)
    mf.attach(spec, hollow_body(3, held=False), "bar", tendons={"cable": mf.Fibre(["grip", LOW[0], LOW[-1]])})
    model = spec.compile()
    data = mujoco.MjData(model)
    jumble(model, data, np.random.default_rng(3), 0.003, 0.3)
    pulls = row(model, data, "cable")
    slider = model.joint("slider").dofadr[0]
    root = model.jnt_dofadr[next(j for j in range(model.njnt) if model.joint(j).name.startswith("bar:"))]
    assert pulls[slider] == pytest.approx(-pulls[root], rel=1e-12)  # both along x
    assert pulls[slider] != 0


def test_inverse_dynamics_derivatives_and_copies_see_them() -> None:
    model = actuated(hollow_body(), BOTH).compile()
    data = mujoco.MjData(model)
    data.ctrl[:] = 5e3, -1
    mujoco.mj_step(model, data, nstep=50)
    mujoco.mj_forward(model, data)
    applied = sum(force * row(model, data, name) for force, name in zip(data.actuator_force, BOTH, strict=True))
    np.testing.assert_allclose(data.qfrc_actuator, applied, rtol=0, atol=1e-12 * np.abs(applied).max())
    mujoco.mj_inverse(model, data)
    np.testing.assert_allclose(data.qfrc_inverse, applied, rtol=0, atol=1e-9 * np.abs(applied).max())
    fresh = mujoco.MjData(model)
    mujoco.mj_copyData(fresh, model, data)
    found = []
    for some in (data, fresh, copy.copy(data)):
        A, B = np.zeros((2 * model.nv, 2 * model.nv)), np.zeros((2 * model.nv, model.nu))
        mujoco.mjd_transitionFD(model, some, 1e-6, True, A, B, None, None)
        mujoco.mj_step(model, some, nstep=20)
        found.append((A, B, some.qpos.copy()))
    for other in found[1:]:
        for one, same in zip(found[0], other, strict=True):
            np.testing.assert_array_equal(one, same)
    mujoco.mj_copyData(fresh, model, data)
    mujoco.mj_forward(model, fresh)
    mujoco.mjd_transitionFD(model, fresh, 1e-6, True, A, B, None, None)
    first = mujoco.MjData(model)
    steps = []
    for change in (-1.0, 1.0):
        mujoco.mj_copyData(first, model, fresh)
        first.ctrl[0] += change
        mujoco.mj_step(model, first)
        steps.append(first.qvel.copy())
    np.testing.assert_allclose(B[model.nv :, 0], (steps[1] - steps[0]) / 2, rtol=1e-4, atol=1e-9)


def test_a_servo_a_limit_and_a_spring_act_on_a_volume() -> None:
    spec = actuated(hollow_body(), BOTH)
    servo = spec.actuator("air")
    servo.set_to_position(kp=1e9)  # [Pa/m³]
    model = spec.compile()
    data = mujoco.MjData(model)
    rest = model.tendon_length0[model.tendon("air").id]
    data.ctrl[0] = 1.2 * rest
    mujoco.mj_step(model, data, nstep=2000)
    assert np.abs(data.qvel).max() < 1e-4
    pressure = 1e9 * (1.2 * rest - data.ten_length[0])
    assert data.actuator_force[0] == pytest.approx(pressure, rel=1e-3)
    assert 1.02 * rest < data.ten_length[0] < 1.2 * rest

    spec.actuator("air").set_to_motor()
    model = spec.compile()
    data = mujoco.MjData(model)
    data.ctrl[0] = 2e3
    mujoco.mj_step(model, data, nstep=2000)
    free = data.ten_length[0]
    spec.tendon("air").range = [0, 1.01 * rest]
    spec.tendon("air").limited = True
    spec.tendon("air").solref_limit = [0.004, 1]
    model = spec.compile()
    data = mujoco.MjData(model)
    data.ctrl[0] = 2e3
    mujoco.mj_step(model, data, nstep=2000)
    assert 1.01 * rest < data.ten_length[0] < 1.01 * rest + 0.3 * (free - 1.01 * rest)
    assert 0 < data.efc_force[0] < 2e3

    spec.tendon("air").limited = False
    spec.tendon("air").stiffness = [1e9, 0, 0]
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert np.abs(data.qfrc_spring).max() < 1e-6  # it is as long as at rest
    data.ctrl[0] = 2e3
    mujoco.mj_step(model, data, nstep=2000)
    firm = data.ten_length[0] - rest
    model.tendon_stiffness[:] = 0
    mujoco.mj_step(model, data, nstep=2000)
    free = data.ten_length[0] - rest
    assert firm == pytest.approx(free / (1 + 1e9 * free / 2e3), rel=0.03)  # two springs, side by side


@pytest.mark.parametrize("exponent", [1.0, 1.4])
def test_sealed_gas_keeps_its_constant_over_a_squeeze(exponent: float) -> None:
    """p from the forces beside those of the same body without gas."""
    pressed = "<mujoco><option gravity='0 0 0'/></mujoco>"
    ambient, start = 1e5, 1.05e5
    sealed = mf.Chamber(CENTRE, gas=start, ambient=ambient, exponent=exponent)
    models = [actuated(hollow_body(), {"air": some}, pressed).compile() for some in (sealed, mf.Chamber(CENTRE))]
    datas = [mujoco.MjData(model) for model in models]
    view = mf.soft(models[0], datas[0], "bar")
    mujoco.mj_forward(models[0], datas[0])
    x, volume, constants = view.control_positions, [], []
    for flat in np.linspace(1, 0.8, 11):
        move_points(view, x * (1, 1, flat))
        datas[1].qpos[:] = datas[0].qpos
        for model, data in zip(models, datas, strict=True):
            mujoco.mj_forward(model, data)
        along = row(models[0], datas[0], "air")
        pressure = ambient + along @ (datas[0].qfrc_passive - datas[1].qfrc_passive) / (along @ along)
        volume.append(datas[0].ten_length[0])
        constants.append(pressure * volume[-1] ** exponent)
    assert 0.3 * volume[0] < volume[-1] < 0.8 * volume[0]
    np.testing.assert_allclose(constants, start * volume[0] ** exponent, rtol=1e-6)


def test_a_pressed_chamber_of_gas_comes_to_rest() -> None:
    """It is squeezed by a weight, and carries a part of it; no warning, nothing that is not finite."""
    table = """<mujoco><worldbody><geom type="plane" size="1 1 .1"/>
      <body pos=".06 .02 .06"><freejoint/><geom type="box" size=".04 .04 .01" mass=".3"/></body></worldbody></mujoco>"""
    found = {}
    for gas in (None, 101_325.0):
        model = actuated(hollow_body(held=False), {"air": mf.Chamber(CENTRE, gas=gas)}, table, True).compile()
        data = mujoco.MjData(model)
        for _ in range(1500):
            mujoco.mj_step(model, data)
        assert not data.warning.number.any()
        found[gas] = data.ten_length[0]
    assert found[None] < found[101_325.0] < model.tendon_length0[model.tendon("air").id]


@pytest.mark.parametrize("frames", [3, 10])
def test_gas_a_hundred_times_as_stiff_as_the_walls_is_stable(frames: int) -> None:
    """At 10 MPa h² k J M⁻¹ Jᵀ is far beyond what an explicit spring can have; it rings down and keeps its volume."""
    sealed = mf.Chamber(CENTRE, gas=1e7, ambient=1e7)
    model = actuated(hollow_body(frames), {"air": sealed}).compile()
    data = mujoco.MjData(model)
    jumble(model, data, np.random.default_rng(5), 0.001, 0.3)
    data.qvel[:] = 0
    mujoco.mj_step(model, data, nstep=3000)
    assert not data.warning.number.any()
    assert data.ten_length[0] == pytest.approx(model.tendon_length0[0], rel=0.01)
    assert mf.soft(model, data, "bar").elastic_energy < 1e-3


def test_they_survive_prefixes_files_and_copies_of_the_scene(tmp_path) -> None:
    child = actuated(hollow_body(), {**BOTH, "tie": mf.Fibre(["post", LOW[2]])}, SITE)
    expected = after_a_while(child.compile())
    model, *others = prefixed(child, tmp_path, gravity=[0, 0, 0])
    for other in (model, *others, copy.copy(model)):
        np.testing.assert_array_equal(after_a_while(other), expected)


SITE = "<mujoco><option gravity='0 0 0'/><worldbody><site name='post' pos='0.06 0.02 -0.05'/></worldbody></mujoco>"


def after_a_while(model: mujoco.MjModel) -> np.ndarray:
    data = mujoco.MjData(model)
    data.ctrl[:] = 5e3, -1, -0.5
    mujoco.mj_step(model, data, nstep=100)
    return data.sensordata.copy()


def test_nothing_is_left_of_them_where_the_body_is_taken_out() -> None:
    spec = mujoco.MjSpec.from_string(SITE)
    for _ in range(2):
        mf.attach(spec, hollow_body(), "bar", tendons=BOTH)
        assert spec.compile().ntendon == 2
        mf.detach(spec, "bar")
        model = spec.compile()
        assert (model.ntendon, model.npair, model.nmesh, model.nskin, model.nplugin) == (0, 0, 0, 0, 0)


def test_a_fibre_is_drawn_through_its_stops_and_a_chamber_by_a_skin() -> None:
    model = actuated(hollow_body(), BOTH).compile()
    data = mujoco.MjData(model)
    jumble(model, data, np.random.default_rng(4), 0.003, 0.3)
    air, cable = (model.tendon(name).id for name in BOTH)
    assert data.ten_wrapnum[air] == 0
    first = data.ten_wrapadr[cable]
    drawn = data.wrap_xpos.reshape(-1, 3)[first : first + data.ten_wrapnum[cable]]
    view = mf.soft(model, data, "bar", hollow_body())
    np.testing.assert_allclose(drawn, weights_at(hollow_body(), np.array(LOW)) @ view.control_positions, atol=1e-12)
    assert "bar:air" in [model.skin(i).name for i in range(model.nskin)]


@pytest.mark.parametrize("flag", ["contact", "constraint"])
def test_where_nothing_collides_they_rest_and_a_warning_says_why(flag: str, warnings: list[str]) -> None:
    spec = actuated(hollow_body(), BOTH)
    bit = {"contact": mujoco.mjtDisableBit.mjDSBL_CONTACT, "constraint": mujoco.mjtDisableBit.mjDSBL_CONSTRAINT}[flag]
    spec.option.disableflags |= int(bit)
    model = spec.compile()
    data = mujoco.MjData(model)
    data.ctrl[:] = 5e3, -1
    mujoco.mj_step(model, data, nstep=10)
    assert [said.partition(" rests: ")[0] for said in warnings] == [
        "mjframes: tendon 'air'",
        "mjframes: tendon 'cable'",
    ]
    assert np.abs(data.qfrc_actuator).max() < 1e-8
    model.opt.disableflags = 0
    mujoco.mj_step(model, data)
    assert np.abs(data.qfrc_actuator).max() > 1e-3


def test_mujoco_refuses_armature_which_it_would_take_from_its_own_path() -> None:
    spec = actuated(hollow_body(), BOTH)
    spec.tendon("air").armature = 1.0
    with pytest.raises(ValueError, match="armature"):
        spec.compile()


@pytest.mark.parametrize(
    ("tendon", "said"),
    [
        (lambda: mf.Chamber((0.5, 0, 0)), "no empty voxel"),
        (lambda: mf.Chamber((0.001, 0.001, 0.001)), "no empty voxel"),
        (lambda: mf.Chamber(np.ones(SHAPE, bool)), "voxels of material"),
        (lambda: mf.Chamber(np.zeros(SHAPE, bool)), "has no voxel"),
        (lambda: mf.Chamber(np.ones((2, 2, 2), bool)), "boolean mask"),
        (lambda: mf.Chamber(half(hollow().labels == 0)), "is open at"),
        (lambda: mf.Chamber(CENTRE, gas=-1.0), "gas is"),
        (lambda: mf.Chamber(CENTRE, ambient=-1.0), "ambient is"),
        (lambda: mf.Chamber(CENTRE, vertices=50), "vertices is 50; give a whole number ≥ 100"),
        (lambda: mf.Chamber(CENTRE, lid=1), "lid is"),  # pyright: ignore[reportArgumentType]
        (lambda: mf.Fibre([LOW[0]]), "two stops"),
        (lambda: mf.Fibre("post"), "two stops"),
        (lambda: mf.Fibre([LOW[0], (0, 0)]), "points[1]"),
        (lambda: mf.Fibre([LOW[0], (0.06, 0.2, 0)]), "outside the material"),
        (lambda: mf.Fibre([LOW[0], "nowhere"]), "'nowhere'"),
        (lambda: mf.Fibre(["post", "post"]), "sites only"),
        (lambda: 3, "is a int"),
    ],
)
def test_a_sentence_says_what_is_wrong_with_a_tendon(tendon: Callable[[], mf.Chamber], said: str) -> None:
    with pytest.raises(MjframesError) as found:
        mf.attach(mujoco.MjSpec.from_string(SITE), hollow_body(), "bar", tendons={"air": tendon()})
    assert said in str(found.value)
    assert str(found.value).count(". ") == 0


def test_where_a_tendon_is_wrong_nothing_of_the_body_is_left() -> None:
    spec = mujoco.MjSpec.from_string(SITE)
    kinds = ("bodies", "geoms", "sites", "meshes", "skins", "tendons", "pairs", "numerics", "texts", "plugins")
    before = {kind: len(getattr(spec, kind)) for kind in kinds}
    for wrong in (mf.Fibre([LOW[0], (0.06, 0.2, 0)]), mf.Chamber((0.5, 0, 0))):
        with pytest.raises(MjframesError):
            mf.attach(spec, hollow_body(), "bar", tendons={**BOTH, "wrong": wrong})
        assert {kind: len(getattr(spec, kind)) for kind in kinds} == before
    mf.attach(spec, hollow_body(), "bar", tendons=BOTH)
    assert spec.compile().ntendon == len(BOTH)


def test_tendons_are_a_dictionary() -> None:
    with pytest.raises(MjframesError, match="tendons is a list; give a dictionary of Chamber"):
        mf.attach(mujoco.MjSpec(), hollow_body(), "bar", tendons=[mf.Chamber(CENTRE)])  # pyright: ignore[reportArgumentType]


def test_gas_may_be_sealed_in_in_a_vacuum() -> None:
    spec = mujoco.MjSpec.from_string("<mujoco><option gravity='0 0 0'/></mujoco>")
    mf.attach(spec, hollow_body(), "bar", tendons={"air": mf.Chamber(CENTRE, gas=1e3, ambient=0.0)})
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert np.abs(data.qfrc_passive).max() > 0


def test_names_of_tendons_are_not_taken() -> None:
    spec = actuated(hollow_body(), BOTH)
    with pytest.raises(MjframesError, match="'air'"):
        mf.attach(spec, hollow_body(), "other", tendons=BOTH)


def half(mask: np.ndarray) -> np.ndarray:
    """Those of its voxels that are in the front half."""
    front = mask.copy()
    front[SHAPE[0] // 2 :] = False
    return front


def test_a_lid_closes_an_opening() -> None:
    closed = actuated(hollow_body(), {"air": mf.Chamber(half(hollow().labels == 0), lid=True)}).compile()
    data = mujoco.MjData(closed)
    mujoco.mj_forward(closed, data)
    assert data.ten_length[0] == pytest.approx(9 * 9 * SPACING**3, rel=1e-5)


@pytest.mark.slow
def test_a_cable_of_few_stops_is_a_bowstring() -> None:
    """Tips of a bar that a cable bends to a circle, over the circle's: by a cable of two stops 34 % too far."""
    bar = mf.Volume.box((0.03, 0.03, 0.24), mf.Material(5e4, 0.45, 1000), spacing=0.005)
    body = mf.build(bar, 8, supports=mf.Fixed(bar.side("z")), damping=(6, 0.01))
    ratios = {}
    for count, tension in ((2, 0.2), (4, 1.0), (8, 2.0)):
        spec = mujoco.MjSpec.from_string("<mujoco><option gravity='0 0 0'/></mujoco>")
        stops = [(0.012, 0, z) for z in np.linspace(0.119, -0.116, count)]
        attached = mf.attach(spec, body, "bar", tendons={"cable": mf.Fibre(stops)}, contact=False)
        spec.add_actuator(target="cable", trntype=mujoco.mjtTrn.mjTRN_TENDON)
        model = spec.compile()
        data = mujoco.MjData(model)
        data.ctrl[0] = -tension
        mujoco.mj_step(model, data, nstep=3000)
        curvature = tension * 0.012 / (5e4 * 0.03**4 / 12)
        circle = (1 - np.cos(0.235 * curvature)) / curvature
        ratios[count] = float(attached.soft(model, data).positions([(0, 0, -0.1175)])[0, 0]) / circle
    assert ratios == pytest.approx({2: 1.34, 4: 1.06, 8: 0.935}, abs=0.02)
