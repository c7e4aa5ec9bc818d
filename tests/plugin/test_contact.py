"""Contacts of patches: where they are, and that their rows are the velocity of the material point that touches."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import mujoco
import numpy as np
import pytest
from builders.deformed import Deformed, fitted_slopes
from builders.scenes import (
    TILTED,
    beam,
    compiled,
    dense_constraints,
    dense_inertia,
    distorted,
    jumble,
    lump,
    move_points,
)
from builders.solids import HEIGHT_FIELD, MESH, polyhedron_distance, terrain_distance
from builders.tiers import tiered
from scipy.optimize import brentq

from mjframes.body.build import build
from mjframes.body.soft_body import SoftBody
from mjframes.frames.supports import Attached
from mjframes.scene.attach import attach
from mjframes.scene.contact import Contact
from mjframes.scene.plugin_text import decode
from mjframes.scene.view import Soft, soft
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

# A soft body on an arm comes down on the obstacle.
SCENE = """
<mujoco>
  <compiler angle="degree"/>
  <option gravity="0 0 0" cone="{cone}" jacobian="{jacobian}"/>
  {extension}
  <worldbody>
    <body name="arm"><joint axis="0 1 1" pos="0 0 .5"/><inertial pos="0 0 0" mass="1" diaginertia=".1 .1 .1"/></body>
    <body name="obstacle" euler="20 50 10">
      {joint}<inertial pos="0 0 0" mass="1" diaginertia=".01 .01 .01"/>
      <geom name="obstacle" friction="1.3 .02 .01" {geom}/>
    </body>
  </worldbody>
</mujoco>
"""
TORUS = """
  <extension>
    <plugin plugin="mujoco.sdf.torus">
      <instance name="ring"><config key="radius1" value="0.06"/><config key="radius2" value="0.03"/></instance>
    </plugin>
  </extension>
  <asset><mesh name="ring"><plugin instance="ring"/></mesh></asset>
"""


def outside(excess: np.ndarray) -> np.ndarray:
    """Distance from the excess over each bound, negative inside."""
    return np.linalg.norm(np.maximum(excess, 0), axis=-1) + np.minimum(excess.max(axis=-1), 0)


def ellipsoid(p: np.ndarray) -> np.ndarray:
    radius = np.array([0.05, 0.08, 0.03])

    def distance(q: np.ndarray) -> float:
        def excess(t: float) -> float:
            return ((radius * q / (radius**2 + t)) ** 2).sum() - 1

        low = max(radius * np.abs(q) - radius**2)
        t: float = brentq(excess, low + 1e-12, 1.0, xtol=1e-16)  # pyright: ignore[reportAssignmentType]
        return float(np.sign(t) * np.linalg.norm(q - radius**2 * q / (radius**2 + t)))

    return np.array([distance(q) for q in p.reshape(-1, 3)]).reshape(p.shape[:-1])


class Obstacle(NamedTuple):
    """geom: its attributes.  distance: signed, of points (…, 3) in the geom's axes [m]."""

    geom: str
    distance: Callable[[np.ndarray], np.ndarray]
    extension: str = ""
    joint: str = "<freejoint/>"


@cache
def mesh_vertices() -> np.ndarray:
    """(v, 3) as MuJoCo keeps them: in its own axes, in single precision."""
    xml = f'<mujoco>{MESH}<worldbody><geom type="mesh" mesh="stone"/></worldbody></mujoco>'
    return mujoco.MjModel.from_xml_string(xml).mesh_vert.astype(float)


OBSTACLES = {
    "plane": Obstacle('type="plane" size="1 1 1"', lambda p: p[..., 2], joint=""),
    "sphere": Obstacle('size=".05" condim="1"', lambda p: np.linalg.norm(p, axis=-1) - 0.05),
    "capsule": Obstacle(
        'type="capsule" size=".03 .06"',
        lambda p: np.linalg.norm(p - np.clip(p, [0, 0, -0.06], [0, 0, 0.06]), axis=-1) - 0.03,
    ),
    "ellipsoid": Obstacle('type="ellipsoid" size=".05 .08 .03" condim="4"', ellipsoid),
    "cylinder": Obstacle(
        'type="cylinder" size=".05 .04" condim="6"',
        lambda p: outside(np.stack([np.hypot(p[..., 0], p[..., 1]) - 0.05, np.abs(p[..., 2]) - 0.04], axis=-1)),
    ),
    "box": Obstacle('type="box" size=".05 .06 .03" margin=".004"', lambda p: outside(np.abs(p) - [0.05, 0.06, 0.03])),
    "mesh": Obstacle('type="mesh" mesh="stone"', lambda p: polyhedron_distance(p, mesh_vertices()), MESH),
    "height field": Obstacle('type="hfield" hfield="hills"', terrain_distance, HEIGHT_FIELD, joint=""),
    "torus of another plugin": Obstacle(
        'type="sdf" mesh="ring"><plugin instance="ring"/></geom><geom size=".001" contype="0" conaffinity="0"',
        lambda p: np.hypot(np.hypot(p[..., 0], p[..., 1]) - 0.06, p[..., 2]) - 0.03,
        TORUS,
    ),
}


