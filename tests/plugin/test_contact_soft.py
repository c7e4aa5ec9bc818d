"""Soft bodies against each other: rows, momentum, stacks; friction; what `Contact` sets."""

from __future__ import annotations

from functools import cache

import mujoco
import numpy as np
import pytest
from builders.deformed import Deformed, fitted_slopes
from builders.scenes import (
    FLOOR,
    TILTED,
    beam,
    compiled,
    dense_constraints,
    distorted,
    dofs,
    move_points,
    point_jacobian,
)
from builders.stacked import block

from mjframes.base.errors import MjframesError
from mjframes.body.build import build
from mjframes.body.soft_body import SoftBody
from mjframes.scene.attach import attach
from mjframes.scene.contact import Contact
from mjframes.scene.load import mujoco_warnings
from mjframes.scene.view import soft, soft_names
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

SPACE = '<mujoco><option gravity="0 0 0"/></mujoco>'
WEIGHTLESS = '<mujoco><option gravity="0 0 0" cone="{}" jacobian="{}"/></mujoco>'


def set_speeds(model: mujoco.MjModel, data: mujoco.MjData, name: str, velocity: np.ndarray, spin: np.ndarray) -> None:
    """Of a soft body as if it was rigid: of its middle [m/s] and about it [rad/s]."""
    view = soft(model, data, name)
    x = view.control_positions
    speed = velocity + np.cross(spin, x - x.mean(axis=0))
    jacobian = point_jacobian(model, data, view)[:, dofs(model, view).ravel()]
    data.qvel[dofs(model, view).ravel()] = np.linalg.solve(jacobian, speed.ravel())


def momenta(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """(6,) linear [kg m/s] and angular [kg m²/s] momentum of all soft bodies."""
    total = np.zeros(6)
    for name in soft_names(model):
        view = soft(model, data, name)
        total += np.concatenate([view.linear_momentum, view.angular_momentum])
    return total


@pytest.mark.parametrize("jacobian", ["dense", "sparse"])
@pytest.mark.parametrize("cone", ["elliptic", "pyramidal"])
@pytest.mark.parametrize("condim", [1, 3, 4, 6])
def test_rows_are_the_relative_velocity_of_the_two_material_points(cone: str, jacobian: str, condim: int) -> None:
    """A row is the rate of t · (p₁ − p₀), p₀ and p₁ the material points of the two bodies at one place."""
    model, data = compiled(
        WEIGHTLESS.format(cone, jacobian),
        (beam(), (0, 0, 0), (1, 0, 0, 0)),
        (beam(), (0.05, 0.02, 0.1), TILTED),
        contact=Contact(condim=condim, friction=(0.8, 0.02, 0.01)),
    )
    rng = np.random.default_rng(1)
    mujoco.mj_kinematics(model, data)
    views = [soft(model, data, name) for name in soft_names(model)]
    shapes = [distorted(view.control_positions, rng, 0.05) for view in views]
    shapes = [shape - shape.mean(axis=0) for shape in shapes]
    for height in np.arange(0.1, 0, -0.001):
        for view, shape, z in zip(views, shapes, (0, height), strict=True):
            move_points(model, data, view, shape + np.array([0, 0, z]))
        mujoco.mj_forward(model, data)
        if data.ncon >= 3:
            break
    assert data.ncon >= 3
    assert {int(contact.dim) for contact in data.contact} == {condim}
    jacobians = [point_jacobian(model, data, view).reshape(-1, 3, model.nv) for view in views]
    rows = dense_constraints(model, data)
    data.qvel[:] = rng.normal(size=model.nv)
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.efc_vel, rows @ data.qvel, atol=1e-12)
    explained = 0
    for contact in data.contact:
        frame = contact.frame.reshape(3, 3)
        start = contact.efc_address
        normal = rows[start] if cone == "elliptic" or condim == 1 else (rows[start] + rows[start + 1]) / 2
        # the touching vertices are the contact's weights on their body, of the geom on the deeper side
        weight = []
        for side, view in enumerate(views):
            columns = dofs(model, view).ravel()
            local = np.einsum("c,kcn->kn", frame[0], jacobians[side])[:, columns]
            found = np.linalg.lstsq(local.T, (1 if side else -1) * normal[columns], rcond=None)[0]
            np.testing.assert_allclose(local.T @ found, (1 if side else -1) * normal[columns], atol=1e-8)
            weight.append(found)
            assert found.sum() == pytest.approx(1, abs=1e-8)
        places = [w @ view.control_positions for w, view in zip(weight, views, strict=True)]
        np.testing.assert_allclose(places[0], places[1], atol=1e-8)  # both sides feel the force at one place
        tangents = 3 if condim > 1 else 1
        for axis in range(tangents):
            wanted = sum(
                (1 if side else -1) * np.einsum("c,k,kcn->n", frame[axis], weight[side], jacobians[side])
                for side in range(2)
            )
            if cone == "elliptic" or condim == 1:
                row = rows[start + axis]
            elif axis:
                row = (rows[start + 2 * axis - 2] - rows[start + 2 * axis - 1]) / (2 * contact.friction[axis - 1])
            else:
                row = normal
            np.testing.assert_allclose(row, wanted, atol=1e-8)
        if condim > 3 and cone == "elliptic":
            spin = np.zeros((3, model.nv))
            for side, view in enumerate(views):
                slopes = fitted_slopes(weight[side], view.control_positions)
                for slope, point in zip(slopes, jacobians[side], strict=True):
                    spin += (0.5 if side else -0.5) * np.cross(slope, point, axisb=0, axisc=0)
            np.testing.assert_allclose(rows[start + 3 : start + condim], (frame @ spin)[: condim - 3], atol=1e-8)
        # one of the two is where the other body's deformed lattice has that point
        for side, view in enumerate(views):
            owner = int(model.geom_bodyid[contact.geom[side]])
            material = Deformed(model, view, owner).weights(places[0])
            explained += np.abs(material - weight[side]).max() < 1e-3
    assert explained >= data.ncon


