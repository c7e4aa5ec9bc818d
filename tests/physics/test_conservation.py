"""Rigid motions are free of force; free flight keeps what it should, to rounding or with the integrator's order."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest
from builders.pictures import picture, share
from builders.scenes import TILTED, compiled, in_space, move_points
from builders.tiers import tiered
from scipy.spatial.transform import Rotation

from benchmarks.stability.check import cases
from benchmarks.stability.states import jacobian, move_with
from examples import flight
from mjframes.body.build import build
from mjframes.elasticity.law_table import LAWS
from mjframes.scene.view import soft
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

HALF_TURNS = np.pi * np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.6, 0.8, 0], [0.6, 0, -0.8]])
ORDERS = {"Euler": 1, "RK4": 4}
QUICK = ("corotational", "neo_hookean")
FLOWN = tiered(flight.LAWS, lambda law: law not in QUICK)


@pytest.mark.parametrize("law", flight.LAWS)
def test_rigid_motions_are_free_of_force(law: str) -> None:
    model, data = in_space(flight.bar(law))
    view = soft(model, data, "soft0")
    mujoco.mj_forward(model, data)
    x = view.control_positions
    firmness = max(np.abs(region.response(x[region.points])[1]).max() for region in view.regions)
    for turn in [*Rotation.from_rotvec(HALF_TURNS), *Rotation.random(50, rng=np.random.default_rng(0))]:
        move_points(model, data, view, x @ turn.as_matrix().T + [2, -1, 3])
        mujoco.mj_forward(model, data)
        force = np.abs(data.qfrc_passive).max()
        assert force < 1e-10  # [N]
        assert force < 1e-12 * firmness * np.ptp(x)  # of what it takes to move a point as far as the body is long


flown = cache(flight.fly)


@pytest.mark.parametrize("integrator", ORDERS)
@pytest.mark.parametrize("law", FLOWN)
def test_free_flight_keeps_linear_momentum(law: str, integrator: str) -> None:
    assert flown(law, integrator).momentum.max() < 1e-12


@pytest.mark.parametrize("name", ["corotational", "neo-hookean", "mixed frames"])
def test_a_stiff_body_falls_with_the_momentum_of_its_mass(name: str) -> None:
    """At 1e12 Pa and 1/30 s h²K/m is 3e11: rounding errors of K, if they pushed or had mass, would show within a step.

    With K on the velocity that all points share 5e-3 to 2e-2, with what K sums to on translations in d->M 1e-4 to 6e-4.
    """
    made = cases.body(next(kind for kind in cases.KINDS if kind.name == name), 1e12)
    scene = "<mujoco><option gravity='2 -3 -9' timestep='0.03333'/></mujoco>"
    model, data = compiled(scene, (made, (0.1, 0.2, 0.3), TILTED), contact=False)
    mujoco.mj_forward(model, data)
    move_with(soft(model, data, "soft0"), np.array([7.0, -5.0, 3.0]))
    mujoco.mj_forward(model, data)
    start, error = momentum(model, data), []
    for step in range(1, 1001):
        mujoco.mj_step(model, data)
        mujoco.mj_forward(model, data)
        expected = start + model.body_subtreemass[1] * model.opt.gravity * step * model.opt.timestep
        error.append(np.linalg.norm(momentum(model, data) - expected) / np.linalg.norm(start))
    assert max(error) < 1e-12  # 2e-14 to 1e-13


@pytest.mark.parametrize("young", [1e5, 1e7])
@pytest.mark.parametrize("law", LAWS)
def test_the_implicit_step_of_a_law_at_quadrature_points_keeps_angular_momentum(law: str, young: float) -> None:
    """Where K saw how the stretched body turns, 0.14 of it were lost in a second at 1e5 Pa and 0.8 at 1e7."""
    volume = Volume.from_labels(np.ones((12, 4, 4), int), 0.02, {1: Material(young, 0.4, 1000)})
    model, data = in_space(build(volume, 3, method="paper", law=law))
    view = soft(model, data, "soft0")
    mujoco.mj_forward(model, data)
    x = view.control_positions
    spin = np.cross([1.0, 3.0, -3.8], x - view.mass @ x / view.mass.sum())
    data.qvel[:] = np.linalg.lstsq(jacobian(view), spin.ravel(), rcond=None)[0]
    mujoco.mj_forward(model, data)
    start = view.angular_momentum
    mujoco.mj_step(model, data, nstep=500)
    mujoco.mj_forward(model, data)
    assert np.linalg.norm(view.angular_momentum - start) < 1e-6 * np.linalg.norm(start)


def momentum(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Of the scene's first body and all below (3,) [kg m/s]."""
    mujoco.mj_subtreeVel(model, data)
    return model.body_subtreemass[1] * data.subtree_linvel[1]


@pytest.mark.parametrize("law", FLOWN)
def test_euler_converges_with_order_1_and_keeps_angular_momentum(law: str) -> None:
    found = flown(law, "Euler")
    assert found.order(found.energy) == pytest.approx(1, abs=0.03)
    assert found.energy[-1] < 1e-5
    assert found.spin.max() < 1e-12


@pytest.mark.parametrize("law", FLOWN)
def test_rk4_converges_with_order_4(law: str) -> None:
    found = flown(law, "RK4")
    assert found.order(found.spin) == pytest.approx(4, abs=0.1)
    # energy gains an order: with λ = iω, |Σ_n≤4 (λh)ⁿ/n!|² = 1 − (ωh)⁶/72 in a step, h⁵ in a time
    assert 3.9 < found.order(found.energy) < 5.2
    assert found.energy[-1] < 1e-11


def test_rigid_frames_converge_as_balls_are_integrated() -> None:
    """Linear momentum too: it depends on the joints' angles. RK4 comes to the six digits of the bodies' inertia."""
    found, exact = (flown("corotational", integrator, "rigid") for integrator in ("Euler", "RK4"))
    for errors, rest in zip(*((some.momentum, some.energy, some.spin) for some in (found, exact)), strict=True):
        assert found.order(errors) == pytest.approx(1, abs=0.05)
        assert rest.max() < 1e-6


@pytest.mark.parametrize("laws", [QUICK, pytest.param(flight.LAWS, marks=pytest.mark.slow)])
def test_the_example_draws_all_of_them(laws: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(flight, "fly", flown)
    monkeypatch.setattr(flight, "LAWS", laws)
    flights = flight.run(tmp_path)
    assert len(flights) == len(flight.LAWS) * len(ORDERS)
    shown = picture(tmp_path / "flight.png")
    assert min(share(shown, f"C{number}") for number in range(len(flight.LAWS))) > 3e-4