HEIGHT_FIELDS = mujoco.mj_version() < 4_000_000


@pytest.fixture(params=tiered(OBSTACLES, lambda kind: kind == "height field"))
def obstacle(request: pytest.FixtureRequest) -> Obstacle:
    if request.param == "height field" and not HEIGHT_FIELDS:
        pytest.skip("this MuJoCo gives SDF geoms no contact with height fields")
    return OBSTACLES[request.param]


def touching(
    obstacle: Obstacle,
    cone: str = "elliptic",
    jacobian: str = "dense",
    depth: float = 0.0,
    dents: bool = False,
) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """A distorted beam that came down until at least three clusters touch, and by `depth` [m] more; all moving."""
    xml = SCENE.format(cone=cone, jacobian=jacobian, **obstacle._asdict())
    model, data = compiled(xml, (beam(), (0, 0, 0), (1, 0, 0, 0)), contact=Contact(dents=dents), parent="arm")
    view = soft(model, data, "soft0")
    rng = np.random.default_rng(0)
    data.joint(int(model.body("arm").jntadr[0])).qpos[:] = 0.3
    mujoco.mj_kinematics(model, data)
    shape = distorted(view.rest - view.rest.mean(axis=0), rng, 0.1)
    for height in np.arange(0.3, 0, -0.002):
        move_points(model, data, view, shape + np.array([0, 0, height]))
        mujoco.mj_forward(model, data)
        if data.ncon >= 3:
            move_points(model, data, view, shape + np.array([0, 0, height - depth]))
            break
    data.qvel[:] = rng.normal(size=model.nv)
    mujoco.mj_forward(model, data)
    assert data.ncon >= 3
    # where both are signed distance fields the obstacle comes second, everywhere else the patch
    second = {model.geom(c.geom[1]).name == "obstacle" for c in data.contact}
    assert second == {obstacle.extension == TORUS}
    return model, data


class Cluster(NamedTuple):
    """geom: of its patch.  weights: W_j(s) (s, k) of its vertices.  offset: (s, 3) beyond Σ_j W_j x_j [m].

    flat: whether its vertices have one normal.
    """

    geom: int
    weights: np.ndarray
    offset: np.ndarray
    flat: bool


def clusters(model: mujoco.MjModel, view: Soft) -> list[Cluster]:
    """All clusters of contact vertices of a soft body, read from the plugin's configuration."""
    parts = {key: decode(view.configuration[f"patch_{key}"]) for key in ("size", "clusters", "cluster_size", "point")}
    weight = decode(view.configuration["patch_weight"])
    offset = decode(view.configuration["patch_offset"]) if "patch_offset" in view.configuration else None
    normal = np.zeros((0, 3))
    if "lattice_normal" in view.configuration:
        normal = decode(view.configuration["lattice_normal"]).astype(float).reshape(-1, 3)
        normal /= np.linalg.norm(normal, axis=1)[:, None]
    found = []
    for geom, size, count in zip(view.patches, parts["size"], parts["clusters"], strict=True):
        sizes, parts["cluster_size"] = np.split(parts["cluster_size"], [count])
        points, parts["point"] = np.split(parts["point"], [size])
        block, weight = np.split(weight, [size * sizes.sum()])
        dense = np.zeros((sizes.sum(), len(view.bodies)))
        dense[:, points] = block.reshape(size, -1).T
        beyond = np.zeros((sizes.sum(), 3))
        if offset is not None:
            block, offset = np.split(offset, [3 * sizes.sum()])
            beyond = block.reshape(3, -1).T
        ends = np.cumsum(sizes)[:-1]
        own, normal = np.split(normal, [sizes.sum() * (len(normal) > 0)])
        flat = [len(own) > 0 and bool(np.linalg.norm(some.mean(axis=0)) > 0.99) for some in np.split(own, ends)]
        parted = zip(np.split(dense, ends), np.split(beyond, ends), flat, strict=True)
        found += [Cluster(int(geom), *some) for some in parted]
    assert weight.size == 0
    return found