@pytest.mark.parametrize("condim", [3, 6])
def test_a_collision_in_free_flight_makes_no_momentum(condim: int) -> None:
    model, data = compiled(
        WEIGHTLESS.format("pyramidal", "dense"),
        (block((6, 6, 6), 0.01, 1000), (0, 0, 0), (1, 0, 0, 0)),
        (block((6, 6, 6), 0.01, 300), (-0.02, 0.02, 0.09), TILTED),
        timestep=0.002,
        contact=Contact(condim=condim, friction=(1, 0.02, 0.01)),
    )
    mujoco.mj_forward(model, data)
    set_speeds(model, data, "soft0", np.array([0.05, 0, 0.3]), np.array([1.0, 0.5, -0.4]))
    set_speeds(model, data, "soft1", np.array([0.0, 0, -0.5]), np.array([0.0, -0.5, 2.0]))
    mujoco.mj_forward(model, data)
    before, touched = momenta(model, data), 0
    for _ in range(300):
        mujoco.mj_step(model, data)
        touched = max(touched, data.ncon)
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(momenta(model, data), before, atol=1e-10)
    assert touched >= 2
    x = [soft(model, data, name).control_positions.mean(axis=0) for name in soft_names(model)]
    assert np.linalg.norm(x[1] - x[0]) > 0.08  # they bounced off each other


@pytest.mark.parametrize("cone", ["elliptic", "pyramidal"])
def test_torsional_friction_turns_what_it_brakes(cone: str) -> None:
    """A rigid ball that spins on a soft block hands its angular momentum over. Points that slide did not feel it."""
    spinning = f'''<mujoco><option gravity="0 0 0" cone="{cone}"/><worldbody><body name="ball" pos="0 0 .0505">
      <freejoint/><geom type="sphere" size=".02" mass=".05" friction="1 .02 .001" condim="6"/></body>
      </worldbody></mujoco>'''
    model, data = compiled(spinning, (block((6, 6, 6), 0.01, 1000), (0, 0, 0), (1, 0, 0, 0)), timestep=0.001)
    ball = slice(int(model.body("ball").dofadr[0]), int(model.body("ball").dofadr[0]) + 6)
    data.qvel[ball] = 0, 0, -0.3, 0, 0, 30

    def momentum() -> np.ndarray:
        mujoco.mj_forward(model, data)
        velocity, spin = data.qvel[ball][:3], data.body("ball").xmat.reshape(3, 3) @ data.qvel[ball][3:]
        own = 0.05 * velocity, 0.4 * 0.05 * 0.02**2 * spin + 0.05 * np.cross(data.body("ball").xpos, velocity)
        return momenta(model, data) + np.concatenate(own)

    before, view = momentum(), soft(model, data, "soft0")
    for _ in range(300):
        mujoco.mj_step(model, data)
        np.testing.assert_allclose(momentum(), before, atol=1e-12)
    assert data.ncon == 0
    assert data.qvel[ball][2] > -0.05  # the block goes down faster
    assert 0.05 * before[5] < view.angular_momentum[2] < before[5]


