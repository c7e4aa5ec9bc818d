"""How deep a soft body sinks under its own weight: MuJoCo's formula for a rigid body of its mass, at any step.

At rest a constraint row has J q̈ = 0, so f/m (1 − imp)/imp = imp k · depth, with MuJoCo's stiffness k = 1/(dmax τ ζ)².
"""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from builders.scenes import FLOOR, compiled
from builders.stacked import block

from mjframes.body.build import build
from mjframes.scene.contact import Contact
from mjframes.scene.view import soft
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

SIDE, TIME_CONSTANT = 0.06, 0.02  # [m], [s]


@pytest.mark.parametrize("impedance", [0.5, 0.9, 0.99])
@pytest.mark.parametrize(("density", "timestep"), [(100, 2e-3), (3000, 2e-3), (3000, 2.5e-4)])
def test_the_ratio_of_regularization_is_the_one_asked_for(density: float, timestep: float, impedance: float) -> None:
    contact = Contact(condim=1, solref=(TIME_CONSTANT, 1), solimp=(impedance, impedance), priority=1)
    placed = block((6, 6, 6), 0.01, density, 0.005), (0, 0, 0), (1, 0, 0, 0)
    model, data = compiled(FLOOR, placed, contact=contact, timestep=timestep)
    for _ in range(round(6 / timestep)):
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    assert np.abs(data.qvel).max() < 1e-6
    assert data.ncon == 4
    force = data.efc_force[data.contact.efc_address]
    assert force.sum() == pytest.approx(9.81 * density * SIDE**3, rel=1e-5)
    stiffness = impedance / (impedance * TIME_CONSTANT) ** 2
    realized = -data.contact.dist * stiffness * density * SIDE**3 / force
    np.testing.assert_allclose(realized, (1 - impedance) / impedance, rtol=1e-4)


@pytest.mark.parametrize("timestep", [0.002, 0.005, 0.008, 0.02])
def test_a_time_constant_is_never_below_two_timesteps(timestep: float) -> None:
    """As MuJoCo sees to unless refsafe is disabled: k = 1/(dmax τ ζ)² of every row."""
    for disabled, shortest in ((0, 2 * timestep), (mujoco.mjtDisableBit.mjDSBL_REFSAFE, 0.0)):
        body = (block((6, 6, 6), 0.01, 1000), (0, 0, -0.001), (1, 0, 0, 0))
        model, data = compiled(FLOOR, body, contact=Contact(priority=1), timestep=timestep)
        model.opt.disableflags = disabled
        mujoco.mj_forward(model, data)
        assert data.nefc > 3
        stiffness = 1 / (0.95 * max(0.01, shortest)) ** 2
        np.testing.assert_allclose(data.efc_KBIP[:, 0], stiffness)


@pytest.mark.parametrize("timestep", [5e-4, 4e-3])
def test_it_creeps_on_a_slope_no_more_than_a_rigid_box(timestep: float) -> None:
    slope = np.radians(20)
    gravity = (9.81 * np.sin(slope), 0, -9.81 * np.cos(slope))
    box = '<body pos="0.5 0 0.02"><freejoint/><geom type="box" size=".04 .03 .02" density="1000"/></body></worldbody>'
    slab = block((16, 12, 8), 0.005, 1000), (0, 0, 0), (1, 0, 0, 0)
    model, data = compiled(FLOOR.replace("</worldbody>", box), slab, timestep=timestep, gravity=gravity)
    places = []
    for second in (1, 2):
        while data.time < second:
            mujoco.mj_step(model, data)
        places.append((data.qpos[0], soft(model, data, "soft0").control_positions[:, 0].mean()))
    rigid, creeps = np.diff(places, axis=0)[0]
    assert 0 < creeps < rigid


def test_a_slippery_body_comes_to_rest() -> None:
    # with R ∝ μ² (1 + μ²) the rows of a pyramid are all but rigid and all but the same: 3 mm/s, for ever
    body = build(Volume.from_labels(np.ones((16, 12, 8), int), 0.005, {1: Material(3e4, 0.3, 1000)}), 3)
    floor = FLOOR.replace("/>", ' friction="0.01 0.005 1e-4"/>')
    placed = body, (0, 0, 0), (1, 0, 0, 0)
    model, data = compiled(floor, placed, contact=Contact(friction=(0.01, 0.005, 1e-4)), timestep=2e-3)
    for _ in range(1000):
        mujoco.mj_step(model, data)
    assert np.abs(data.qvel).max() < 1e-6
