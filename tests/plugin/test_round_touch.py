"""Spheres and ellipsoids touch where the surface is deepest in them, from the first on."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from builders.scenes import compiled
from builders.slabs import slab

from mjframes.body.build import build
from mjframes.body.soft_body import SoftBody
from mjframes.scene.contact import Contact
from mjframes.scene.view import soft
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

TOP = 0.05  # of the slab [m]
ROUND = {
    "ball of 5 cm": ("sphere", (0.05, 0, 0)),
    "ball of 20 cm": ("sphere", (0.2, 0, 0)),
    "ellipsoid": ("ellipsoid", (0.06, 0.09, 0.12)),
}


def above(shape: str, size: tuple[float, ...], body: SoftBody, dents: bool) -> tuple[mujoco.MjModel, mujoco.MjData]:
    scene = f"""<mujoco><option gravity="0 0 0"/><worldbody><body name="round" mocap="true">
      <geom name="round" type="{shape}" size="{" ".join(map(str, size))}" condim="1"/></body></worldbody></mujoco>"""
    return compiled(scene, (body, (0, 0, 0), (1, 0, 0, 0)), contact=Contact(dents=dents))


def bring(data: mujoco.MjData, lowest: np.ndarray, quat: np.ndarray) -> None:
    """Turn the geom and put its lowest point there."""
    axes = np.zeros(9)
    mujoco.mju_quat2Mat(axes, quat)
    size = data.model.geom("round").size
    half = size if size[1] else np.full(3, size[0])
    down = -axes.reshape(3, 3)[2]  # along the geom's axes
    support = axes.reshape(3, 3) @ (half**2 * down / np.linalg.norm(half * down))
    data.mocap_pos[0], data.mocap_quat[0] = lowest - support, quat
    mujoco.mj_forward(data.model, data)


@pytest.mark.parametrize("dents", [True, False])
@pytest.mark.parametrize("name", ROUND)
def test_they_touch_at_their_lowest_point_wherever_they_come_down(name: str, dents: bool) -> None:
    """Vertices are 2 cm apart: between them balls sank in by half a millimetre before anything touched."""
    shape, size = ROUND[name]
    _, data = above(shape, size, slab(), dents)
    rng = np.random.default_rng(0)
    for x, y in rng.uniform(0.05, 0.15, (20, 2)):
        quat = rng.normal(size=4)
        quat /= np.linalg.norm(quat)
        bring(data, np.array([x, y, TOP + 2e-5]), quat)
        assert data.ncon == 0
        for depth in (2e-5, 1e-4):
            bring(data, np.array([x, y, TOP - depth]), quat)
            contact = data.contact[int(np.argmin(data.contact.dist))]
            # the mean below Hertz's pressure is four fifths of the depth
            assert contact.dist == pytest.approx(-(0.8 if dents else 1) * depth, rel=0.05)
            assert np.abs(contact.pos[:2] - (x, y)).max() < 2e-4
            assert abs(contact.frame[2]) > 0.9999


def test_one_contact_of_all_patches() -> None:
    """They meet below the ball."""
    body = build(Volume.box((0.2, 0.2, 0.05), Material(1e5, 0.3, 1000), spacing=0.01), 12)
    model, data = above("sphere", (0.2, 0, 0), body, True)
    low, high = (end(body.contact.positions, axis=0) for end in (np.min, np.max))
    middle, top = (low + high) / 2, high[2]
    counts = []
    for x, y in middle[:2] + np.random.default_rng(1).uniform(-0.05, 0.05, (30, 2)):
        bring(data, np.array([x, y, top - 1e-4]), np.array([1.0, 0, 0, 0]))
        counts.append(int((data.contact.dist < -5e-5).sum()))
    assert len(soft(model, data, "soft0").patches) > 5
    assert set(counts) == {1}


def test_the_flesh_below_is_that_of_the_place() -> None:
    """Strips of a twentieth of the stiffness, narrower than a cluster of vertices."""
    labels = np.ones((24, 24, 8), np.uint8)
    labels[8:16] = 2
    volume = Volume.from_labels(labels, 0.005, {1: Material(1e6, 0.3, 1000), 2: Material(5e4, 0.3, 1000)})
    body = build(volume, 1)
    force = []
    for x in (0.02, 0.06):
        _, data = above("sphere", (0.03, 0, 0), body, True)
        top = float(body.contact.positions[:, 2].max())
        bring(data, np.array([x, 0.06, top - 5e-4]), np.array([1.0, 0, 0, 0]))
        row = data.contact[int(np.argmin(data.contact.dist))].efc_address
        force.append(data.efc_KBIP[row, 0])
    assert force[0] > 4 * force[1]


@pytest.mark.parametrize("dents", [True, False])
@pytest.mark.parametrize("name", ROUND)
def test_what_lies_on_a_thin_sheet_is_not_pushed_through_it(name: str, dents: bool) -> None:
    """The other side, which is near, pushed down a ball that had not yet touched."""
    shape, size = ROUND[name]
    volume = Volume.box((0.3, 0.12, 0.008), Material(5e5, 0.4, 1100), spacing=0.004)
    _, data = above(shape, size, build(volume, 3), dents)
    rng = np.random.default_rng(1)
    for depth in (-0.004, -1e-3, 1e-3, 0.003, 0.006):
        for x, y in rng.uniform((-0.1, -0.03), (0.1, 0.03), (10, 2)):
            quat = rng.normal(size=4)
            bring(data, np.array([x, y, 0.004 - depth]), quat / np.linalg.norm(quat))
            assert (depth > 0) == (data.ncon > 0)
            assert (data.contact.frame[:, 2] < -0.3).all()  # down, out of the geom
            assert (data.contact.dist > -1.1 * depth - 1e-4).all()
