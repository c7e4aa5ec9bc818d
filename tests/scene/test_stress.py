"""Stresses are in equilibrium: through every section goes the load that acts beyond it."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest
from builders.scenes import in_space, move_points

import mjframes as mf
from mjframes.scene.view import Soft

SOFT = mf.Material(young=1e5, poisson=0.3, density=1000)
LINK = """<mujoco><option gravity="0 0 0"/><worldbody><body name="l" pos="0 0 .03"><joint name="j" type="slide"
axis="0 0 1"/><geom size=".01" mass=".01" contype="0" conaffinity="0"/></body></worldbody></mujoco>"""
WEIGHT = '<mujoco><option gravity="0 0 -9.81"/></mujoco>'


def settled(spec: mujoco.MjSpec, body: mf.SoftBody, force: float = 0.0) -> Soft:
    """At rest, with a force [N] on what the spec moves."""
    at = mf.attach(spec, body, "a", contact=False)
    model = spec.compile()
    data = mujoco.MjData(model)
    if force:
        data.joint("j").qfrc_applied[0] = force
    for _ in range(40):
        mujoco.mj_step(model, data, nstep=50)
        data.qvel[:] = 0
    mujoco.mj_step(model, data, nstep=500)
    mujoco.mj_forward(model, data)
    return at.soft(model, data)


def sections(points: np.ndarray, axis: int) -> list[np.ndarray]:
    """The points of each layer along an axis but the first and the last one."""
    place = points[:, axis].round(6)
    return [np.flatnonzero(place == some) for some in np.unique(place)[1:-1]]


@cache
def pulled(frames: int | None, spacing: float, ratio: float, law: str) -> tuple[np.ndarray, float]:
    """Section forces of a bar that two links pull apart, to their force, and Σ W ΔV to the energy."""
    across, along = round(0.03 / spacing), round(0.06 / spacing)
    labels = np.ones((across, across, along), int)
    labels[:, :, along // 2 :] = 2
    materials = {1: SOFT, 2: mf.Material(ratio * SOFT.young, 0.3, 1000)}
    volume = mf.Volume.from_labels(labels, spacing, materials, origin=(-0.015, -0.015, -0.03))
    glued = [mf.Fixed(volume.side("-z")), mf.Attached("l", volume.side("z"))]
    view = settled(mujoco.MjSpec.from_string(LINK), mf.build(volume, frames, supports=glued, law=law), 2.0)
    stress = view.stresses(volume.centers)[:, 2, 2]
    force = np.array([stress[some].sum() for some in sections(volume.centers, 2)]) * spacing**2 / 2.0
    return force, view.energy_densities(volume.centers).sum() * spacing**3 / view.elastic_energy


@pytest.mark.parametrize(
    ("frames", "spacing", "ratio", "law", "error"),
    [
        (None, 0.005, 1, "corotational", 0.12),
        (2, 0.005, 1, "corotational", 0.12),
        pytest.param(None, 0.0025, 1, "corotational", 0.12, marks=pytest.mark.slow),
        pytest.param(None, 0.005, 4, "corotational", 0.15, marks=pytest.mark.slow),
        pytest.param(None, 0.005, 100, "corotational", 0.25, marks=pytest.mark.slow),
        (None, 0.005, 1, "neo_hookean", 0.15),
    ],
)
def test_a_pulled_bar_has_the_same_force_in_every_section(
    frames: int | None, spacing: float, ratio: float, law: str, error: float
) -> None:
    """The layer of voxels beside a glued end or another material has the error, the others a third of it."""
    force, energy = pulled(frames, spacing, ratio, law)
    np.testing.assert_allclose(force, 1, atol=error)
    assert np.median(np.abs(force - 1)) < error / 3
    assert energy == pytest.approx(1, abs=0.05)


@pytest.mark.parametrize("frames", [3, 10])
def test_a_cantilever_carries_its_weight(frames: int) -> None:
    labels = np.ones((24, 4, 6), int)
    volume = mf.Volume.from_labels(labels, 0.005, {1: mf.Material(4e5, 0.3, 1000)})
    body = mf.build(volume, frames, supports=[mf.Fixed(volume.side("-x"))])
    points = volume.centers
    stress = settled(mujoco.MjSpec.from_string(WEIGHT), body).stresses(points)
    load, second = 9.81 * 1000 * 0.02 * 0.03, 0.02 * 0.03**3 / 12
    for some in sections(points, 0)[:16]:
        arm, height = 0.12 - points[some[0], 0], points[some, 2] - 0.015
        bending = np.sum(stress[some, 0, 0] * height) * 0.005**2
        assert bending == pytest.approx(load * arm**2 / 2, rel=0.05)
    root = sections(points, 0)[1]
    top = root[points[root, 2] > 0.025]
    expected = load * (0.12 - points[root[0], 0]) ** 2 / 2 * (points[top[0], 2] - 0.015) / second
    assert np.mean(stress[top, 0, 0]) == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize("law", ["corotational", "neo_hookean"])
def test_a_free_body_of_one_material_strains_evenly(law: str) -> None:
    """Turned as well, to the six digits of the model; and turned alone, not at all."""
    volume = mf.Volume.from_labels(np.ones((12, 4, 4), int), 0.01, {1: SOFT})
    body = mf.build(volume, 3, law=law)
    model, data = in_space(body)
    view = mf.soft(model, data, "soft0")
    mujoco.mj_kinematics(model, data)
    turn, _ = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))
    turn *= np.linalg.det(turn)
    stresses = []
    for F in (turn, turn @ np.diag([1.02, 0.99, 1.005])):
        move_points(model, data, view, view.rest @ F.T + [1, 2, 3])
        mujoco.mj_forward(model, data)
        stresses.append(view.stresses(volume.centers))
    size = np.abs(stresses[1]).max()
    assert size > 0.01 * SOFT.young
    assert np.abs(stresses[0]).max() < 1e-9 * SOFT.young
    np.testing.assert_allclose(stresses[1], np.tile(stresses[1][0], (len(stresses[1]), 1, 1)), atol=1e-6 * size)


def test_rounding_makes_no_stress_in_bones() -> None:
    path = Path(__file__).parents[2] / "models" / "steak.npz"
    volume = mf.Volume.load(path)
    body = mf.build(volume, frames=3)
    assert body.fields.lifting is not None
    assert max(np.abs(share).max() for share in body.fields.lifting.share if share.size) < 10
    model, data = in_space(body)
    mujoco.mj_forward(model, data)
    view = mf.soft(model, data, "soft0")
    index = np.argwhere(volume.labels > 0)[::50]
    points = volume.origin + index * volume.spacing @ np.transpose(volume.axes)
    assert np.abs(view.stresses(points)).max() < 1e-3  # [Pa] at rest; 1 MPa where rounding moved the bone
    data.qpos[:] += 1e-3 * np.random.default_rng(0).normal(size=model.nq)
    mujoco.mj_forward(model, data)
    assert np.abs(view.stresses(points)).max() < 1e8  # [Pa]; 1e15 where it did
