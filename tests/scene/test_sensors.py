"""Sensors in MJCF: the same numbers as the views', without Python in the loop."""

from __future__ import annotations

import copy
from collections.abc import Callable
from functools import cache

import mujoco
import numpy as np
import pytest
from builders.lengthwise import LAWS, MATERIAL, block, centers
from builders.linked import ARM, CASES
from builders.linked import body as bar
from builders.scenes import FLOOR, beam, distort, jumble, lump, prefixed

import mjframes as mf
from mjframes.base.errors import MjframesError
from mjframes.scene import sensors
from mjframes.scene.view import Soft

VOIGT = ([0, 1, 2, 1, 0, 0], [0, 1, 2, 2, 2, 1])


def layered(law: str) -> mf.SoftBody:
    """Two materials, ten to one, held at one end."""
    labels = np.ones((12, 4, 4), int)
    labels[:, 2:] = 2
    volume = mf.Volume.from_labels(labels, 0.01, {1: MATERIAL, 2: mf.Material(5e5, 0.3, 1000)})
    return mf.build(volume, 3, supports=[mf.Fixed(volume.side("-x"))], law=law)


BODIES: dict[str, tuple[Callable[[], mf.SoftBody], str]] = {
    "beam": (beam, FLOOR),
    "lump": (lump, FLOOR),
    **{law: (lambda law=law: block(law), FLOOR) for law in LAWS[1:]},
    "hyperelastic, condensed": (cache(lambda: layered("neo_hookean")), FLOOR),
    "consistent": (cache(lambda: block(mass="consistent")), FLOOR),
    "all types, two links": (lambda: bar(*CASES["all types, two links of one branch"][:2]), ARM),
    "mocap body": (lambda: bar(*CASES["mocap body and a link"][:2]), ARM),
}


def sensed(body: mf.SoftBody, xml: str = FLOOR, pos: tuple[float, ...] = (0.1, 0.2, 0.3)) -> mujoco.MjSpec:
    """A scene with a soft body and all sensors of it, 20 material points each."""
    spec = mujoco.MjSpec.from_string(xml)
    parent = spec.body("upper") or spec.worldbody
    mf.attach(spec, body, "meat", parent, pos=pos, quat=(0.8, 0, -0.6, 0) if xml == FLOOR else (1, 0, 0, 0))
    for quantity, measured in sensors.QUANTITIES.items():
        mf.add_sensor(spec, body, "meat", quantity, chosen(body) if measured.reads else None)
    return spec


def test_sensors_have_as_many_values_as_their_table_says() -> None:
    model = sensed(block()).compile()
    for quantity, measured in sensors.QUANTITIES.items():
        assert model.sensor(f"meat_{quantity}").dim[0] == measured.values * (20 if measured.reads else 1)


def chosen(body: mf.SoftBody) -> np.ndarray:
    some = centers(body)
    return some[np.random.default_rng(0).choice(len(some), 20, replace=False)] + 0.001


def by_view(view: Soft, points: np.ndarray) -> dict[str, np.ndarray]:
    return {
        "elastic_energy": np.array([view.elastic_energy]),
        "kinetic_energy": np.array([view.kinetic_energy]),
        "energy_density": view.energy_densities(points),
        "stress": view.stresses(points)[:, *VOIGT],
        "strain": view.strains(points)[:, *VOIGT],
        "deformation_gradient": view.deformation_gradients(points),
        "position": view.positions(points),
        "velocity": view.velocities(points),
    }


@pytest.mark.parametrize("case", BODIES)
def test_sensors_say_what_the_views_say(case: str) -> None:
    make, xml = BODIES[case]
    body = make()
    model = sensed(body, xml, (0.1, 0.2, 0.3) if xml == FLOOR else (0, -0.03, -0.03)).compile()
    data = mujoco.MjData(model)
    rng = np.random.default_rng(1)
    for _ in range(3):
        jumble(model, data, rng, 0.005, 0.2)
        data.qvel[:] = rng.normal(size=model.nv)
        mujoco.mj_forward(model, data)
        for quantity, expected in by_view(mf.soft(model, data, "meat"), chosen(body)).items():
            found = data.sensor(f"meat_{quantity}").data
            assert np.abs(expected).max() > 0
            exact = 1e-8 if quantity == "velocity" else 1e-9 if "condensed" in case else 1e-10  # R is known to 1e-9
            np.testing.assert_allclose(found, expected.ravel(), rtol=0, atol=exact * np.abs(expected).max())


@pytest.mark.parametrize("make", [beam, lump])
def test_sensors_turn_with_their_regions_where_frames_are_turned_over(make: Callable[[], mf.SoftBody]) -> None:
    model = sensed(make()).compile()
    data = mujoco.MjData(model)
    rng = np.random.default_rng(2)
    for _ in range(3):
        distort(model, data, rng, over=True)
        view = mf.soft(model, data, "meat")
        for quantity, expected in by_view(view, chosen(make())).items():
            found = data.sensor(f"meat_{quantity}").data
            np.testing.assert_allclose(found, expected.ravel(), rtol=0, atol=1e-8 * np.abs(expected).max())


