"""Taxels: what presses on a soft body's surface, where, and how its markers move."""

from __future__ import annotations

from functools import cache

import mujoco
import numpy as np
import pytest
from builders.punch import on_squares, pressed_slab
from numpy.typing import NDArray

import mjframes as mf
from mjframes.base.errors import MjframesError
from mjframes.scene import taxels
from mjframes.scene.load import mujoco_warnings

YOUNG, POISSON, SPACING = 1e5, 0.45, 0.005
WIDTH, THICK = 0.1, 0.02  # [m] of a pad, glued at its base
TOP = (WIDTH / 2, WIDTH / 2, THICK)
NEAR_MIDDLE = np.array([*np.arange(0, 0.0251, 0.0025), 0.03, 0.04, 0.05])  # [m]
UPWARDS = np.array([0, 0.005, 0.01, 0.015, 0.0175, 0.02])
SHAPES = {
    "box": {"type": mujoco.mjtGeom.mjGEOM_BOX, "size": (0.02, 0.02, 0.03)},
    "ball": {"type": mujoco.mjtGeom.mjGEOM_SPHERE, "size": (0.05, 0, 0)},
    "cylinder": {"type": mujoco.mjtGeom.mjGEOM_CYLINDER, "size": (0.015, 0.03, 0), "euler": (90, 0, 0)},
}
HEIGHT = {"box": 0.03, "ball": 0.05, "cylinder": 0.015}


@cache
def pad(frames: int = 5, glued: bool = True) -> mf.SoftBody:
    labels = np.ones((20, 20, 5), np.uint8)
    held = np.zeros(labels.shape, bool)
    held[:, :, 0] = True
    volume = mf.Volume.from_labels(labels, SPACING, {1: mf.Material(YOUNG, POISSON, 1000)}, origin=(0, 0, -SPACING))
    return mf.build(volume, frames, supports=mf.Fixed(held) if glued else (), damping=(0, 0.02))


def grid(taxel: float = 0.005, shape: tuple[int, int] = (16, 16), center: tuple[float, ...] = TOP) -> mf.TaxelGrid:
    return mf.TaxelGrid(center, (0, 0, 1), (shape[0] * taxel, shape[1] * taxel), shape, along=(1, 0, 0))


def feeling(body: mf.SoftBody, own: mf.TaxelGrid, contact: mf.Contact, gravity: bool = False) -> mujoco.MjSpec:
    """A pad with every quantity of the taxels; elliptic cones where contacts make dents, else pyramidal ones."""
    spec = mujoco.MjSpec()
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC if contact.dents else mujoco.mjtCone.mjCONE_PYRAMIDAL
    spec.option.gravity = (0, 0, -9.81 if gravity else 0)
    mf.attach(spec, body, "pad", contact=contact)
    for quantity in taxels.QUANTITIES:
        mf.add_taxels(spec, body, "pad", own, quantity)
    mf.add_sensor(spec, body, "pad", "contact_force")
    return spec


def pressed(
    shape: str, force: float, dents: bool, own: mf.TaxelGrid, frames: int = 5, at: tuple[float, float] = TOP[:2]
) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """A pad under something that a force presses down [N]."""
    spec = feeling(pad(frames), own, mf.Contact(dents=dents))
    body = spec.worldbody.add_body(name="object", pos=(*at, THICK + HEIGHT[shape] + 0.0003))
    body.add_joint(name="down", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=(0, 0, -1))
    body.add_joint(name="along", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=(1, 0, 0), damping=20)
    body.add_joint(name="turn", type=mujoco.mjtJoint.mjJNT_HINGE, axis=(0, 0, 1), damping=0.02)
    body.add_geom(mass=0.1, **SHAPES[shape])
    model = spec.compile()
    data = mujoco.MjData(model)
    for step in range(500):
        data.joint("down").qfrc_applied = force * min(1, step / 250)
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    return model, data


def read(data: mujoco.MjData, quantity: str) -> NDArray[np.float64]:
    values = data.sensor(f"pad_{quantity}").data
    return values.reshape(-1, taxels.QUANTITIES[quantity].values)