class Touch(NamedTuple):
    """Where a cluster touches. weight: Σ_s a_s W_j(s) (k,).  centre: of pressure, half way between the surfaces [m].
    distance: [m].  lies: whether flat lies there, 0 to 1.
    """

    geom: int
    weight: np.ndarray
    centre: np.ndarray
    normal: np.ndarray
    distance: float
    lies: float


def touches(model: mujoco.MjModel, data: mujoco.MjData, obstacle: Obstacle) -> list[Touch]:
    """What the plugin has to find, in its order: shares fall to zero one reach above the deepest vertex."""
    view = soft(model, data, "soft0")
    geom = model.geom("obstacle").id
    axes, origin = data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom]
    reach = float(view.configuration["contact_reach"])
    holder = data.body("soft0").xmat.reshape(3, 3)
    found = []
    for cluster in clusters(model, view):
        vertices = cluster.weights @ view.control_positions + cluster.offset @ holder.T
        local = (vertices - origin) @ axes
        gap = obstacle.distance(local)
        # what is half as deep as the deepest bears nothing of a dent
        wide = max(reach, -0.5 * gap.min()) if "patch_dent" in view.configuration else reach
        bears = np.maximum(0, 1 - (gap - gap.min()) / wide) ** 2
        share = bears / bears.sum()
        step = 1e-6 * np.eye(3)[:, None]
        gradient = (obstacle.distance(local + step) - obstacle.distance(local - step)) / 2e-6
        normal = axes @ gradient @ share
        distance, lies = float(share @ gap), 0.0
        if cluster.flat:  # the contact goes to the corner, where the cluster begins, unless that is higher
            lies = min(1.0, 2 * float(bears.mean()))
            fall = 3 * np.linalg.norm(model.opt.gravity) * model.opt.timestep**2
            pressed = np.clip(fall, 0.02 * reach, 0.25 * reach) + 3 * max(0, -distance)
            bound, even = min(pressed, 0.25 * reach), max(0, 1 - (1 - float(np.linalg.norm(normal))) / 0.01)
            width = bound + np.clip((bears.mean() - 0.1) / 0.125, 0, 1) * even * (pressed - bound)
            higher = gap[0] - distance
            moved = np.clip((width - higher) / (2 * width), 0, 1)
            distance += width / 4 + (higher if higher < -width else -width * moved**2)
            share = (1 - moved) * share + moved * (np.arange(len(gap)) == 0)
        if distance < model.geom_margin[geom]:
            weight = share @ cluster.weights
            centre = share @ (vertices - gap[:, None] / 2 * normal / np.linalg.norm(normal))
            found.append(Touch(cluster.geom, weight, centre, normal / np.linalg.norm(normal), distance, lies))
    return found


def pairs(
    model: mujoco.MjModel, data: mujoco.MjData, expected: list[Touch]
) -> tuple[list[tuple[mujoco._structs._MjContactList, Touch]], list[mujoco._structs._MjContactList]]:
    """The contacts of vertices with what is expected of them, in their order, and those of the obstacle's features."""
    found, others, pushed_out = [], [], []
    rest = list(expected)
    for contact in data.contact:
        same = (
            i
            for i, touch in enumerate(rest)
            if touch.geom in contact.geom and abs(contact.dist - touch.distance) < 1e-8
        )
        at = next(same, None)
        if at is None:
            others.append(contact)
            continue
        found.append((contact, rest[at]))
        pushed_out += rest[:at]
        rest = rest[at + 1 :]
    # none is missing but those that would push the surface out, over an obstacle that is inside, and those of a flat
    # side along what it touches
    for touch in pushed_out + rest:
        volume = Deformed(model, soft(model, data, "soft0"), int(model.geom_bodyid[touch.geom]))
        out = volume.outward(touch.centre) @ touch.normal
        assert out > 0.5 or (touch.lies > 0 and abs(out) < 0.3)
    return found, others


@pytest.mark.parametrize("depth", [0.0, 0.015], ids=["touching", "deep inside"])
def test_contacts_are_the_pressure_centres_of_the_clusters(obstacle: Obstacle, depth: float) -> None:
    model, data = touching(obstacle, depth=depth)
    expected = touches(model, data, obstacle)
    for contact, touch in pairs(model, data, expected)[0]:
        sign = 1 if contact.geom[1] == touch.geom else -1  # MuJoCo's normals point from the first geom to the second
        assert touch.geom in contact.geom
        assert contact.dist == pytest.approx(touch.distance, abs=1e-9)
        np.testing.assert_allclose(sign * contact.frame[:3], touch.normal, atol=1e-6)
        np.testing.assert_allclose(contact.pos, touch.centre, atol=1e-7)


