"""What MuJoCo itself asks of soft bodies' geoms: rays, range finders, picking, tactile sensors, flexes."""

from __future__ import annotations

import re
from collections.abc import Callable

import mujoco
import numpy as np
import pytest
from builders.lengthwise import block
from builders.scenes import FLOOR, TILTED, beam, compiled, dense_constraints, dofs, lump, point_jacobian
from builders.slabs import slab

from mjframes.body.build import build
from mjframes.body.soft_body import SoftBody
from mjframes.scene import plugin
from mjframes.scene.attach import attach
from mjframes.scene.contact import Contact
from mjframes.scene.view import soft
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

STRAIGHT = (1, 0, 0, 0)
BENT = 0.002  # [m] the surface by a fraction of a voxel
CLOTH = """<mujoco><option timestep=".002" cone="{cone}" jacobian="{jacobian}" gravity="0 0 {gravity}"/><worldbody>
  <flexcomp name="cloth" type="grid" dim="{dim}" count="7 7 {layers}" spacing=".03 .03 .03" pos=".1 .1 .06" mass=".05"
    radius=".001"><contact selfcollide="none" solref=".005 1" {contact}/><edge equality="true"/></flexcomp>
</worldbody></mujoco>"""


def turning_block() -> SoftBody:
    return block("corotational", frame_type=("rigid", "affine", "rigid"))


def cast(model: mujoco.MjModel, data: mujoco.MjData, start: np.ndarray, along: np.ndarray) -> tuple[float, int]:
    """Distance and geom of what a ray meets; −1 for nothing."""
    geom = np.zeros(1, np.int32)
    return mujoco.mj_ray(model, data, start, along, None, 1, -1, geom), int(geom[0])