@pytest.mark.parametrize(
    "masses",
    [pytest.param((1, 10, 100), marks=pytest.mark.slow), (100, 10, 1)],
    ids=["heavy above", "heavy below"],
)
def test_a_stack_of_three_comes_to_rest(masses: tuple[int, int, int]) -> None:
    floor = FLOOR.replace("<mujoco>", '<mujoco><option cone="elliptic" impratio="300" timestep="0.004"/>')
    bodies = [block((20, 20, 8), 0.0075, 10 * mass, 0.005) for mass in masses]
    model, data = compiled(
        floor,
        *((body, (0, 0, 0.0005 + 0.0605 * i), (1, 0, 0, 0)) for i, body in enumerate(bodies)),
        contact=Contact(solref=(0.008, 1), priority=1),
    )
    for _ in range(2500):
        mujoco.mj_step(model, data)
    speeds = [
        np.abs(point_jacobian(model, data, soft(model, data, name)) @ data.qvel).max() for name in soft_names(model)
    ]
    assert max(speeds) < 1e-5
    middle = [soft(model, data, name).control_positions[:, 2].mean() for name in soft_names(model)]
    assert np.diff(middle) == pytest.approx([0.06, 0.06], rel=0.1)


@pytest.mark.parametrize("friction", [0.3, 0.7])
def test_a_block_starts_to_slide_at_the_angle_of_friction(friction: float) -> None:
    speed = []
    for factor in (0.97, 1.01):
        angle = factor * np.arctan(friction)
        scene = FLOOR.replace("<mujoco>", '<mujoco><option cone="elliptic" impratio="10"/>')
        model, data = compiled(
            scene,
            (block((14, 14, 4), 0.01, 1000, 0.005), (0, 0, 0.0005), (1, 0, 0, 0)),
            contact=Contact(friction=(friction,), priority=1),
        )
        model.opt.gravity[:] = 9.81 * np.array([np.sin(angle), 0, -np.cos(angle)])
        for _ in range(1000):
            mujoco.mj_step(model, data)
        x = soft(model, data, "soft0").control_positions.mean(axis=0)[0]
        for _ in range(500):
            mujoco.mj_step(model, data)
        speed.append((soft(model, data, "soft0").control_positions.mean(axis=0)[0] - x) / (500 * model.opt.timestep))
    assert speed[0] < 2e-4  # MuJoCo's friction creeps
    assert speed[1] > 100 * speed[0]


def test_contact_sets_the_parameters_of_all_patches() -> None:
    contact = Contact(friction=(0.7, 0.01), margin=0.002, gap=0.001, solref=(0.01, 0.9), solimp=(0.8, 0.9), condim=4)
    model, data = compiled(FLOOR, (beam(), (0, 0, 0.1), (1, 0, 0, 0)), contact=contact)
    patches = np.flatnonzero(model.geom_plugin >= 0)
    assert len(patches) > 6
    for geom in patches:
        np.testing.assert_allclose(model.geom_friction[geom], [0.7, 0.01, 0.0001])
        assert (model.geom_margin[geom], model.geom_gap[geom]) == (0.002, 0.001)
        np.testing.assert_allclose(model.geom_solref[geom], [0.01, 0.9])
        np.testing.assert_allclose(model.geom_solimp[geom][:3], [0.8, 0.9, 0.001])
        assert model.geom_condim[geom] == 4
    mujoco.mj_forward(model, data)
    assert data.ncon == 0


def test_bits_choose_what_a_soft_body_meets() -> None:
    places = ((beam(), (0, 0, 0), (1, 0, 0, 0)), (beam(), (0.02, 0.01, 0.03), (1, 0, 0, 0)))
    met = {}
    for name, contact in {"each other": Contact(), "rigid geoms": Contact(conaffinity=0)}.items():
        model, data = compiled(WEIGHTLESS.format("pyramidal", "dense"), *places, contact=contact)
        mujoco.mj_forward(model, data)
        met[name] = data.ncon
        for c in data.contact:
            owner = model.body_plugin[model.geom_bodyid[c.geom]]
            assert owner[0] != owner[1]
    assert met["each other"] > 3
    assert met["rigid geoms"] == 0


