"""Free flight of a bar that turns and vibrates: what it keeps, and how fast the rest converges with the step.

In explicit mode MuJoCo integrates the elastic forces −∂W/∂x as they are. They have no resultant and no moment, so
linear momentum is kept to rounding; energy converges with the integrator's order, 1 for Euler and 4 for RK4, and so
does angular momentum. Where frames are affine, Euler keeps that one to rounding too: v⁺ = v + h M⁻¹ f, x⁺ = x + h v⁺
gives Σ m x⁺ × v⁺ = Σ m x × v. Rigid frames have ball joints: there all three converge, with order 1; for RK4
2, and 4 since MuJoCo 4.
Run `python examples/flight.py --out out`; it needs matplotlib (`pip install "mjframes[plot]"`).
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

import mjframes as mf

LAWS = ("corotational", "green_lagrange", "neo_hookean", "mooney_rivlin", "arruda_boyce")
INTEGRATORS = {"Euler": mujoco.mjtIntegrator.mjINT_EULER, "RK4": mujoco.mjtIntegrator.mjINT_RK4}
DURATION = 0.08  # [s]: a third of a turn and a few vibrations
LOOKS = 16  # how often the conserved quantities are looked at
STEPS = {"Euler": (1280, 2560, 5120, 10240), "RK4": (320, 448, 640, 896)}
SPIN, DRIFT = np.array([12.0, -9.0, 15.0]), np.array([1.0, 2.0, 3.0])  # [rad/s], [m/s]
VIBRATION = 0.4  # [m/s]


@dataclass(frozen=True, eq=False)
class Flight:
    """The largest deviations on the way, each for a number of steps.

    step: h (n,) [s].  momentum, spin, energy: (n,) [-] of linear and angular momentum and of energy, relative to
    Σ m |v|, Σ m |x × v| and the energy at the start.
    """

    step: NDArray[np.float64]
    momentum: NDArray[np.float64]
    spin: NDArray[np.float64]
    energy: NDArray[np.float64]

    def order(self, errors: NDArray[np.float64]) -> float:
        """Slope of log error over log h."""
        return float(np.polyfit(np.log(self.step), np.log(errors), 1)[0])


@cache
def bar(law: str, frame_type: str = "affine") -> mf.SoftBody:
    """0.24 m × 0.06 m × 0.06 m, two layers, three frames, explicit mode."""
    labels = np.ones((24, 6, 6), int)
    labels[:, 3:] = 2
    materials = {1: mf.Material(5e3, 0.35, 1000), 2: mf.Material(15e3, 0.3, 1200)}
    volume = mf.Volume.from_labels(labels, 0.01, materials)
    return mf.build(volume, 3, law=law, frame_type=frame_type, mode="explicit")


def fly(law: str, integrator: str, frame_type: str = "affine") -> Flight:
    """The same flight with ever smaller steps."""
    spec = mujoco.MjSpec()
    spec.option.gravity = [0, 0, 0]
    spec.option.integrator = INTEGRATORS[integrator]
    mf.attach(spec, bar(law, frame_type), "bar", contact=False)
    model = spec.compile()
    errors = []
    for steps in STEPS[integrator]:
        model.opt.timestep = DURATION / steps
        data = mujoco.MjData(model)
        view = mf.soft(model, data, "bar")
        _throw(model, data, view)
        start = _kept(view)
        size = np.abs(start).sum(axis=1)
        worst = np.zeros(3)
        for _ in range(LOOKS):
            mujoco.mj_step(model, data, nstep=steps // LOOKS)
            mujoco.mj_forward(model, data)
            change = np.abs(_kept(view) - start).max(axis=1)
            worst = np.maximum(worst, change / size)
        errors.append(worst)
    momentum, spin, energy = np.array(errors).T
    return Flight(DURATION / np.array(STEPS[integrator]), momentum, spin, energy)


def _throw(model: mujoco.MjModel, data: mujoco.MjData, view: mf.Soft) -> None:
    """Spin, drift and vibration at rest's shape; ends with mj_forward."""
    mujoco.mj_forward(model, data)
    x = view.control_positions
    noise = VIBRATION * np.random.default_rng(0).normal(size=x.shape)
    wanted = DRIFT + np.cross(SPIN, x - x.mean(axis=0)) + noise
    jacobian = np.zeros((len(x), 3, model.nv))
    for j, (body, at) in enumerate(zip(view.bodies, x, strict=True)):
        mujoco.mj_jac(model, data, jacobian[j], None, at, int(body))
    data.qvel[:] = np.linalg.lstsq(jacobian.reshape(-1, model.nv), wanted.ravel())[0]
    mujoco.mj_forward(model, data)


def _kept(view: mf.Soft) -> NDArray[np.float64]:
    """Linear [kg m/s] and angular momentum [kg m²/s], energy and twice 0 [J]: (3, 3)."""
    energy = view.kinetic_energy + view.elastic_energy
    return np.array([view.linear_momentum, view.angular_momentum, [energy, 0, 0]])


def run(out: Path) -> dict[tuple[str, str], Flight]:
    """Write flight.png to `out`; the flights with affine frames by law and integrator."""
    from matplotlib.figure import Figure

    out.mkdir(parents=True, exist_ok=True)
    flights = {(law, name): fly(law, name) for law in LAWS for name in INTEGRATORS}
    figure = Figure(figsize=(11, 4.6), layout="constrained")
    panels = figure.subplots(1, 2, sharey=True)
    for axes, what in zip(panels, ("energy", "spin"), strict=True):
        for (law, name), flight in flights.items():
            errors, style = getattr(flight, what), {"Euler": "o-", "RK4": "s--"}[name]
            exact = errors.max() < 1e-11
            label = f"{law}, {name}: " + ("rounding" if exact else f"order {flight.order(errors):.2f}")
            axes.loglog(flight.step, errors, style, color=f"C{LAWS.index(law)}", label=label)
        axes.set_xlabel("h [s]")
        axes.set_title({"energy": "energy", "spin": "angular momentum"}[what], loc="left")
        axes.legend(fontsize=7)
        axes.grid(alpha=0.3)
    panels[0].set_ylabel("largest relative deviation")
    figure.savefig(out / "flight.png", dpi=110)
    return flights


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder to write to (default: out)")
    for (law, name), flight in run(parser.parse_args().out).items():
        orders = f"energy {flight.order(flight.energy):.2f}, angular momentum {flight.order(flight.spin):.2f}"
        print(f"{law}, {name}: orders {orders}; linear momentum to {flight.momentum.max():.0e}")
