"""Sharp and small rigid geoms against soft bodies: nothing falls between the contact vertices, nothing passes."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import trimesh
from builders.obstacles import lowest
from builders.scenes import beam, compiled
from builders.slabs import slab

from mjframes.body.build import build
from mjframes.scene.attach import attach
from mjframes.scene.contact import Contact
from mjframes.scene.view import soft
from mjframes.surface.distance_field import signed_distance
from mjframes.surface.isosurface import Surface
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

SHARP = {
    "sphere": 'size=".003"',
    "capsule": 'type="capsule" size=".002 .01" euler="0 30 0"',
    "thick capsule": 'type="capsule" size=".03 .03" euler="0 30 0"',  # its balls are above the distance field's nodes
    "ellipsoid": 'type="ellipsoid" size=".002 .003 .01"',
    "cylinder": 'type="cylinder" size=".003 .01" euler="20 10 0"',
    "box corner": 'type="box" size=".004 .004 .004" euler="45 35.26 0"',
    "box edge": 'type="box" size=".004 .03 .004" euler="0 45 0"',
    "mesh": 'type="mesh" mesh="thorn"',
}
THORN = (
    '<asset><mesh name="thorn" vertex="0 0 -.01 .003 0 .01 -.002 .003 .01 -.002 -.003 .01" inertia="convex"/></asset>'
)

MESHES = (("coarse", 0), ("fine", 3))  # subdivisions of a sphere


@pytest.mark.parametrize("shape", SHARP)
def test_features_are_caught_wherever_they_come_down(shape: str) -> None:
    scene = f"""<mujoco>{THORN}<option gravity="0 0 0"/><worldbody><body name="obstacle"><freejoint/>
      <geom name="obstacle" mass="1" {SHARP[shape]}/></body></worldbody></mujoco>"""
    model, data = compiled(scene, (slab(), (0, 0, 0), (1, 0, 0, 0)))
    rng = np.random.default_rng(0)
    place = model.joint(int(model.body("obstacle").jntadr[0])).qposadr[0]
    reach = float(soft(model, data, "soft0").configuration["contact_reach"])
    mujoco.mj_forward(model, data)
    height = data.qpos[place + 2] - lowest(model, data)
    for x, y in rng.uniform(0.05, 0.15, (40, 2)):
        # from half a millimetre deep to most of the way to the middle; the surface is bent by a fraction of a voxel
        for depth in (0.002, 0.005, 0.01, 0.015):
            data.qpos[place : place + 3] = x, y, 0.05 + height - depth
            mujoco.mj_forward(model, data)
            sign = np.array([1 if c.geom[1] == model.geom("obstacle").id else -1 for c in data.contact])
            up = np.array([c.frame[2] for c in data.contact]) * sign
            deepest = min((c.dist for c, out in zip(data.contact, up, strict=True) if out > 0.95), default=np.inf)
            assert deepest == pytest.approx(-depth, abs=0.4 * reach)  # with the way out


@pytest.mark.parametrize("speed", [1, 3, 10])
def test_a_ball_never_passes(speed: float) -> None:
    """10 g, 1 cm radius, at a time constant of two steps: MuJoCo's own 20 ms let 10 m/s sink in by 7 cm."""
    for x, y in np.random.default_rng(1).uniform(0.07, 0.13, (6, 2)):
        scene = f"""<mujoco><option timestep=".002"/><worldbody><body name="ball" pos="{x} {y} .08"><freejoint/>
          <geom name="ball" size=".01" mass=".01"/></body></worldbody></mujoco>"""
        model, data = compiled(scene, (slab(), (0, 0, 0), (1, 0, 0, 0)), contact=Contact(solref=(0.004, 1), priority=1))
        data.qvel[model.jnt_dofadr[model.body("ball").jntadr[0]] + 2] = -speed
        for _ in range(500):
            mujoco.mj_step(model, data)
            ball = data.body("ball").xpos
            if np.abs(ball[:2] - 0.1).max() > 0.09:
                break  # it rolled off
            assert ball[2] > 0.025


def test_lattice_knows_the_rest_shape() -> None:
    body = slab()
    lattice = body.distance_field
    node = np.stack(np.unravel_index(lattice.node, lattice.shape), axis=1)
    at = lattice.origin + lattice.spacing * node
    np.testing.assert_allclose(lattice.weights @ body.control.rest, at, atol=1e-12)  # at rest all is where it is
    np.testing.assert_allclose(lattice.weights.sum(axis=1), 1, atol=1e-12)
    vertices = lattice.origin + lattice.spacing * lattice.vertices
    np.testing.assert_allclose(vertices, body.contact.positions, atol=1e-12)
    surface = Surface(body.skin.vertices, body.skin.faces, body.skin.label)
    exact = signed_distance(surface, body.contact.positions, lattice.spacing)
    np.testing.assert_allclose(exact, 0, atol=1e-12)


def test_a_ball_and_its_distance() -> None:
    x = (np.indices((24, 24, 24)) - 11.5) * 0.01
    labels = (np.linalg.norm(x, axis=0) < 0.1).astype(int)
    body = build(Volume.from_labels(labels, 0.01, {1: Material(2e4, 0.3, 1000)}), 2)
    lattice = body.distance_field
    node = np.stack(np.unravel_index(lattice.node, lattice.shape), axis=1)
    distance = np.linalg.norm(lattice.origin + lattice.spacing * node - 0.12, axis=1) - 0.1
    assert np.abs(lattice.distance - distance).max() < 0.2 * 0.01


