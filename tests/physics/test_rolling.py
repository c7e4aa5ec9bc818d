"""Balls roll as rigid ones do, and neither sink into the ground nor stop."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from builders.scenes import FLOOR, compiled
from scipy.spatial.transform import Rotation

from benchmarks.stability.states import move_points
from mjframes.body.build import build
from mjframes.body.soft_body import SoftBody
from mjframes.scene.contact import Contact
from mjframes.scene.placing import place
from mjframes.scene.view import soft
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

UPRIGHT = (1.0, 0.0, 0.0, 0.0)
LYING = (np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0)
SLOPE = np.radians(10)
SECONDS = 2.0


def rolled(
    body: SoftBody,
    radius: float,
    inertia: float,
    quat: tuple[float, ...] = UPRIGHT,
    timestep: float = 0.002,
) -> tuple[float, float]:
    """How far a body rolls over what a rigid one does [-], and how far its middle comes off that height [radii].

    inertia: about the axis on which it rolls, over mass × radius².
    """
    gravity = 9.81 * np.array([np.sin(SLOPE), 0, -np.cos(SLOPE)])
    scene = f"""<mujoco><option gravity="{gravity[0]} 0 {gravity[2]}"/>
      <worldbody><geom type="plane" size="9 9 .1"/></worldbody></mujoco>"""
    model, data = compiled(scene, (body, (0, 0, radius), quat), timestep=timestep)
    root, off = model.body_rootid[-1], 0.0
    while data.time < SECONDS:
        mujoco.mj_step(model, data)
        off = max(off, abs(data.subtree_com[root, 2] - radius) / radius)
    return data.subtree_com[root, 0] / (0.5 * gravity[0] / (1 + inertia) * SECONDS**2), off


@pytest.mark.parametrize(
    ("radius", "spacing", "young", "frames", "timestep"),
    [
        (0.05, 0.006, 3e5, 1, 0.002),
        (0.05, 0.006, 3e5, 5, 0.002),
        (0.05, 0.006, 3e6, 1, 0.0005),
        (0.02, 0.003, 3e5, 1, 0.002),
        (0.2, 0.02, 1e6, 1, 0.004),
    ],
)
def test_a_ball_rolls_down_a_slope_as_a_rigid_one(
    radius: float, spacing: float, young: float, frames: int, timestep: float
) -> None:
    """It rolled 0.4 of the way: contacts ahead of its middle braked, as if it were a polyhedron."""
    ball = build(Volume.sphere(radius, Material(young, 0.45, 1000), spacing=spacing), frames)
    way, off = rolled(ball, radius, 2 / 5, timestep=timestep)
    assert 0.98 < way < 1.02
    assert off < 0.05


@pytest.mark.parametrize(
    ("radius", "height", "spacing", "frames", "least", "most"),
    [
        pytest.param(0.05, 0.1, 0.006, 3, 0.89, 0.95, marks=pytest.mark.slow),
        (0.05, 0.1, 0.006, 5, 0.89, 0.95),
        pytest.param(0.03, 0.012, 0.003, 3, 0.65, 0.7, marks=pytest.mark.slow),
        pytest.param(0.03, 0.012, 0.003, 5, 0.65, 0.7, marks=pytest.mark.slow),
    ],
)
def test_cylinders_and_discs_brake(
    radius: float, height: float, spacing: float, frames: int, least: float, most: float
) -> None:
    """What docs/limits.md says of them."""
    body = build(Volume.cylinder(radius, height, Material(3e5, 0.45, 1000), spacing=spacing), frames)
    assert least < rolled(body, radius, 1 / 2, LYING)[0] < most


@pytest.mark.parametrize(("friction", "least", "most"), [(0.0001, 100, 205), (0.005, 0, 10)])
def test_rolling_friction_stops_a_ball(friction: float, least: float, most: float) -> None:
    """In millimetres of the 200 of a rigid ball without it. Its rows did nothing before they felt the material turn."""
    ball = build(Volume.sphere(0.02, Material(2e5, 0.45, 500), spacing=0.002), 4)
    contact = Contact(condim=6, friction=(1, 0.005, friction))
    model, data = compiled(FLOOR, (ball, (0, 0, 0.02), UPRIGHT), contact=contact)
    place(model, data, "soft0", (0, 0, 0.02), velocity=(0.1, 0, 0), spin=(0, 5, 0))
    mujoco.mj_step(model, data, nstep=1000)
    way = 1e3 * np.linalg.norm(data.subtree_com[model.body_rootid[-1], :2])
    assert least < way < most


@pytest.mark.slow
def test_a_round_side_touches_as_soon_as_it_is_there() -> None:
    """It touched once a vertex did, when the surface between was 0.06 mm below the ground, and 0.3 mm at narrower ends:
    bodies that stood on these jumped for ever.
    """
    ball = build(Volume.sphere(0.05, Material(3e5, 0.45, 1000), spacing=0.006), 3)
    scene = '<mujoco><worldbody><geom type="plane" size="9 9 .1"/></worldbody></mujoco>'
    model, data = compiled(scene, (ball, (0, 0, 0), UPRIGHT))
    mujoco.mj_forward(model, data)
    view = soft(model, data, "soft0")
    rest = view.control_positions.copy()
    rng = np.random.default_rng(0)
    for turn in Rotation.random(20, rng=rng):
        found: list[float] = []
        for height in np.arange(0.0515, 0.048, -1e-5):
            move_points(view, turn.apply(rest) + np.array([0, 0, height]))
            mujoco.mj_forward(model, data)
            if data.ncon:
                found.extend(data.contact.dist)
                break
        assert -3e-5 < min(found) < 0


@pytest.mark.parametrize("frames", [1, 10])
def test_a_ball_touches_below_its_middle_whichever_way_it_lies(frames: int) -> None:
    """In millimetres. Contacts up to 3.3 mm aside drove it away: patches of few vertices took their side for flat, or
    looked for its place from farther around than others, and of many vertices some were not looked at.
    """
    ball = build(Volume.sphere(0.02, Material(2e5, 0.45, 1000), spacing=0.002), frames)
    model, data = compiled(FLOOR, (ball, (0, 0, 0), UPRIGHT))
    aside, depth = [], []
    for turn in Rotation.random(60, rng=np.random.default_rng(5)):
        place(model, data, "soft0", (0, 0, 0.0197), np.roll(turn.as_quat(), 1))
        mujoco.mj_forward(model, data)
        aside.append(np.linalg.norm(data.contact.pos[:, :2], axis=1).max())
        depth.append(-data.contact.dist.min())
    assert max(aside) < 5e-5
    assert max(depth) < 1.05 * min(depth)


@pytest.mark.slow
def test_a_ball_that_is_set_down_hardly_rolls() -> None:
    """It rolled at up to 54 mm/s."""
    ball = build(Volume.sphere(0.02, Material(2e5, 0.45, 1000), spacing=0.002), 10)
    model, data = compiled(FLOOR, (ball, (0, 0, 0), UPRIGHT))
    root, fastest = model.body_rootid[-1], 0.0
    for turn in Rotation.random(8, rng=np.random.default_rng(3)):
        mujoco.mj_resetData(model, data)
        place(model, data, "soft0", (0, 0, 0.02), np.roll(turn.as_quat(), 1))
        for _ in range(80):
            before = data.subtree_com[root].copy()
            mujoco.mj_step(model, data, nstep=50)
            mujoco.mj_comPos(model, data)
            if data.time > 0.15:
                fastest = max(fastest, float(np.linalg.norm((data.subtree_com[root] - before)[:2])) / 0.1)
    assert fastest < 0.02