@pytest.mark.parametrize("dents", [False, True])
@pytest.mark.parametrize("shape", SHAPES)
def test_the_forces_of_the_taxels_sum_to_those_of_the_contacts(shape: str, dents: bool) -> None:
    model, data = pressed(shape, 10.0, dents, grid(0.006))
    data.joint("along").qfrc_applied, data.joint("turn").qfrc_applied = 2.0, 0.005
    for _ in range(30):
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    total = data.sensor("pad_contact_force").data
    assert abs(total[0]) > 0.5 < abs(total[2])
    np.testing.assert_allclose(read(data, "taxel_force").sum(axis=0), total, atol=1e-10)
    np.testing.assert_allclose(read(data, "resultant")[0], total, atol=1e-10)
    traction, area = read(data, "traction"), 0.006**2
    np.testing.assert_array_equal(traction[:, 0], read(data, "pressure")[:, 0])
    assert traction[:, 0].sum() * area == pytest.approx(-total[2], rel=0.02)
    assert traction[:, 1].sum() * area == pytest.approx(total[0], rel=0.1)


@pytest.fixture(scope="module")
def exact() -> dict[str, tuple[float, float, NDArray[np.float64]]]:
    """Of finite elements: the width of a taxel [m], an eighth of what touches, the force, the pressure on 16 × 16."""
    found = {}
    for shape, taxel, edge in (("box", 0.005, 0.02), ("ball", 0.0025, np.inf)):
        place, force = pressed_slab(
            [NEAR_MIDDLE, NEAR_MIDDLE, UPWARDS],
            YOUNG,
            POISSON,
            (lambda x, y: np.where(np.maximum(x, y) < 0.02 + 1e-9, 1e-3, -1))
            if shape == "box"
            else (lambda x, y: 2e-3 - (x**2 + y**2) / 0.1),
        )
        found[shape] = (taxel, 4 * force.sum(), on_squares(place, force, taxel, 16, edge))
    return found


@pytest.mark.slow
@pytest.mark.parametrize("frames", [1, 5, 10])
@pytest.mark.parametrize("dents", [True, False])
@pytest.mark.parametrize("shape", ["box", "ball"])
def test_pressures_are_those_of_finite_elements(
    frames: int, dents: bool, shape: str, exact: dict[str, tuple[float, float, NDArray[np.float64]]]
) -> None:
    taxel, force, expected = exact[shape]
    _, data = pressed(shape, force, dents, grid(taxel), frames)
    found = read(data, "pressure").reshape(16, 16)
    error = np.linalg.norm(found - expected) / np.linalg.norm(expected)
    assert error < {"box": 0.08, "ball": 0.11 if dents else 0.3}[shape]
    assert read(data, "resultant")[0, 2] == pytest.approx(-force, rel=0.02)
    across = 2 * np.sqrt((expected > 0.1 * expected.max()).sum() / np.pi) * taxel
    away = read(data, "pressure_centre")[0, :2] - TOP[:2]
    # without dents the pressure is that of the frames alone
    assert np.linalg.norm(away) < (0.02 if dents else 0.1) * across


def test_the_forces_of_a_soft_body_on_a_soft_body_sum_to_its_contacts() -> None:
    spec = feeling(pad(), grid(0.006), mf.Contact(), gravity=True)
    volume = mf.Volume.box((0.04, 0.04, 0.03), mf.Material(YOUNG, POISSON, 1000), spacing=0.01)
    mf.attach(spec, mf.build(volume, 1, damping=(2, 0.01)), "block", pos=(*TOP[:2], THICK + 0.016))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=500)
    mujoco.mj_forward(model, data)
    total = data.sensor("pad_contact_force").data
    assert total[2] == pytest.approx(-9.81 * model.body("block").subtreemass[0], rel=0.02)
    np.testing.assert_allclose(read(data, "taxel_force").sum(axis=0), total, atol=1e-10)
    np.testing.assert_allclose(read(data, "pressure_centre")[0], TOP, atol=0.003)