@pytest.mark.parametrize(
    "wrong",
    [
        {"friction": (-1.0,)},
        {"solref": (0.01,)},
        {"margin": -1.0},
        {"condim": 2},
        {"contype": -1},
        {"solimp": ()},
        {"solref": (-1, 1)},
        {"solref": (0.02, 0)},
        {"solimp": (1.2, 0.9)},
        {"solimp": (0.9, 0.95, -1)},
        {"solimp": (0.9, 0.95, 0.001, 2)},
        {"solimp": (0.9, 0.95, 0.001, 0.5, 0.5)},
        {"solimp": "soft"},
        {"friction": "high"},
        {"margin": "1"},
        {"condim": True},
        {"contype": 1.5},
        {"priority": "high"},
    ],
    ids=lambda wrong: next(iter(wrong)),
)
def test_contact_refuses_what_mujoco_would_not_take(wrong: dict[str, object]) -> None:
    with pytest.raises(MjframesError, match=next(iter(wrong))):
        Contact(**wrong)  # pyright: ignore[reportArgumentType]


def test_soft_bodies_come_less_deep_into_each_other_than_by_the_solref_of_mujoco() -> None:
    """A heavy block falls 30 cm onto a light one: at most, and at rest. Without dents, which are not changed by it."""
    light, heavy = block((12, 12, 5), 0.01, 800), block((6, 6, 6), 0.01, 3000)
    deepest = {}
    for contact in (Contact(dents=False), Contact(solref=None, dents=False)):
        places = ((light, (0, 0, 0), (1, 0, 0, 0)), (heavy, (0.03, 0.03, 0.35), (1, 0, 0, 0)))
        model, data = compiled(FLOOR, *places, contact=contact, timestep=0.002)
        depths = []
        for _ in range(800):
            mujoco.mj_step(model, data)
            owner = model.body_plugin[model.geom_bodyid[data.contact.geom]]
            between = data.contact.dist[(owner >= 0).all(axis=1)]
            depths.append(max(0.0, -between.min(initial=0)))
        deepest[contact.solref] = max(depths), float(np.mean(depths[-50:]))
    ours, theirs = deepest[(0.01, 1.0)], deepest[None]
    assert ours[0] < 0.65 * theirs[0]
    assert ours[1] < 0.7 * theirs[1]


@pytest.mark.parametrize(
    ("contact", "floor", "expected"),
    [
        (Contact(), "", 0.015),  # the mean of 0.01 and MuJoCo's 0.02
        (Contact(), 'solref=".03 1" priority="1"', 0.03),
        (Contact(solref=None), "", 0.02),
        (Contact(solref=(0.03, 1)), 'solref=".03 1"', 0.03),
        (Contact(solref=(0.04, 1), priority=1), "", 0.04),
    ],
)
def test_the_solref_that_is_asked_for_counts(contact: Contact, floor: str, expected: float) -> None:
    xml = FLOOR.replace('type="plane"', f'type="plane" {floor}')
    model, data = compiled(xml, (beam(), (0, 0, -0.001), (1, 0, 0, 0)), contact=contact)
    mujoco.mj_forward(model, data)
    assert data.ncon > 3
    np.testing.assert_allclose(data.contact.solref, np.tile((expected, 1), (data.ncon, 1)))


def test_vertices_touch_a_soft_body_where_they_touch_a_rigid_one_of_its_shape() -> None:
    """A block in the upper side, one patch, of a wide one and of a box of its size."""
    volume = Volume.from_labels(np.ones((24, 24, 6), int), 0.01, {1: Material(1e5, 0.3, 1000)})
    small, wide = block((6, 6, 6), 0.01, 1000), build(volume, 1)
    box = '<geom type="box" size=".12 .12 .03"/>'
    touched = []
    for rigid, bodies in ((box, (small,)), ("", (small, wide))):
        places = []
        for body, place in zip(bodies, ((0.013, 0.007, 0.0585), (0, 0, 0)), strict=False):
            low, high = (end(body.skin.vertices, axis=0) for end in (np.min, np.max))
            places.append((body, tuple(place - (low + high) / 2), (1, 0, 0, 0)))
        scene = f'<mujoco><option gravity="0 0 0"/><worldbody>{rigid}</worldbody></mujoco>'
        model, data = compiled(scene, *places)
        mujoco.mj_forward(model, data)
        touched.append(data.contact.pos[:, :2].copy())  # the wide one's surface is not quite as high as the box
    assert len(touched[0]) > 3
    apart = np.abs(touched[0][:, None] - touched[1][None]).max(axis=2)
    assert (
        apart.min(axis=1).max() < 2e-5
    )  # weights of the lattice have 16 bits, and corners that are as deep half a share


