"""Whole motions: flight, falls of bodies of any stiffness, rest on a floor, and the steak of Figure 1e."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest
from builders.scenes import FLOOR, TILTED, beam, compiled, in_space, point_jacobian
from scipy import ndimage
from scipy.spatial import KDTree

from mjframes.body.build import build
from mjframes.body.soft_body import SoftBody
from mjframes.scene.attach import attach
from mjframes.scene.view import Soft, soft
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

FLESH, BONE = 1, 2
EDGE = """
<mujoco><worldbody>
  <geom type="plane" size="1 1 .1"/><geom type="box" size=".05 .1 .05" pos=".05 0 .05"/>
</worldbody></mujoco>
"""
FALLS = {"on a floor": (FLOOR, 0.05), "on an edge": (EDGE, 0.2)}


@pytest.mark.parametrize("beta", [0.0, 0.001], ids=["elastic", "damped"])
def test_momentum_is_conserved_in_free_flight(beta: float) -> None:
    model, data = in_space(beam(beta=beta))
    view = soft(model, data, "soft0")
    mujoco.mj_forward(model, data)
    x = view.control_positions
    spin = np.cross([5.0, -3.0, 8.0], x - x.mean(axis=0))
    velocity = spin + [1, 2, 3] + 0.3 * np.random.default_rng(0).normal(size=x.shape)
    data.qvel[:] = np.linalg.solve(point_jacobian(model, data, view), velocity.ravel())
    mujoco.mj_forward(model, data)
    before, energy = (view.linear_momentum, view.angular_momentum), view.kinetic_energy + view.elastic_energy
    for _ in range(500):
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    # A v⁺ differs from M v by K times rates, and K is blind to translations and turns: exact, not only to O(h)
    for after, at_start in zip((view.linear_momentum, view.angular_momentum), before, strict=True):
        assert np.abs(after - at_start).max() < 1e-10 * np.abs(at_start).max()
    assert 0.9 * energy < view.kinetic_energy + view.elastic_energy < energy


@pytest.mark.parametrize("fall", FALLS)
@pytest.mark.parametrize("timestep", [0.002, 0.005], ids="{} s".format)
@pytest.mark.parametrize("young", 10.0 ** np.arange(3, 11), ids="{:.0e} Pa".format)
def test_a_fall_is_stable_however_stiff(young: float, timestep: float, fall: str) -> None:
    scene, height = FALLS[fall]
    model, data = compiled(scene, (beam(young), (0, 0, height), TILTED), timestep=timestep)
    view = soft(model, data, "soft0")
    mujoco.mj_forward(model, data)
    start = _visible_energy(view)
    for _ in range(round(0.1 / timestep)):
        for _ in range(10):
            mujoco.mj_step(model, data)
        mujoco.mj_forward(model, data)
        # In 5 ms a body turns so far that the step, straight along the tangent, stretches it by ½ (ω h)²; in a
        # stiff one that is much elastic energy, which the next steps do not turn into motion.
        elastic = view.elastic_energy if young <= 1e6 else 0
        assert _visible_energy(view) + elastic <= start
        if young >= 1e8:
            assert _stretch(view) < 0.02
    assert np.isfinite(data.qpos).all()
    # some still stand on an edge of their end, and any rounding says for how long: upright it is 0.43
    assert _visible_energy(view) < 0.45 * start
    assert not any(warning.number for warning in data.warning)


def cup() -> SoftBody:
    """With a thin wall and a firm rim."""
    x, y, z = np.indices((22, 22, 24)) - np.array([10.5, 10.5, 0])[:, None, None, None]
    radius = np.hypot(x, y)
    labels = ((radius < 10) & ((radius > 7) | (z < 3))).astype(int)
    labels[(labels > 0) & (z >= 20)] = 2
    return build(Volume.from_labels(labels, 0.004, {1: Material(8e4, 0.4, 1100), 2: Material(2e6, 0.4, 1200)}), 5)


@pytest.mark.parametrize("timestep", [pytest.param(0.0005, marks=pytest.mark.slow), 0.002])
def test_a_thin_walled_cup_on_the_edge_of_a_box_makes_no_energy(timestep: float) -> None:
    # contacts as hard as the whole body's mass asks for pump the wall up: 1.5 and 1.8 times the energy of the start
    edge = '<geom type="box" size=".03 .05 .03" pos=".06 .05 .03" euler="0 20 0"/></worldbody>'
    placed = cup(), (0, 0, 0.12), (1, 0, 0, 0)
    model, data = compiled(FLOOR.replace("</worldbody>", edge), placed, timestep=timestep)
    view = soft(model, data, "soft0")
    mujoco.mj_forward(model, data)
    start = _visible_energy(view)
    for _ in range(100):
        mujoco.mj_step(model, data, round(0.01 / timestep))
        mujoco.mj_forward(model, data)
        assert _visible_energy(view) + view.elastic_energy <= start


def _visible_energy(view: Soft) -> float:
    """Of motion and height [J]."""
    height = view.model.body_mass[view.bodies] @ view.control_positions[:, 2]
    return view.kinetic_energy - view.model.opt.gravity[2] * height


def _stretch(view: Soft) -> float:
    """The largest change of a distance between control points, relative to the longest distance."""
    now, rest = (np.linalg.norm(x[:, None] - x, axis=2) for x in (view.control_positions, view.rest))
    return np.abs(now - rest).max() / rest.max()


@cache
def steak_volume() -> Volume:
    return Volume.load(Path(__file__).parents[2] / "models" / "steak.npz")


@pytest.mark.slow
def test_a_steak_lies_still() -> None:
    model, data = compiled(FLOOR, (build(steak_volume(), 3), (0, 0, 0.03), (1, 0, 0, 0)))
    for _ in range(2500):  # [2 ms] falls and settles
        mujoco.mj_step(model, data)
    weight = -model.opt.gravity[2] * model.body_mass.sum()
    for _ in range(50):
        for _ in range(100):
            mujoco.mj_step(model, data)
            assert np.abs(data.qvel).max() < 1e-6
        assert _normal_force(model, data) == pytest.approx(weight, rel=1e-5)


def _normal_force(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    """Of all contacts with the floor [N]."""
    force, total = np.zeros(6), 0.0
    for contact in range(data.ncon):
        mujoco.mj_contactForce(model, data, contact, force)
        total += force[0]
    return total


@cache
def steak_of_figure_1() -> tuple[SoftBody, list[np.ndarray]]:
    """A frame in the bone and one in each muscle; the voxels' places (n, 3) of each, in this order."""
    volume = steak_volume()
    labels, count = ndimage.label(volume.labels == FLESH, np.ones((3, 3, 3)))  # pyright: ignore[reportGeneralTypeIssues]
    masks = [volume.labels == BONE, *(labels == number for number in range(1, count + 1))]
    places = [volume.origin + (np.argwhere(mask) + 0.5) * volume.spacing for mask in masks]
    at = [some[np.argmin(np.linalg.norm(some - some.mean(axis=0), axis=1))] for some in places]
    return build(volume, at=at, damping=(5.0, 0.0)), places