@pytest.mark.parametrize("jacobian", ["dense", "sparse"])
@pytest.mark.parametrize("cone", ["elliptic", "pyramidal"])
def test_rows_are_the_velocity_of_the_material_point(obstacle: Obstacle, cone: str, jacobian: str) -> None:
    check_rows(*touching(obstacle, cone, jacobian), obstacle, cone)


@pytest.mark.parametrize("cone", ["elliptic", "pyramidal"])
def test_rows_of_contacts_that_make_dents(cone: str) -> None:
    check_rows(*touching(OBSTACLES["plane"], cone, depth=0.004, dents=True), OBSTACLES["plane"], cone)


def check_rows(model: mujoco.MjModel, data: mujoco.MjData, obstacle: Obstacle, cone: str) -> None:
    rows = dense_constraints(model, data)
    view = soft(model, data, "soft0")
    found, others = pairs(model, data, touches(model, data, obstacle))
    for contact in others:
        geom = contact.geom[0] + contact.geom[1] - model.geom("obstacle").id
        weight = Deformed(model, view, int(model.geom_bodyid[geom])).weights(contact.pos)
        found.append((contact, Touch(geom, weight, contact.pos, contact.frame[:3], contact.dist, 0)))
    position = data.qpos.copy()
    for contact, touch in found:
        slip, spin = relative_motion(model, data, contact, touch, view)
        side = 1 if contact.geom[1] == touch.geom else -1
        frame = contact.frame.reshape(3, 3)
        normal, *others = np.concatenate([frame @ slip, frame @ spin])[: contact.dim] * side
        if cone == "elliptic" or contact.dim == 1:
            wanted = [normal, *others]
        else:
            edges = zip(contact.friction, others, strict=False)
            wanted = [normal + sign * mu * other for mu, other in edges for sign in (1, -1)]
        start = contact.efc_address
        np.testing.assert_allclose(rows[start : start + len(wanted)], wanted, atol=1e-8)
    np.testing.assert_array_equal(data.qpos, position)
    np.testing.assert_allclose(data.efc_vel, rows @ data.qvel, atol=1e-12)


@pytest.mark.parametrize("jacobian", ["dense", "sparse"])
@pytest.mark.parametrize("cone", ["elliptic", "pyramidal"])
@pytest.mark.parametrize("kind", ["plane", "box", "cylinder"])
def test_rows_of_frames_that_turn_and_of_links_that_hold(kind: str, cone: str, jacobian: str) -> None:
    obstacle = OBSTACLES[kind]
    hand = '<body name="hand"><joint axis="1 0 0"/><geom size=".001" contype="0" conaffinity="0"/></body>'
    xml = SCENE.format(cone=cone, jacobian=jacobian, **obstacle._asdict())
    xml = xml.replace('<body name="obstacle"', hand + '<body name="obstacle"')
    model, data = compiled(xml, (held_bar(), (-0.12, 0, 0), TILTED), contact=Contact(dents=False), parent="arm")
    rng = np.random.default_rng(1)
    for _ in range(50):
        jumble(model, data, rng, 0.03, 0.5)
        data.qvel[:] = rng.normal(size=model.nv)
        mujoco.mj_forward(model, data)
        if data.ncon >= 3:
            break
    assert data.ncon >= 3
    check_rows(model, data, obstacle, cone)


@cache
def held_bar() -> SoftBody:
    labels = np.ones((24, 6, 6), int)
    soft_material = Material(2e4, 0.35, 1000)
    piece = np.zeros(labels.shape, bool)
    piece[:3] = True
    volume = Volume.from_labels(labels, 0.01, {1: soft_material})
    return build(volume, 4, frame_type=("point", "rigid", "affine", "rigid"), supports=[Attached("arm", piece)])


def test_what_holds_a_piece_is_not_touched() -> None:
    xml = """<mujoco><worldbody><body name="arm"><joint axis="0 1 0"/><geom size=".5" mass="1"/></body>
      </worldbody></mujoco>"""
    model, data = compiled(xml, (held_bar(), (0, 0, 0), (1, 0, 0, 0)), parent="arm")
    mujoco.mj_forward(model, data)
    assert data.ncon == 0
    model, data = compiled(xml, (lump(), (0, 0, 0), (1, 0, 0, 0)), parent="arm")
    mujoco.mj_forward(model, data)
    assert data.ncon > 0