@pytest.mark.parametrize("moves", ["soft0", "soft1"])
def test_vertices_are_looked_for_again_where_one_of_the_two_has_moved(moves: str) -> None:
    """One beam is bent step by step, the other stays: the contacts are always those that a new mjData finds."""
    model, data = compiled(
        WEIGHTLESS.format("pyramidal", "dense"),
        (beam(), (0, 0, 0), (1, 0, 0, 0)),
        (beam(), (0.02, 0.005, 0.036), (1, 0, 0, 0)),
    )
    place = model.jnt_qposadr[model.dof_jntid[dofs(model, soft(model, data, moves)).ravel()]]
    rng = np.random.default_rng(3)
    found = []
    for _ in range(5):
        data.qpos[place] += 5e-4 * rng.normal(size=len(place))
        fresh = mujoco.MjData(model)
        fresh.qpos[:] = data.qpos
        for one in (data, fresh):
            mujoco.mj_fwdPosition(model, one)
        found.append(np.array([[c.dist, *c.pos] for c in data.contact]))
        np.testing.assert_array_equal(found[-1], [[c.dist, *c.pos] for c in fresh.contact])
    assert all(len(contacts) > 0 for contacts in found)


@pytest.mark.parametrize("gap", [0.006, 0.012, 0.02])
def test_distances_are_found_beyond_what_touches(gap: float) -> None:
    """A sensor of distance may ask for more than collides: as far as the lattice goes, here two centimetres."""
    cube = build(Volume.from_labels(np.ones((10, 10, 6)), 0.01, {1: Material(2e4, 0.3, 1000)}), 2)
    model, data = compiled(
        "<mujoco/>", (cube, (0, 0, 0), (1, 0, 0, 0)), (cube, (0.003, 0.002, 0.06 + gap), (1, 0, 0, 0))
    )
    mujoco.mj_forward(model, data)
    geoms = [soft(model, data, name).patches for name in soft_names(model)]
    found = [mujoco.mj_geomDistance(model, data, i, j, 0.05, None) for i in geoms[0] for j in geoms[1]]
    assert data.ncon == 0
    assert min(found) == pytest.approx(gap, abs=1e-4)


def test_a_margin_beyond_the_body_is_refused() -> None:
    """It would throw two bodies 60 m up."""
    spec = mujoco.MjSpec.from_string(FLOOR)
    with pytest.raises(
        MjframesError, match=r"margin of the contact is 1 m, but .* is 0.085 m large: .* a few millimetres"
    ):
        attach(spec, firm(1e5), "soft", contact=Contact(margin=1))
    attach(spec, firm(1e5), "soft", contact=Contact(margin=0.01))


@pytest.mark.parametrize("cone", ["elliptic", "pyramidal"])
def test_a_friction_that_is_no_number_is_told_of_once_and_takes_the_geom_out(cone: str) -> None:
    """Set after the data was made; the floor goes on holding the body when it is a number again."""
    model, data = compiled(FLOOR, (firm(1e5), (0, 0, -0.001), (1, 0, 0, 0)))
    model.opt.cone = getattr(mujoco.mjtCone, f"mjCONE_{cone.upper()}")
    mujoco.mj_step(model, data, 5)
    assert data.ncon > 0
    friction = model.geom_friction[1:].copy()
    model.geom_friction[1:] = np.nan
    with mujoco_warnings() as warnings:
        mujoco.mj_step(model, data, 5)
    assert data.ncon == 0
    assert np.isfinite(data.qvel).all()
    assert [text.split(" that is")[0] for text in warnings] == ["mjframes: geom 1 'soft0:patch_0' has a friction"]
    model.geom_friction[1:] = friction
    mujoco.mj_step(model, data, 5)
    assert data.ncon > 0
    assert np.isfinite(data.qvel).all()


@cache
def firm(young: float) -> SoftBody:
    """A cube of 6 cm."""
    return build(Volume.from_labels(np.ones((6, 6, 6), int), 0.01, {1: Material(young, 0.3, 1000)}), 3)


@pytest.mark.parametrize("young", [1e5, 1e6])
@pytest.mark.parametrize("apart", [(0.03, 0.0, 0.0), (0.03, 0.004, 0.002)])
def test_bodies_that_overlap_by_half_come_apart(young: float, apart: tuple[float, ...]) -> None:
    """The surface nearest to a vertex beyond the middle is the far one, and to leave there means to go on inwards."""
    model, data = compiled(SPACE, (firm(young), (0, 0, 0), (1, 0, 0, 0)), (firm(young), apart, (1, 0, 0, 0)))
    mujoco.mj_step(model, data, 400)
    assert data.ncon == 0
    views = [soft(model, data, name) for name in soft_names(model)]
    far = np.subtract(*(view.mass @ view.control_positions / view.mass.sum() for view in views))
    assert np.linalg.norm(far) > 0.06
