"""Signed distances to convex hulls: the tree of faces against every face, and what a detailed mesh costs."""

from __future__ import annotations

import ctypes

import mujoco
import numpy as np
import pytest
from builders.harness import harness, pointer
from builders.scenes import compiled
from builders.slabs import slab
from scipy.spatial import ConvexHull

from mjframes.scene.contact import Contact

FAR = 1e9


def distances(
    vertices: np.ndarray, faces: np.ndarray, points: np.ndarray, reach: float, by_all: bool
) -> tuple[np.ndarray, np.ndarray]:
    distance, normal = np.zeros(len(points)), np.zeros((len(points), 3))
    vertices, faces = np.ascontiguousarray(vertices), np.ascontiguousarray(faces, np.int32)
    points = np.ascontiguousarray(points)
    harness("hull").hull_distances(
        len(vertices), pointer(vertices), len(faces), pointer(faces), len(points), pointer(points),
        ctypes.c_double(reach), int(by_all), pointer(distance), pointer(normal),
    )  # fmt: skip
    return distance, normal


def shapes() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    ball = rng.normal(size=(1500, 3))
    ball /= np.linalg.norm(ball, axis=1)[:, None]
    finger = ball * (0.008, 0.01, 0.03)
    finger[:, 2] += np.sign(finger[:, 2]) * 0.02
    grid = np.stack(np.meshgrid(*[np.linspace(-1, 1, 12)] * 3), axis=-1).reshape(-1, 3)
    # triangles that lie in one plane, and slivers
    box = grid[(np.abs(grid) == 1).any(axis=1)] * (0.02, 0.03, 0.01) + 1e-9 * rng.normal(size=(728, 3))
    return {"ball": 0.02 * ball, "finger": finger, "box": box}


@pytest.mark.parametrize("shape", shapes())
@pytest.mark.parametrize("reach", [0.002, 0.02, FAR])
def test_the_tree_finds_what_every_face_does(shape: str, reach: float) -> None:
    vertices = shapes()[shape]
    hull = ConvexHull(vertices)
    assert len(hull.simplices) > 128
    rng = np.random.default_rng(1)
    size = np.ptp(vertices, axis=0).max()
    on = vertices[hull.simplices].mean(axis=1)[rng.integers(len(hull.simplices), size=400)]
    points = np.concatenate(
        [
            rng.uniform(-size, size, (400, 3)),
            on * rng.uniform(0.8, 1.2, (400, 1)),
            vertices[hull.vertices[:100]] * rng.uniform(0.99, 1.1, (len(hull.vertices[:100]), 1)),
            [[0, 0, 0]],
        ]
    )
    expected, out = distances(vertices, hull.simplices, points, FAR, True)
    found, normal = distances(vertices, hull.simplices, points, reach, False)
    near = expected <= reach * (1 - 1e-12)
    assert near.sum() > 50
    np.testing.assert_allclose(found[near], expected[near], atol=1e-15)
    assert (found[~near] >= reach * (1 - 1e-12)).all()
    same = np.linalg.norm(normal - out, axis=1)[near] < 1e-6
    # two faces as near as each other, or as deep, to the last digits
    assert same.mean() > 0.97


FINGER = """<mujoco><asset><mesh name="finger" builtin="sphere" params="{}" scale=".008 .01 .03"/></asset><worldbody>
  <body name="finger" pos=".1 .1 .078"><joint type="slide" axis="0 0 1"/>
  <geom type="mesh" mesh="finger" mass=".05"/></body></worldbody></mujoco>"""


def test_a_detailed_finger_touches_as_a_coarse_one_does() -> None:
    depths = []
    for detail in (3, 4):  # 1280 faces, 5120
        xml = FINGER.format(detail)
        model, data = compiled(xml, (slab(), (0, 0, 0), (1, 0, 0, 0)), contact=Contact(solref=(0.01, 1)))
        for _ in range(200):
            mujoco.mj_step(model, data)
        assert data.ncon > 0
        depths.append(float(data.qpos[model.jnt_qposadr[0]]))
    assert depths[0] == pytest.approx(depths[1], abs=5e-4)