@pytest.mark.parametrize("dents", [False, True])
def test_the_centre_of_pressure_is_where_a_ball_presses(dents: bool) -> None:
    _, data = pressed("ball", 4.0, dents, grid(), at=(0.065, 0.04))
    np.testing.assert_allclose(read(data, "pressure_centre")[0, :2], (0.065, 0.04), atol=5e-4)


def test_something_that_turns_twists_the_shear() -> None:
    model, data = pressed("box", 10.0, True, grid())
    data.joint("turn").qfrc_applied = 0.06
    mujoco.mj_step(model, data, nstep=5)
    mujoco.mj_forward(model, data)
    place = grid().points - data.body("object").xpos
    force = read(data, "taxel_force")
    torque = np.cross(place, force)[:, 2].sum()
    contacts, wrench = 0.0, np.zeros(6)
    for number, contact in enumerate(data.contact):
        mujoco.mj_contactForce(model, data, number, wrench)
        sign = -1 if model.geom_bodyid[contact.geom[1]] == model.body("object").id else 1
        on_pad = sign * wrench[:3] @ contact.frame.reshape(3, 3)
        contacts += np.cross(contact.pos - data.body("object").xpos, on_pad)[2]
    assert contacts > 0.02
    assert torque == pytest.approx(contacts, rel=0.1)


@pytest.mark.parametrize(("shape", "taxel"), [pytest.param("ball", 0.0025, marks=pytest.mark.slow), ("box", 0.005)])
def test_a_part_of_a_map_feels_what_the_whole_feels_there(shape: str, taxel: float) -> None:
    def pressures(rows: int, columns: int, towards_x: float = 0, size: float = taxel) -> NDArray[np.float64]:
        own = grid(size, (rows, columns), (TOP[0] + towards_x, *TOP[1:]))
        return read(pressed(shape, 10.0, True, own)[1], "pressure").reshape(rows, columns)

    whole = pressures(16, 16)
    for found, expected in ((pressures(8, 16, -4 * taxel), whole[:8]), (pressures(4, 4), whole[6:10, 6:10])):
        assert np.linalg.norm(found - expected) < 0.06 * np.linalg.norm(expected)
    if shape == "ball":
        assert pressures(1, 1, size=0.0004)[0, 0] == pytest.approx(whole[7:9, 7:9].mean(), rel=0.1)


@pytest.mark.slow
def test_what_presses_beside_the_taxels_is_left_out() -> None:
    half = [pressed("box", 10.0, False, grid(0.005, (8, 8), (x, 0.05, THICK)))[1] for x in (0.03, 0.05, 0.07)]
    share = [-float(read(data, "resultant")[0, 2] / 10) for data in half]
    assert share[1] == pytest.approx(1, abs=0.01)
    assert 0.38 < share[0] < 0.62 > share[2] > 0.38
    _, data = pressed("ball", 4.0, False, grid(0.0025, (4, 4), (0.01, 0.01, THICK)))
    assert not read(data, "taxel_force").any()
    np.testing.assert_allclose(read(data, "pressure_centre")[0], (0.01, 0.01, THICK), atol=1e-4)


def test_markers_say_where_the_material_moves_whatever_it_hangs_on() -> None:
    own = mf.TaxelGrid(TOP, (0, 0, 1), (0.06, 0.04), (7, 9), along=(0, 1, 0))
    spec = mujoco.MjSpec()
    spec.option.gravity = (0, 0, 0)
    hand = spec.worldbody.add_body(name="hand", pos=(0.3, 0, 0), quat=(0.9, 0.3, -0.2, 0.25))
    hand.add_freejoint()
    hand.add_geom(size=(0.01, 0, 0), mass=0.1, contype=0)
    mf.attach(spec, pad(), "pad", "hand")
    mf.add_taxels(spec, pad(), "pad", own, "markers")
    mf.add_sensor(spec, pad(), "pad", "position", own.points)
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qvel[:] = np.random.default_rng(0).normal(size=model.nv)
    mujoco.mj_step(model, data, nstep=3)
    mujoco.mj_forward(model, data)
    turn = data.body("hand").xmat.reshape(3, 3)
    seen = (data.sensor("pad_position").data.reshape(-1, 3) - data.body("hand").xpos) @ turn - own.points
    expected = np.stack([seen[:, 1], -seen[:, 0], seen[:, 2]], axis=1)
    assert np.abs(expected).max() > 1e-5
    np.testing.assert_allclose(data.sensor("pad_markers").data.reshape(-1, 3), expected, atol=1e-9)