def relative_motion(
    model: mujoco.MjModel, data: mujoco.MjData, contact: mujoco._structs._MjContactList, touch: Touch, view: Soft
) -> tuple[np.ndarray, np.ndarray]:
    """∂/∂q̇ (3, nv) of the soft point's velocity relative to the obstacle's, and of the relative spin."""
    obstacle, owner = model.body("obstacle").id, int(model.geom_bodyid[touch.geom])
    # the lever from the point of the skin to the surface turns with each body by its share
    turn = data.xmat[view.bodies].reshape(-1, 3, 3)
    lever = view.offset + np.einsum("kba,b->ka", turn, contact.pos - touch.weight @ view.control_positions)
    spot = data.xmat[obstacle].reshape(3, 3).T @ (contact.pos - data.xpos[obstacle])
    moved, slip, step = mujoco.MjData(model), np.zeros((3, model.nv)), 1e-6
    for dof, direction in enumerate(np.eye(model.nv)):
        gap = []
        for sign in (1, -1):
            moved.qpos[:] = data.qpos
            mujoco.mj_integratePos(model, moved.qpos, direction, sign * step)
            mujoco.mj_kinematics(model, moved)
            turn = moved.xmat[view.bodies].reshape(-1, 3, 3)
            point = touch.weight @ (moved.xpos[view.bodies] + np.einsum("kab,kb->ka", turn, lever))
            gap.append(point - moved.xpos[obstacle] - moved.xmat[obstacle].reshape(3, 3) @ spot)
        slip[:, dof] = (gap[0] - gap[1]) / (2 * step)
    spins = np.zeros((2, 3, model.nv))
    mujoco.mj_jacBody(model, data, None, spins[0], owner)
    mujoco.mj_jacBody(model, data, None, spins[1], obstacle)
    joints = model.jnt_type[np.isin(model.jnt_bodyid, view.bodies)]
    if (
        contact.dim > 1 and (joints == mujoco.mjtJoint.mjJNT_SLIDE).all()
    ):  # what only slides does not turn, material does
        x, point = view.control_positions, np.zeros((3, model.nv))
        slopes, lever = fitted_slopes(touch.weight, x), contact.pos - touch.weight @ x
        own = np.isin(model.dof_bodyid, view.bodies)  # a link that holds them turns them as it is
        across = np.eye(3) - np.outer(contact.frame[:3], contact.frame[:3])
        for slope, body, place in zip(slopes, view.bodies, x, strict=True):
            mujoco.mj_jac(model, data, point, None, place, int(body))
            spins[0] += 0.5 * np.cross(slope, point, axisb=0, axisc=0) * own
            slip += (slope @ lever) * across @ point * own
    return slip, spins[0] - spins[1]


def test_impedance_is_that_of_the_effective_inertia_or_of_the_mass_where_flat_lies(obstacle: Obstacle) -> None:
    """Of cones that make no dents: those of dents are softer (dents.cc)."""
    model, data = touching(obstacle)
    rows = dense_constraints(model, data)
    inverse = np.linalg.inv(dense_inertia(model, data))
    found, others = pairs(model, data, touches(model, data, obstacle))
    mass = soft(model, data, "soft0").mass.sum()
    of_mass = 1 / mass + model.body_invweight0[model.body("obstacle").id, 0]
    for contact, lies in [(contact, touch.lies) for contact, touch in found] + [(contact, 0) for contact in others]:
        normal, impedance = rows[contact.efc_address], data.efc_KBIP[contact.efc_address, 2]
        seen = (1 - lies) * normal @ inverse @ normal + lies * of_mass
        wanted = (1 - impedance) / impedance * seen
        assert data.efc_R[contact.efc_address] == pytest.approx(wanted, rel=1e-6)
        assert data.efc_D[contact.efc_address] == pytest.approx(1 / wanted, rel=1e-6)


@pytest.mark.skipif(HEIGHT_FIELDS, reason="height fields have contacts")
def test_a_height_field_is_refused_where_mujoco_has_no_contacts_for_it() -> None:
    scene = f'<mujoco>{HEIGHT_FIELD}<worldbody><geom name="hills" type="hfield" hfield="hills"/></worldbody></mujoco>'
    spec = mujoco.MjSpec.from_string(scene)
    attach(spec, beam(), "soft0")
    with pytest.raises(ValueError, match="plugin->init failed"):
        spec.compile()
