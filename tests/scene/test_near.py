"""Voxels near the geoms of a body, against distances worked out by hand."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest
import trimesh

import mjframes as mf
from mjframes.base.errors import MjframesError

TURNED = (0.5**0.5, 0.0, 0.0, 0.5**0.5)  # z by 90°
SCENE = """<mujoco><worldbody><geom type="plane" size="1 1 .1" pos="0 0 -1"/>
<body name="link" pos=".1 .2 .3" quat=".6 0 .8 0"><joint/>{geom}</body><body name="empty"/></worldbody></mujoco>"""


def volume(**options: Any) -> mf.Volume:
    labels = np.ones((12, 10, 8), int)
    labels[0, 0] = 0
    return mf.Volume.from_labels(labels, 0.01, {1: mf.Material(1e5, 0.3, 1000)}, origin=(-0.06, -0.05, 0.0), **options)


def masked(geom: str, distance: float, **place: Any) -> np.ndarray:
    return mf.near(mujoco.MjSpec.from_string(SCENE.format(geom=geom)), "link", volume(), distance, **place)


@pytest.mark.parametrize("distance", [0.001, 0.004, 0.012])
@pytest.mark.parametrize("kind", ["sphere", "box"])
def test_they_are_those_within_the_distance_of_a_geom(kind: str, distance: float) -> None:
    geom, pos = f'<geom type="{kind}" size=".02 .03 .021" pos=".01 .02 -.03"/>', (0.02, 0.01, -0.04)
    made = volume()
    points = made.centers @ np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]]).T + pos - (0.01, 0.02, -0.03)
    outside = np.maximum(np.abs(points) - (0.02, 0.03, 0.021), 0)
    away = np.linalg.norm(outside, axis=1) if kind == "box" else np.linalg.norm(points, axis=1) - 0.02
    expected = away <= distance + 0.005
    found = masked(geom, distance, pos=pos, quat=TURNED)
    assert 0 < expected.sum() < len(expected)
    assert not found[made.labels == 0].any()
    np.testing.assert_array_equal(found[made.labels > 0], expected)


def test_meshes_count_as_their_convex_hull() -> None:
    spec = mujoco.MjSpec.from_string(SCENE.format(geom=""))
    cube = trimesh.creation.box((0.04, 0.06, 0.042))
    spec.add_mesh(name="cube", uservert=cube.vertices.ravel(), userface=cube.faces.ravel())
    spec.body("link").add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="cube", pos=[0.01, 0.02, -0.03])
    found = mf.near(spec, "link", volume(), 0.003, pos=(0, 0, -0.04))
    box = '<geom type="box" size=".02 .03 .021" pos=".01 .02 -.03"/>'
    np.testing.assert_array_equal(found, masked(box, 0.003, pos=(0, 0, -0.04)))


def test_pictures_of_what_collides_do_not_count() -> None:
    seen = '<geom size=".05" pos="0 0 .05" contype="0" conaffinity="0"/>'
    touched = '<geom size=".02" pos="0 0 .02"/>'
    np.testing.assert_array_equal(masked(seen + touched, 0.002), masked(touched, 0.002))
    assert masked(seen, 0.002).sum() > masked(touched, 0.002).sum()


def test_the_world_has_geoms_too() -> None:
    spec = mujoco.MjSpec.from_string(SCENE.format(geom="<geom size='.01'/>"))
    found = mf.near(spec, "world", volume(), 0.001, pos=(0, 0, -1))
    np.testing.assert_array_equal(found, volume().side("-z"))


@pytest.mark.parametrize(
    ("parent", "distance", "words"),
    [
        ("empty", 0.1, "parent is 'empty', which has no geoms to be near"),
        ("none", 0.1, "parent is 'none', but the bodies of the scene are: 'world', 'link', 'empty'"),
        ("link", -1, "distance is -1; it must be a length"),
        ("link", 0.001, "no voxel is within 0.001 m of the geoms of 'link'; give a larger distance"),
    ],
)
def test_what_cannot_be_is_refused(parent: str, distance: float, words: str) -> None:
    spec = mujoco.MjSpec.from_string(SCENE.format(geom="<geom size='.01' pos='0 0 1'/>"))
    with pytest.raises(MjframesError, match=words):
        mf.near(spec, parent, volume(), distance)


def test_a_pose_that_is_none_is_refused() -> None:
    spec = mujoco.MjSpec.from_string(SCENE.format(geom="<geom size='.01'/>"))
    with pytest.raises(MjframesError, match=r"quat is \(0, 0, 0, 0\); give three metres and four quat"):
        mf.near(spec, "link", volume(), 0.1, quat=(0, 0, 0, 0))