def test_taxels_lie_on_a_curved_surface_and_feel_across_it() -> None:
    """Three balls around a soft ball: their forces are along the surface's normals."""
    volume = mf.Volume.sphere(0.03, mf.Material(YOUNG, POISSON, 1000), spacing=0.003)
    inside = np.linalg.norm(np.stack(np.meshgrid(*[np.arange(n) - n / 2 + 0.5 for n in volume.labels.shape])), axis=0)
    body = mf.build(volume, 4, supports=mf.Fixed((volume.labels > 0) & (inside < 3)), damping=(0, 0.02))
    spec = mujoco.MjSpec()
    spec.option.gravity = (0, 0, 0)
    mf.attach(spec, body, "ball")
    own = mf.TaxelGrid((0, 0, 0), (0, 0, 1), (0.045, 0.045), (16, 16))
    for quantity in ("traction", "taxel_force"):
        mf.add_taxels(spec, body, "ball", own, quantity)
    mf.add_sensor(spec, body, "ball", "contact_force")
    way = np.array([0.5, 0, 1]) / np.sqrt(1.25)
    pusher = spec.worldbody.add_body(name="pusher", pos=0.041 * way)
    pusher.add_joint(name="push", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=-way)
    pusher.add_geom(size=(0.01, 0, 0), mass=0.05)
    model = spec.compile()
    data = mujoco.MjData(model)
    data.joint("push").qfrc_applied = 1.0
    mujoco.mj_step(model, data, nstep=500)
    mujoco.mj_forward(model, data)
    total = data.sensor("ball_contact_force").data
    np.testing.assert_allclose(data.sensor("ball_taxel_force").data.reshape(-1, 3).sum(axis=0), total, atol=1e-10)
    traction = data.sensor("ball_traction").data.reshape(16, 16, 3)
    assert np.abs(traction[..., 1:]).max() < 0.2 * traction[..., 0].max()
    row, column = np.unravel_index(traction[..., 0].argmax(), (16, 16))
    middle = own.points.reshape(16, 16, 3)[row, column]
    np.testing.assert_allclose(middle[:2], 0.03 * way[:2], atol=0.004)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"center": (0, 0)}, r"center is \(0, 0\); give 3 finite numbers"),
        ({"normal": (0, 0, 0)}, "give a direction that is not zero"),
        ({"size": (0.1, -0.1)}, "give a height and a width > 0"),
        ({"shape": (0, 4)}, "give two whole numbers ≥ 1"),
        ({"shape": (4.0, 4)}, "give two whole numbers ≥ 1"),
        ({"shape": (1000, 1000)}, "10000 taxels at most"),
        ({"along": (0, 0, 2)}, "give a direction .* that is not along the normal"),
    ],
)
def test_grids_that_cannot_be_are_refused(change: dict, words: str) -> None:
    arguments = {"center": TOP, "normal": (0, 0, 1), "size": (0.1, 0.1), "shape": (4, 4), **change}
    with pytest.raises(MjframesError, match=words):
        mf.TaxelGrid(**arguments)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("pad", grid(), "colour"), "quantity is 'colour'; it must be one of 'pressure'"),
        (("fish", grid()), "name is 'fish' but the spec's soft bodies are: 'pad'"),
        (("pad", [[0, 0, 0]]), "grid is a list; give a TaxelGrid"),
        (("pad", grid(0.02)), r"the grid's taxel \(0, 0\) is beside the soft body"),
        (("pad", grid(), "pressure"), "sensor_name is 'pad_pressure', which the spec has already"),
    ],
)
def test_taxels_that_cannot_be_are_refused(arguments: tuple, words: str) -> None:
    with pytest.raises(MjframesError, match=words):
        mf.add_taxels(feeling(pad(), grid(), mf.Contact()), pad(), *arguments)


