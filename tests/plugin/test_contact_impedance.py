"""How deep a soft body sinks under its own weight: MuJoCo's formula with the mass of the body.

At rest a constraint row has J q̈ = 0, so f A (1 − imp)/imp = imp k · depth, with A = 1/m where the body lies flat and
MuJoCo's stiffness k = 1/(dmax τ ζ)².
"""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from builders.scenes import FLOOR, compiled
from builders.stacked import block

from mjframes.scene.contact import Contact

SIDE, TIME_CONSTANT = 0.06, 0.02  # [m], [s]


@pytest.mark.parametrize("impedance", [0.5, 0.9, 0.99])
@pytest.mark.parametrize("density", [100, 3000])
def test_the_ratio_of_regularization_is_the_one_asked_for(density: float, impedance: float) -> None:
    contact = Contact(condim=1, solref=(TIME_CONSTANT, 1), solimp=(impedance, impedance), priority=1, dents=False)
    model, data = compiled(FLOOR, (block((6, 6, 6), 0.01, density, 0.005), (0, 0, 0), (1, 0, 0, 0)), contact=contact)
    for _ in range(3000):
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    assert np.abs(data.qvel).max() < 1e-6
    assert data.ncon == 4
    force = data.efc_force[data.contact.efc_address]
    assert force.sum() == pytest.approx(9.81 * density * SIDE**3, rel=1e-5)
    stiffness = impedance / (impedance * TIME_CONSTANT) ** 2
    realized = -data.contact.dist * stiffness / (force / (density * SIDE**3))
    np.testing.assert_allclose(realized, (1 - impedance) / impedance, rtol=1e-4)


@pytest.mark.parametrize("timestep", [0.002, 0.005, 0.008, 0.02])
def test_a_time_constant_is_never_below_two_timesteps(timestep: float) -> None:
    """As MuJoCo sees to unless refsafe is disabled: k = 1/(dmax τ ζ)² of every row."""
    for disabled, shortest in ((0, 2 * timestep), (mujoco.mjtDisableBit.mjDSBL_REFSAFE, 0.0)):
        body = (block((6, 6, 6), 0.01, 1000), (0, 0, -0.001), (1, 0, 0, 0))
        model, data = compiled(FLOOR, body, contact=Contact(priority=1, dents=False), timestep=timestep)
        model.opt.disableflags = disabled
        mujoco.mj_forward(model, data)
        assert data.nefc > 3
        stiffness = 1 / (0.95 * max(0.01, shortest)) ** 2
        np.testing.assert_allclose(data.efc_KBIP[:, 0], stiffness)


@pytest.mark.parametrize("cone", ["pyramidal", "elliptic"])
def test_contacts_give_way_alike_with_the_exact_diagonal_enabled(cone: str) -> None:
    """Theirs is the plugin's, whatever MuJoCo takes its own for."""
    scene = FLOOR.replace("<mujoco>", f'<mujoco><option cone="{cone}"/>')
    body = (block((6, 6, 6), 0.01, 1000), (0, 0, -0.001), (1, 0, 0, 0))
    model, data = compiled(scene, body, contact=Contact(priority=1))
    resistances = []
    for enabled in (0, mujoco.mjtEnableBit.mjENBL_DIAGEXACT):
        model.opt.enableflags = enabled
        mujoco.mj_forward(model, data)
        resistances.append(data.efc_R.copy())
    assert len(resistances[0]) > 3
    np.testing.assert_allclose(resistances[1], resistances[0], rtol=1e-9)