def test_sensors_survive_prefixes_and_files(tmp_path) -> None:
    body = block()
    child = sensed(body)
    expected = _after_a_while(child.compile())
    for other in prefixed(child, tmp_path, timestep=child.option.timestep):
        for name, values in _after_a_while(other).items():
            np.testing.assert_array_equal(values, expected[name.removeprefix("robot_")])


def _after_a_while(model: mujoco.MjModel) -> dict[str, np.ndarray]:
    data, touches = mujoco.MjData(model), 0
    for _ in range(150):
        mujoco.mj_step(model, data)
        touches += data.ncon
    assert touches > 0  # before it bounces
    return {model.sensor(i).name: data.sensor(i).data.copy() for i in range(model.nsensor)}


def test_two_bodies_have_their_own_sensors() -> None:
    spec = sensed(block())
    mf.attach(spec, beam(), "bone", pos=(0, 0, 2))
    mf.add_sensor(spec, beam(), "bone", "kinetic_energy", sensor_name="speed")
    model = spec.compile()
    data = mujoco.MjData(model)
    for _ in range(100):
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    for name, sensor in {"meat": "meat_kinetic_energy", "bone": "speed"}.items():
        assert data.sensor(sensor).data[0] == pytest.approx(mf.soft(model, data, name).kinetic_energy, rel=1e-10)


def test_a_cutoff_cuts() -> None:
    spec = sensed(block())
    spec.sensor("meat_kinetic_energy").cutoff = 1e-4
    model = spec.compile()
    data = mujoco.MjData(model)
    for _ in range(50):
        mujoco.mj_step(model, data)
    assert data.sensor("meat_kinetic_energy").data[0] == 1e-4


def test_energies_need_no_more_than_mjcf() -> None:
    spec = mujoco.MjSpec.from_string(FLOOR)
    mf.attach(spec, block(), "meat", pos=(0, 0, 0.1))
    sensor = """<sensor><plugin name="energy" plugin="mjframes.sensor" objtype="body" objname="meat">
        <config key="quantity" value="kinetic_energy"/></plugin></sensor></mujoco>"""
    spec.compile()
    xml = spec.to_xml().replace("</mujoco>", sensor)
    xml = xml.replace("</extension>", '<plugin plugin="mjframes.sensor"/></extension>')
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    for _ in range(10):
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    assert data.sensor("energy").data[0] == pytest.approx(mf.soft(model, data, "meat").kinetic_energy, rel=1e-10)


def assert_refused(quantity: str, change: dict[str, str], words: str) -> None:
    """A sensor of this quantity with other attributes."""
    spec = sensed(block())
    instance = next(other for other in spec.plugins if other.name == f"meat_{quantity}")
    instance.config = dict(instance.config) | change
    with pytest.raises(ValueError, match=words):
        spec.compile()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"quantity": "colour"}, r"sensor 'meat_stress': quantity has to be"),
        ({"region": ""}, r"region is not an array of type i32"),
        ({"region": "i32:1:AAAAAA=="}, r"its points are not those of the soft body"),
        ({"gradient": "f64:0:"}, r"its points are not those of the soft body"),
        ({"slack": "f64:0:"}, r"slack has another number of values"),
    ],
)
def test_a_damaged_sensor_is_refused(change: dict[str, str], words: str) -> None:
    assert_refused("stress", change, words)


@pytest.mark.parametrize("object_name", ["other", ""])
def test_a_sensor_of_no_soft_body_is_refused(object_name: str) -> None:
    spec = sensed(block())
    spec.worldbody.add_body(name="other")
    sensor = spec.sensor("meat_stress")
    sensor.objname = object_name
    sensor.objtype = mujoco.mjtObj.mjOBJ_BODY if object_name else mujoco.mjtObj.mjOBJ_UNKNOWN
    with pytest.raises(ValueError, match="objname that of a soft body"):
        spec.compile()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("meat", "colour"), "quantity is 'colour'; it must be one of 'elastic_energy'"),
        (("meat", "stress"), r"the sensor 'stress' needs points, \(n, 3\) in metres"),
        (("meat", "elastic_energy", [[0, 0, 0]]), "is of the whole body: give no points"),
        (("fish", "elastic_energy"), "name is 'fish' but the spec's soft bodies are: 'meat'"),
        (("meat", "elastic_energy"), "sensor_name is 'meat_elastic_energy', which the spec has already"),
        (("meat", "stress", np.zeros((0, 3)), "none"), "points has no point"),
        (("meat", "stress", [[9, 9, 9]], "far"), r"points\[0\] is"),
    ],
)
def test_sensors_that_cannot_be_are_refused(arguments: tuple, words: str) -> None:
    with pytest.raises(MjframesError, match=words):
        mf.add_sensor(sensed(block()), block(), *arguments)


