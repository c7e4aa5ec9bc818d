"""Drift of the energy as the step goes to zero: of a scheme of first order it halves with the step.

|E(t) − E(0)| in a short time, at its largest, relative to what moves; the order is the slope of its logarithm. The step
damps fast vibrations to nothing, there is no order where most of the energy is lost. Energy that is made stays as
h → 0 where the force is not that of an energy.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.stability.energy.motions import bent, throw
from benchmarks.stability.energy.world import World, run

STEPS = (2e-3, 1e-3, 5e-4, 2.5e-4)  # [s]
SECONDS = 0.2  # [s]
LOST = 0.5  # [-] of the energy
MOTIONS = ("thrown", "disturbed")


@dataclass(frozen=True)
class Drift:
    """Drift of the energy [-] at each of `STEPS`, and the most that was made at each [-]."""

    drift: tuple[float, ...]
    made: tuple[float, ...]

    @property
    def order(self) -> float:
        """Return the slope of log drift over log h, between the two shortest steps; NaN where most is lost, or none."""
        last, best = self.drift[-2:]
        return float(np.log2(last / best)) if 0 < best <= last < LOST else np.nan


def drift(world: World, motion: str, seed: int) -> Drift:
    """Return the drift of one of `MOTIONS`."""
    found, made = [], []
    for timestep in STEPS:
        world.reset(timestep)
        if motion == "thrown":
            throw(world, seed)
        else:
            world.move(bent(world, np.random.default_rng(seed)))
        course = run(world, SECONDS)
        change = (course.total - course.total[0]) / course.total[0]
        found.append(float(np.abs(change).max()) if course.finite else np.inf)
        made.append(float(change.max()) if course.finite else np.inf)
    return Drift(tuple(found), tuple(made))