@pytest.mark.parametrize("pulled", [1, 2], ids=["tenderloin", "strip loin"])
def test_a_muscle_of_the_steak_moves_alone(pulled: int) -> None:
    """Figure 1e: the bone is held, one muscle pulled by its own weight; bone stays rigid, the other muscle still."""
    body, places = steak_of_figure_1()
    # frames are numbered depth first: each part's is the one whose points are around it
    centers = body.control.rest.reshape(-1, 4, 3).mean(axis=1)
    frame = [int(np.argmin(np.linalg.norm(centers - some.mean(axis=0), axis=1))) for some in places]
    assert sorted(frame) == [0, 1, 2]
    model, data = _held(body, np.flatnonzero(body.control.frame == frame[0]))
    view = soft(model, data, "soft0")
    mujoco.mj_forward(model, data)
    start = view.control_positions
    own = view.bodies[body.control.frame == frame[pulled]]
    data.xfrc_applied[own, 2] = -9.81 * model.body_mass[own]
    for _ in range(1000):
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    assert np.abs(data.qvel).max() < 1e-5

    moved = body.skin.weights @ (view.control_positions - start)  # of the skin's vertices
    bone, flesh = (np.unique(body.skin.faces[body.skin.label == label]) for label in (BONE, FLESH))
    gap = [KDTree(some).query(body.skin.vertices[flesh])[0] for some in places[1:]]
    muscle, distance = np.argmin(gap, axis=0) + 1, np.linalg.norm(moved[flesh], axis=1)
    assert distance[muscle == pulled].mean() > 5e-4
    assert distance[muscle == 3 - pulled].mean() < 0.05 * distance[muscle == pulled].mean()

    ends = body.skin.vertices[bone]
    pairs = np.random.default_rng(0).integers(len(bone), size=(2, 2000))
    before, after = (np.linalg.norm(p[pairs[0]] - p[pairs[1]], axis=1) for p in (ends, ends + moved[bone]))
    # vertices between bone and flesh are a little of either, and the muscle swings by a quarter of the steak
    assert np.abs(after - before).max() < 0.005 * before.max()


def _held(body: SoftBody, points: np.ndarray) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The body alone, without gravity, some of its control points held in place."""
    spec = mujoco.MjSpec.from_string('<mujoco><option gravity="0 0 0" timestep="0.01"/></mujoco>')
    attach(spec, body, "soft0", contact=False)
    for j in points:
        held = spec.add_equality(type=mujoco.mjtEq.mjEQ_CONNECT, objtype=mujoco.mjtObj.mjOBJ_BODY)
        held.name1, held.name2 = "soft0" if j == 0 else f"soft0:{j}", "world"
        held.data[:3] = 0
        held.solimp[:2] = 0.9999
    model = spec.compile()
    return model, mujoco.MjData(model)