def triangles(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """(n, 3, 3) corners of all skins where they are now."""
    scene = mujoco.MjvScene(model, 10)
    everything = mujoco.mjtCatBit.mjCAT_ALL
    mujoco.mjv_updateScene(model, data, mujoco.MjvOption(), None, mujoco.MjvCamera(), everything, scene)
    vertices = np.asarray(scene.skinvert, float).reshape(-1, 3)
    return np.concatenate(
        [
            vertices[start + model.skin_face[face : face + faces]]
            for start, face, faces in zip(model.skin_vertadr, model.skin_faceadr, model.skin_facenum, strict=True)
        ]
    )


def nearest_hit(corners: np.ndarray, start: np.ndarray, along: np.ndarray) -> tuple[float, float]:
    """Distance along a ray to the nearest triangle, infinite for none, and the cosine of its incidence."""
    edges = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(*edges)
    across, offset = np.cross(along, edges[1]), start - corners[:, 0]
    with np.errstate(all="ignore"):
        scale = 1 / (edges[0] * across).sum(axis=1)
        u = scale * (offset * across).sum(axis=1)
        v = scale * (np.cross(offset, edges[0]) @ along)
        t = scale * (edges[1] * np.cross(offset, edges[0])).sum(axis=1)
    t[~((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0))] = np.inf
    first = int(np.argmin(t))
    return float(t[first]), float(abs(normal[first] @ along) / np.linalg.norm(normal[first]))


@pytest.mark.parametrize(("body", "bent"), [(lump, 0.0), (lump, 0.003), (slab, 0.0), (slab, 0.003), (beam, 0.003)])
def test_rays_hit_the_deformed_surface(body: Callable[[], SoftBody], bent: float) -> None:
    """All but those that graze it, where the skin is, to a tenth of a cell in the median."""
    made = body()
    model, data = compiled("<mujoco/>", (made, (0, 0, 0.1), TILTED))
    rng = np.random.default_rng(0)
    data.qpos += bent * rng.normal(size=model.nq)
    mujoco.mj_forward(model, data)
    corners = triangles(model, data)
    middle, size = corners.mean(axis=(0, 1)), np.ptp(corners, axis=(0, 1)).max() / 2
    patches, errors, missed = set(soft(model, data, "soft0").patches.tolist()), [], 0
    for _ in range(300):
        start = rng.normal(size=3)
        start = middle + size * rng.uniform(2, 5) * start / np.linalg.norm(start)
        along = middle + size * rng.uniform(-0.5, 0.5, 3) - start
        along /= np.linalg.norm(along)
        expected, cosine = nearest_hit(corners, start, along)
        found, geom = cast(model, data, start, along)
        if not np.isfinite(expected) or cosine < 0.4:
            continue
        missed += found < 0
        if found >= 0:
            assert geom in patches
            errors.append(abs(found - expected))
    assert len(errors) > 40
    assert missed < 0.02 * len(errors)
    assert np.median(errors) < 0.1 * made.distance_field.spacing
    assert np.quantile(errors, 0.95) < 1.5 * made.distance_field.spacing  # edges are rounded


def test_many_rays_a_range_finder_and_picking() -> None:
    scene = """<mujoco><worldbody><geom type="plane" size="1 1 .1"/><site name="eye" pos=".1 .1 .3" zaxis="0 0 -1"/>
      </worldbody><sensor><rangefinder site="eye"/></sensor></mujoco>"""
    model, data = compiled(scene, (slab(), (0, 0, 0.02), STRAIGHT))
    mujoco.mj_forward(model, data)
    assert data.sensordata[0] == pytest.approx(0.3 - 0.07, abs=BENT)
    along = np.array([[0, 0, -1.0], [0.2, 0, -1], [0, 0, 1]])
    geoms, distances = np.zeros(3, np.int32), np.zeros(3)
    start = np.array([0.1, 0.1, 0.3])
    for i in range(3):
        distances[i], geoms[i] = cast(model, data, start, along[i] / np.linalg.norm(along[i]))
    assert distances[1] == pytest.approx((0.3 - 0.07) * np.hypot(1, 0.2), abs=BENT)
    assert distances[2] == -1
    many, which = np.zeros(3), np.zeros(3, np.int32)
    unit = along / np.linalg.norm(along, axis=1)[:, None]
    mujoco.mj_multiRay(model, data, start, unit.ravel(), None, 1, -1, which, many, None, 3, mujoco.mjMAXVAL)
    np.testing.assert_allclose(many, distances, atol=1e-9)

    camera, option, scene = mujoco.MjvCamera(), mujoco.MjvOption(), mujoco.MjvScene(model, 100)
    camera.lookat, camera.distance, camera.elevation = (0.1, 0.1, 0.05), 0.5, -90
    option.geomgroup[:] = 1
    option.skingroup[:] = 0
    mujoco.mjv_updateScene(model, data, option, None, camera, mujoco.mjtCatBit.mjCAT_ALL, scene)
    point, ids = np.zeros(3), [np.full((1, 1), -1, np.int32) for _ in range(3)]
    picked = mujoco.mjv_select(model, data, option, 1.0, 0.5, 0.5, scene, point, *ids)
    assert picked >= 0
    assert int(ids[0][0, 0]) in soft(model, data, "soft0").patches
    assert point[2] == pytest.approx(0.07, abs=BENT)


def test_rays_hit_bodies_that_have_no_volume_near_their_vertices() -> None:
    body = build(Volume.from_labels(np.ones((6, 6, 6)), 0.01, {1: Material(2e4, 0.3, 1000)}), 8, frame_type="point")
    model, data = compiled("<mujoco/>", (body, (0, 0, 0), STRAIGHT))
    mujoco.mj_forward(model, data)
    for x, y in np.random.default_rng(0).uniform(0.01, 0.05, (20, 2)):
        found, _ = cast(model, data, np.array([x, y, 0.5]), np.array([0, 0, -1.0]))
        assert found == pytest.approx(0.5 - 0.06, abs=0.012)


def test_a_ray_in_a_scene_that_was_never_stepped_is_harmless() -> None:
    model, data = compiled(FLOOR, (slab(), (0, 0, 0.02), STRAIGHT))
    found, _ = cast(model, data, np.array([0.1, 0.1, 0.3]), np.array([0, 0, -1.0]))
    assert np.isfinite(found)


def test_a_tactile_sensor_feels_a_soft_body() -> None:
    """A ball two millimetres deep in a slab: its lowest taxel is as deep, those above are not inside."""
    scene = """<mujoco><asset><mesh name="taxels" builtin="sphere" params="3" scale=".02 .02 .02"/></asset>
      <option gravity="0 0 0"/><worldbody><body pos=".1 .1 .068"><joint axis="0 0 1" type="slide"/>
      <geom name="finger" size=".02"/></body></worldbody>
      <sensor><tactile geom="finger" mesh="taxels"/></sensor></mujoco>"""
    model, data = compiled(scene, (slab(), (0, 0, 0), STRAIGHT))
    mujoco.mj_forward(model, data)
    vertices = model.mesh_vert[: model.mesh_vertnum[0]]
    felt = data.sensordata[: len(vertices)]
    depth = np.maximum(0.05 - (0.068 + vertices[:, 2]), 0)
    assert depth.max() > 0.001
    np.testing.assert_allclose(felt, depth, atol=BENT)


@pytest.mark.parametrize(("cone", "jacobian"), [("elliptic", "dense"), ("elliptic", "sparse"), ("pyramidal", "sparse")])
@pytest.mark.parametrize("turning", [False, True])
def test_a_cloth_acts_at_its_contact_point(turning: bool, cone: str, jacobian: str) -> None:
    """Rows are the rate of −t · p, whatever rigid motion the soft body has."""
    made = turning_block() if turning else lump()
    low, high = made.skin.vertices.min(axis=0), made.skin.vertices.max(axis=0)
    middle = (low + high) / 2
    xml = CLOTH.format(cone=cone, jacobian=jacobian, gravity=0, dim=2, layers=1, contact="")
    at = (0.1 - middle[0], 0.1 - middle[1], 0.066 - high[2])
    model, data = compiled(xml, (made, at, STRAIGHT), contact=Contact(friction=(0.5,)))
    view, rng = soft(model, data, "soft0"), np.random.default_rng(0)
    mujoco.mj_forward(model, data)
    mine = dofs(model, view).ravel() if not turning else np.flatnonzero(np.isin(model.dof_bodyid, view.bodies))
    touching = [c for c in data.contact if max(c.flex) >= 0 and max(c.geom) >= 0]
    assert len(touching) > 3
    rows = dense_constraints(model, data)
    points = point_jacobian(model, data, view)[:, mine]
    for _ in range(3):
        velocity, spin = rng.normal(size=(2, 3))
        speed = velocity + np.cross(spin, view.control_positions)
        rates = np.linalg.lstsq(points, speed.ravel(), rcond=None)[0]
        np.testing.assert_allclose(points @ rates, speed.ravel(), atol=1e-9)
        for c in touching:
            axes = c.frame.reshape(3, 3)
            along = axes[0] + c.friction[0] * axes[1] if cone == "pyramidal" else axes[0]
            sign = -1 if c.geom[0] >= 0 else 1
            expected = sign * along @ (velocity + np.cross(spin, c.pos))
            assert rows[c.efc_address, mine] @ rates == pytest.approx(expected, abs=1e-9)


@pytest.mark.slow
def test_a_cloth_comes_to_rest_on_a_slab() -> None:
    """MuJoCo's cloth trembles: in single steps the slab bears its weight to within 15 %, over many exactly that."""
    xml = CLOTH.format(cone="pyramidal", jacobian="auto", gravity=-9.81, dim=2, layers=1, contact="")
    model, data = compiled(xml, (slab(), (0, 0, 0), STRAIGHT))
    view, borne = soft(model, data, "soft0"), []
    for _ in range(400):
        mujoco.mj_step(model, data)
        borne.append(-view.patch_forces[:, 2].sum())
    height = data.flexvert_xpos[:, 2]
    assert np.abs(height - 0.05).max() < 0.006
    assert not data.warning.number.any()
    weight = 9.81 * model.body_mass[model.flex_vertbodyid].sum()
    assert np.mean(borne[200:]) == pytest.approx(weight, rel=0.01)


def test_flexes_that_cannot_touch_are_refused() -> None:
    for dim in (1, 3):
        xml = CLOTH.format(cone="pyramidal", jacobian="auto", gravity=-9.81, dim=dim, layers=dim - 1 or 1, contact="{}")
        xml = xml.replace("7 7", "7 1" if dim == 1 else "7 7")
        with pytest.raises(ValueError, match="flexes of dim 2 only, not with 'cloth'"):
            compiled(xml.format(""), (slab(), (0, 0, 0), STRAIGHT))
        compiled(xml.format('contype="0" conaffinity="0"'), (slab(), (0, 0, 0), STRAIGHT))


@pytest.mark.parametrize(
    "xml",
    [
        '<asset><mesh name="a"><plugin plugin="{0}"/></mesh></asset>',
        '<worldbody><body><geom type="sdf" mesh="a"><plugin plugin="{0}"/></geom></body></worldbody>'
        '<asset><mesh name="a" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/></asset>',
    ],
)
def test_the_patches_plugin_alone_is_refused(xml: str) -> None:
    plugin.load()
    extension = f'<extension><plugin plugin="{plugin.PATCH_NAME}"/></extension>'
    with pytest.raises(ValueError, match=r"at least 4 vertices|soft body only"):
        mujoco.MjModel.from_xml_string(f"<mujoco>{extension}{xml.format(plugin.PATCH_NAME)}</mujoco>")


def test_a_scene_of_before_is_refused() -> None:
    """Its patches had the instance of their soft body."""
    spec = mujoco.MjSpec()
    attach(spec, slab(), "soft0")
    spec.compile()
    xml = re.sub(r'<plugin instance="soft0:patch_\d+"/>', "", spec.to_xml())
    with pytest.raises(ValueError, match="its patch geoms are not there: build it again"):
        mujoco.MjModel.from_xml_string(xml)