def test_taxels_need_contact_and_flesh() -> None:
    spec = mujoco.MjSpec()
    mf.attach(spec, pad(), "pad", contact=False)
    mf.add_taxels(spec, pad(), "pad", grid(), "markers")
    with pytest.raises(MjframesError, match="'pad' has no contact; attach it with contact=True"):
        mf.add_taxels(spec, pad(), "pad", grid())
    bone = mf.Material(1e12, 0.3, 1000)
    labels = np.ones((8, 8, 4), int)
    labels[..., 2:] = 2
    volume = mf.Volume.from_labels(labels, 0.01, {1: mf.Material(YOUNG, POISSON, 1000), 2: bone})
    body = mf.build(volume, 2)
    mf.attach(spec, body, "hard")
    with pytest.raises(MjframesError, match="the soft body is rigid where the grid is"):
        mf.add_taxels(spec, body, "hard", mf.TaxelGrid((0.04, 0.04, 0.04), (0, 0, 1), (0.02, 0.02), (4, 4)))


def test_of_point_frames_there_are_markers_only() -> None:
    body = mf.build(
        mf.Volume.box((0.04, 0.04, 0.02), mf.Material(YOUNG, POISSON, 1000), spacing=0.005), 2, frame_type="point"
    )
    spec, small = mujoco.MjSpec(), mf.TaxelGrid((0, 0, 0.01), (0, 0, 1), (0.02, 0.02), (4, 4))
    mf.attach(spec, body, "pad")
    mf.add_taxels(spec, body, "pad", small, "markers")
    with pytest.raises(MjframesError, match="'pad' has frames of the type 'point'"):
        mf.add_taxels(spec, body, "pad", small)
    spec.compile()


def test_what_tumbles_on_a_pad_presses_and_never_pulls() -> None:
    """Objects that hit it with edges and corners made NaN and pressures below zero."""
    spec = feeling(pad(), grid(), mf.Contact(), gravity=True)
    tumbling = spec.worldbody.add_body(pos=[0, 0, 0])
    joint = tumbling.add_freejoint(name="tumbling")
    tumbling.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.006, 0.008, 0.01], mass=0.02)
    model = spec.compile()
    data, rng, touched = mujoco.MjData(model), np.random.default_rng(0), 0
    for _ in range(20):
        mujoco.mj_resetData(model, data)
        data.joint(joint.name).qpos[:] = [
            *(TOP + rng.uniform(-0.01, 0.01, 3) * (1, 1, 0) + (0, 0, 0.015)),
            *rng.normal(size=4),
        ]
        for _ in range(100):
            mujoco.mj_step(model, data)
            pressure = data.sensor("pad_pressure").data
            touched += pressure.max() > 0
            assert pressure.min() >= 0
    assert touched > 200


@pytest.mark.parametrize(
    ("quantity", "change", "words"),
    [
        ("pressure", {"area": ""}, "area is not an array of type f64"),
        ("pressure", {"along": "f64:1:AAAAAAAAAAA="}, "its taxels are not those of the soft body"),
        ("traction", {"kernel_step": "0"}, "its taxels are not those of the soft body"),
        ("traction", {"softness": "soft"}, "softness is 'soft' but has to be a number"),
        ("resultant", {"vertex": "i32:1://///w=="}, "its taxels are not those of the soft body"),
        ("markers", {"axes": "f64:0:"}, "its markers are not those of the soft body"),
        ("markers", {"quantity": "pressure"}, "the quantities of taxels are of the plugin mjframes.force_sensor"),
    ],
)
def test_damaged_taxels_are_refused(quantity: str, change: dict[str, str], words: str) -> None:
    spec = feeling(pad(), grid(), mf.Contact())
    instance = next(other for other in spec.plugins if other.name == f"pad_{quantity}")
    instance.config = dict(instance.config) | change
    with pytest.raises(ValueError, match=words):
        spec.compile()


