"""Forces on material points: generalized forces of the same power, whatever the frames."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import mujoco
import numpy as np
import pytest
from builders import linked
from builders.lengthwise import block, centers
from builders.scenes import FLOOR, distort, in_space, lump

import mjframes as mf


def power(view: mf.Soft, data: mujoco.MjData, body: mf.SoftBody) -> tuple[float, float]:
    """qfrc · qvel, and Σ f · v."""
    points = centers(body)[::7]
    forces = np.random.default_rng(1).normal(size=points.shape)
    data.qfrc_applied[:] = 0
    view.apply_force(points, forces)
    return float(data.qfrc_applied @ data.qvel), float((forces * view.velocities(points)).sum())


@pytest.mark.parametrize(
    "made", [lump, partial(lump, method="paper"), partial(block, "neo_hookean")], ids=["modes", "paper", "law"]
)
def test_power_is_that_of_the_points(made: Callable[[], mf.SoftBody]) -> None:
    body = made()
    model, data = in_space(body)
    view = mf.soft(model, data, "soft0", body)
    distort(model, data, np.random.default_rng(0), speed=1.0)
    mujoco.mj_forward(model, data)
    given, taken = power(view, data, body)
    assert given == pytest.approx(taken, rel=1e-9)
    assert abs(taken) > 1e-3


@pytest.mark.parametrize("case", sorted(linked.CASES))
def test_power_on_links_and_of_every_frame_type(case: str) -> None:
    model, data = linked.scene(case)
    view = mf.soft(model, data, "soft0")
    rng = np.random.default_rng(2)
    data.qvel = rng.normal(size=model.nv)
    mujoco.mj_forward(model, data)
    given, taken = power(view, data, view.body)
    assert given == pytest.approx(taken, rel=1e-9)


def test_a_push_moves_the_body_by_its_mass() -> None:
    body = block()
    model, data = in_space(body)
    mujoco.mj_forward(model, data)
    view = mf.soft(model, data, "soft0", body)
    before = view.linear_momentum
    view.apply_force(centers(body)[:1], [[0.0, 0.0, 2.0]])
    mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    gained = view.linear_momentum - before - view.mass.sum() * model.opt.gravity * model.opt.timestep
    np.testing.assert_allclose(gained, [0, 0, 2.0 * model.opt.timestep], atol=1e-12)


@pytest.mark.parametrize(
    ("points", "forces", "words"),
    [
        ([[0.06, 0.02, 0.02]], [1.0, 2.0], "forces have the shape \\(2,\\); give one \\(x, y, z\\) in newtons"),
        ([[0.06, 0.02, 0.02]], [[np.nan, 0, 0]], "forces has numbers that are not finite; give newtons"),
        ([[9.0, 0, 0]], [[1.0, 0, 0]], "points\\[0\\] is .* voxels outside the volume"),
    ],
)
def test_wrong_forces_are_one_sentence(points: list, forces: list, words: str) -> None:
    model, data = in_space(block())
    mujoco.mj_forward(model, data)
    with pytest.raises(mf.MjframesError, match=words):
        mf.soft(model, data, "soft0", block()).apply_force(points, forces)
    assert not data.qfrc_applied.any()


def test_what_attach_returns_reads_the_body_back() -> None:
    spec = mujoco.MjSpec.from_string(FLOOR)
    attachment = mf.attach(spec, mf.build(block().fields.volume, 2), "steak", pos=(0, 0, 0.1))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    view = attachment.soft(model, data)  # nothing else holds the body
    points = centers(attachment.body)[:1]
    np.testing.assert_allclose(view.positions(points), points + np.array([0, 0, 0.1]), atol=1e-9)