def contacts_with(model: mujoco.MjModel, data: mujoco.MjData, geom: str) -> np.ndarray:
    """Distances and places (n, 4) of a geom's contacts."""
    own = [c for c in data.contact if model.geom(geom).id in c.geom]
    return np.array(sorted([c.dist, *c.pos] for c in own))


def test_many_geoms_touch_as_each_of_them_does_alone() -> None:
    """More of them than a soft body keeps the features of."""
    names = [f"box{i}" for i in range(72)]
    places = [(0.02 + 0.02 * (i % 9), 0.02 + 0.022 * (i // 9), 0.051) for i in range(72)]
    boxes = [
        f'<geom name="{name}" type="box" size=".004 .004 .004" euler="45 35.26 {7 * i}" pos="{x} {y} {z}"/>'
        for i, (name, (x, y, z)) in enumerate(zip(names, places, strict=True))
    ]
    scene = "<mujoco><option gravity='0 0 0'/><worldbody><body><freejoint/>{}</body></worldbody></mujoco>"

    def found(some: list[str]) -> tuple[mujoco.MjModel, mujoco.MjData]:
        model, data = compiled(scene.format("".join(some)), (slab(), (0, 0, 0), (1, 0, 0, 0)))
        mujoco.mj_forward(model, data)
        return model, data

    together = found(boxes)
    for name, box in list(zip(names, boxes, strict=True))[::7]:
        alone = contacts_with(*found([box]), name)
        assert len(alone) > 0
        np.testing.assert_array_equal(contacts_with(*together, name), alone)


def test_a_mesh_of_many_vertices_touches_all_around() -> None:
    """Of more than are kept of other geoms, in each octant; all are in the body, its vertices far away."""
    ball = trimesh.creation.icosphere(3, 0.01)
    block = build(Volume.from_labels(np.ones((14, 14, 14)), 0.01, {1: Material(2e4, 0.3, 1000)}), 1)
    spec = mujoco.MjSpec()
    spec.add_mesh(name="ball", uservert=ball.vertices.ravel(), userface=ball.faces.ravel())
    middle = np.array([0.07, 0.07, 0.11])
    spec.worldbody.add_geom(name="ball", type=mujoco.mjtGeom.mjGEOM_MESH, meshname="ball", pos=middle)
    attach(spec, block, "block")
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    contacts = contacts_with(model, data, "ball")
    assert len(ball.vertices) > 600
    assert len(contacts) == 8
    quadrants, counts = np.unique(np.sign(contacts[:, 1:3] - middle[:2]), axis=0, return_counts=True)
    assert len(quadrants) == 4
    assert counts.tolist() == [2, 2, 2, 2]  # the lower one is deeper
    assert np.sort(contacts[:, 0])[4] - np.sort(contacts[:, 0])[3] > 0.005


def test_features_are_looked_for_again_where_the_soft_body_has_moved() -> None:
    """A beam falls on an edge that stays where it is: its contacts are always those that a new mjData finds."""
    edge = '<geom name="edge" type="box" size=".004 .05 .004" euler="0 45 0" pos=".1 .02 0"/>'
    model, data = compiled(f"<mujoco><worldbody>{edge}</worldbody></mujoco>", (beam(), (0, 0, 0.02), (1, 0, 0, 0)))
    touching = 0
    for _ in range(60):
        mujoco.mj_step(model, data)
        mujoco.mj_fwdPosition(model, data)
        fresh = mujoco.MjData(model)
        mujoco.mj_copyData(fresh, model, data)
        mujoco.mj_fwdPosition(model, fresh)
        touching += data.ncon > 0
        np.testing.assert_array_equal(contacts_with(model, data, "edge"), contacts_with(model, fresh, "edge"))
    assert touching > 20


@pytest.mark.parametrize("edit", ["size", "type", "mesh"])
def test_features_are_looked_for_again_where_the_geom_is_another(edit: str) -> None:
    """Nothing moves, but the model is edited: contacts are those that a new mjData finds."""
    meshes = "".join(f'<mesh name="{name}" builtin="sphere" params="{n}" scale=".01 .01 .01"/>' for name, n in MESHES)
    first = 'type="mesh" mesh="coarse"' if edit == "mesh" else 'type="box" size=".006 .006 .006"'
    geom = f'<geom name="thing" {first} pos=".07 .07 .1"/><geom type="mesh" mesh="fine" pos="0 0 9"/>'
    block = build(Volume.from_labels(np.ones((14, 14, 14)), 0.01, {1: Material(2e4, 0.3, 1000)}), 1)
    scene = f"<mujoco><asset>{meshes}</asset><worldbody>{geom}</worldbody></mujoco>"
    model, data = compiled(scene, (block, (0, 0, 0), (1, 0, 0, 0)))
    mujoco.mj_forward(model, data)
    before = contacts_with(model, data, "thing")
    if edit == "size":
        model.geom("thing").size = [0.004, 0.004, 0.004]
    elif edit == "type":
        model.geom("thing").type = mujoco.mjtGeom.mjGEOM_CYLINDER
    else:
        model.geom("thing").dataid = model.mesh("fine").id
    mujoco.mj_forward(model, data)
    fresh = mujoco.MjData(model)
    mujoco.mj_forward(model, fresh)
    after = contacts_with(model, fresh, "thing")
    assert len(after) > 0
    assert before.shape != after.shape or np.abs(before - after).max() > 1e-4
    np.testing.assert_array_equal(contacts_with(model, data, "thing"), after)