def test_copies_and_saved_scenes_feel_the_same(tmp_path) -> None:
    model, data = pressed("ball", 4.0, True, grid())
    path = tmp_path / "scene.mjb"
    mujoco.mj_saveModel(model, str(path))
    other = mujoco.MjModel.from_binary_path(str(path))
    again = mujoco.MjData(other)
    kind = mujoco.mjtState.mjSTATE_INTEGRATION
    state = np.zeros(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, state, kind)
    mujoco.mj_setState(other, again, state, kind)
    mujoco.mj_forward(model, data)
    mujoco.mj_forward(other, again)
    np.testing.assert_array_equal(again.sensordata, data.sensordata)


def test_too_little_memory_is_told_and_the_sum_stays() -> None:
    spec = feeling(pad(), grid(), mf.Contact())
    spec.memory = 120_000
    spec.option.jacobian = mujoco.mjtJacobian.mjJAC_SPARSE  # dense ones need more
    body = spec.worldbody.add_body(name="object", pos=(*TOP[:2], THICK + 0.0299))
    body.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=(0, 0, -1))
    body.add_geom(mass=0.1, **SHAPES["box"])
    data = mujoco.MjData(spec.compile())
    with mujoco_warnings() as told:
        for _ in range(3):
            mujoco.mj_forward(data.model, data)
    assert [words for words in told if "too small for taxels" in words]
    total = data.sensor("pad_contact_force").data
    assert abs(total[2]) > 0
    np.testing.assert_allclose(read(data, "resultant")[0], total, atol=1e-10)


@pytest.mark.parametrize(
    ("dents", "offset"),
    [
        pytest.param(False, 0.0, marks=pytest.mark.slow),
        (False, 0.005),
        (True, 0.0),
        pytest.param(True, 0.005, marks=pytest.mark.slow),
    ],
)
def test_what_lies_freely_presses_below_its_centre_of_mass(dents: bool, offset: float) -> None:
    spec = feeling(pad(), grid(), mf.Contact(dents=dents), gravity=True)
    body = spec.worldbody.add_body(name="object", pos=(*TOP[:2], THICK + 0.02), explicitinertial=True)
    body.add_freejoint()
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=(0.02, 0.02, 0.02))
    body.mass, body.ipos, body.inertia = 0.2, (offset, 0, 0), [4e-5] * 3
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=1500)
    mujoco.mj_forward(model, data)
    assert read(data, "resultant")[0, 2] == pytest.approx(-0.2 * 9.81, rel=0.01)
    away = read(data, "pressure_centre")[0] - data.body("object").xipos
    assert np.linalg.norm(away[:2]) < 1.1e-3  # [m], of the 40 mm of the box


def test_a_light_block_that_lies_flat_presses_evenly() -> None:
    """But for its edge."""
    volume = mf.Volume.box((0.04, 0.04, 0.02), mf.Material(YOUNG, 0.4, 1000), spacing=0.005)
    body = mf.build(volume, 3, damping=(2, 0.01))
    spec = mujoco.MjSpec.from_string("<mujoco><worldbody><geom type='plane' size='1 1 .1'/></worldbody></mujoco>")
    mf.attach(spec, body, "pad", pos=(0, 0, 0.0105))
    mf.add_taxels(spec, body, "pad", mf.TaxelGrid((0, 0, 0), (0, 0, -1), (0.04 - 1e-6, 0.04 - 1e-6), (8, 8)))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=1500)
    pressure = read(data, "pressure").reshape(8, 8)
    assert 0.005**2 * pressure.sum() == pytest.approx(9.81 * model.body("pad").subtreemass[0], rel=1e-3)
    assert np.ptp(pressure[1:-1, 1:-1]) < 0.15 * pressure.mean()


def test_what_sleeps_feels_what_it_felt_last() -> None:
    spec = feeling(pad(3, glued=False), grid(0.01, (4, 4), (*TOP[:2], -SPACING)), mf.Contact(), gravity=True)
    spec.option.enableflags |= mujoco.mjtEnableBit.mjENBL_SLEEP
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=(1, 1, 1), pos=(0, 0, -SPACING))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 2000)
    assert data.ntree_awake == 0
    weight = 9.81 * model.body_mass.sum()
    assert data.sensor("pad_contact_force").data[2] == pytest.approx(weight, rel=0.01)