def test_a_sensor_of_another_body_is_refused() -> None:
    with pytest.raises(MjframesError, match="body is not the one that 'meat' was made of"):
        mf.add_sensor(sensed(block()), beam(), "meat", "stress", [[0, 0, 0]])


def test_velocities_are_how_fast_positions_change() -> None:
    model = sensed(lump(), pos=(0, 0, 1)).compile()
    data = mujoco.MjData(model)
    rng = np.random.default_rng(3)
    distort(model, data, rng, speed=0.5)
    start, v, step = data.qpos.copy(), data.sensor("meat_velocity").data.copy(), 1e-6
    ends = []
    for sign in (1, -1):
        data.qpos[:] = start
        mujoco.mj_integratePos(model, data.qpos, data.qvel, sign * step)
        mujoco.mj_forward(model, data)
        ends.append(data.sensor("meat_position").data.copy())
    np.testing.assert_allclose((ends[0] - ends[1]) / (2 * step), v, atol=1e-6 * np.abs(v).max())


@pytest.mark.parametrize("cone", ["elliptic", "pyramidal"])
def test_the_contact_force_of_a_body_at_rest_is_its_weight(cone: str) -> None:
    spec = mujoco.MjSpec.from_string(FLOOR)
    spec.option.cone = getattr(mujoco.mjtCone, f"mjCONE_{cone.upper()}")
    body = block(damping=(2.0, 0.005))
    mf.attach(spec, body, "meat", pos=(0, 0, 0.001), quat=(1, 0, 0, 1))
    mf.add_sensor(spec, body, "meat", "contact_force")
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=2000)
    weight = 9.81 * model.body("meat").subtreemass[0]
    np.testing.assert_allclose(data.sensor("meat_contact_force").data, [0, 0, weight], rtol=1e-6, atol=1e-6 * weight)


def test_the_contact_force_counts_what_is_held_and_both_of_two_bodies() -> None:
    """A slab glued to the table carries another one: on it acts the other's weight, and nothing of the table's."""
    spec = mujoco.MjSpec.from_string(FLOOR)
    volume = mf.Volume.from_labels(np.ones((6, 6, 3), int), 0.01, {1: mf.Material(1e5, 0.3, 1000)})
    lower, upper = mf.build(volume, 2, supports=mf.Fixed(volume.side("-z"))), mf.build(volume, 2, damping=(2.0, 0.005))
    for name, body, height in (("lower", lower, 0.1), ("upper", upper, 0.131)):
        mf.attach(spec, body, name, pos=(0, 0, height))
        mf.add_sensor(spec, body, name, "contact_force")
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=2000)
    weight = 9.81 * model.body("upper").subtreemass[0]
    np.testing.assert_allclose(data.sensor("upper_contact_force").data, [0, 0, weight], atol=1e-4 * weight)
    np.testing.assert_allclose(data.sensor("lower_contact_force").data, [0, 0, -weight], atol=1e-4 * weight)
    mujoco.mj_forward(model, data)
    found = mf.soft(model, data, "lower").contact_forces.sum(axis=0)
    np.testing.assert_allclose(found, data.sensor("lower_contact_force").data, atol=1e-9)


def test_sensors_in_copies_say_the_same() -> None:
    model = sensed(block()).compile()
    data = mujoco.MjData(model)
    while not data.ncon:
        mujoco.mj_step(model, data)
    again = mujoco.MjData(copy.copy(model))
    mujoco.mj_setState(model, again, _state(model, data), mujoco.mjtState.mjSTATE_INTEGRATION)
    mujoco.mj_forward(model, data)
    mujoco.mj_forward(model, again)
    np.testing.assert_array_equal(again.sensordata, data.sensordata)
    np.testing.assert_array_equal(copy.copy(data).sensordata, data.sensordata)


def _state(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    state = np.zeros(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_INTEGRATION))
    mujoco.mj_getState(model, data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
    return state


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"weight_size": "i8:0:"}, "its points are not those of the soft body"),
        ({"weight_point": "i32:1:AAAAAA=="}, "its points are not those of the soft body"),
        ({"offset": "f64:0:"}, "offset has another number of values"),
        ({"rise": "f64:1:AAAAAAAAAAA="}, "its points are not those of the soft body"),
        ({"quantity": "contact_force"}, "the quantities of taxels are of the plugin mjframes.force_sensor"),
    ],
)
def test_a_damaged_sensor_of_positions_is_refused(change: dict[str, str], words: str) -> None:
    assert_refused("position", change, words)
