"""What goes wrong in a run is said once, with what helps: energy from nothing, bodies that grow, fold over, or overlap.

A soft body that floats free has the energy E = kinetic + elastic + potential, and gets the work W = Σ h f · q̇ of all
forces but its own and gravity's: contacts, actuators, what users apply, each step's at the step's end. E − W grows by
nothing but what a step's turn stretches (A φ⁴, which goes with the turn) and what the elasticity makes up. So scenes
that are driven alarm nobody. Bodies that hang on what moves get energy through that, and are not asked for it.
"""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjframes.app.overlaps import Overlaps
from mjframes.app.recording import STILL, Instant
from mjframes.scene.instability import GROWN, warn, warn_inside, warn_shared
from mjframes.scene.view import Soft

GAIN = 0.1  # [-] of the energy that moved: what a body may have more than it got
ANGLE = 0.1  # [rad] of the turn that A is found from
ROUNDING = 2.0**-52  # [-] of the energy of a body twice as large: terms like that are summed, at rest to 0 and an error
TURNING = 2.0  # [-] of A φ⁴ that a step's turn may have stretched (benchmarks/stability/energy/motions.py)
FOLDED = 0.5  # [s] that a region may be folded over


class Watch:
    """Watches the soft bodies of a run.

    model, data, bodies: as they are stepped, the soft ones by name.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, bodies: Mapping[str, Soft]) -> None:
        self._bodies = [_Watched(name, body) for name, body in bodies.items()]
        self._overlaps = Overlaps(model, bodies)
        self._data = data
        self._told: set[tuple[str, str]] = set()
        self._started = False

    def look(self, instant: Instant) -> None:
        """Warn (InstabilityWarning) of what is wrong at the start of the step that was made last."""
        for body in self._bodies:
            body.look(instant)
        if not self._started:
            self._started = True
            for pair, share in self._overlaps.shared(self._data).items():
                self._told.add(pair)
                warn_shared(*pair, share)
        for pair, depth in self._overlaps.find(self._data).items():
            if pair not in self._told:
                self._told.add(pair)
                warn_inside(*pair, depth, f"at {instant.time:.3g} s")

    def step(self) -> None:
        """Count the work of the step that was made last; call it after `look`."""
        for body in self._bodies:
            body.count_work()


class _Watched:
    """A soft body, and what is known of it from earlier in the run."""

    def __init__(self, name: str, body: Soft) -> None:
        self._name, self._soft, self._model, self._data = name, body.quiet(), body.model, body.data
        self._carriers = np.unique(body.bodies)
        self._dofs = np.flatnonzero(np.isin(self._model.dof_bodyid, self._carriers))
        self._asked = _is_free(body, self._carriers, self._dofs)
        self._turning = _turning(body) if self._asked else 0.0
        self._rounding = ROUNDING * body.elastic_energy_at(2 * body.rest) if self._asked else 0.0
        self._work = self._start = self._moved = 0.0
        self._folded_since: float | None = None
        self._seen = False
        self._told: set[str] = set()

    def count_work(self) -> None:
        if self._asked:
            data, some = self._data, self._dofs
            others = data.qfrc_smooth[some] - data.qfrc_passive[some] + data.qfrc_bias[some]
            force = others + data.qfrc_constraint[some]
            self._work += self._model.opt.timestep * float(force @ data.qvel[some])

    def look(self, instant: Instant) -> None:
        if self._asked and "energy" not in self._told:
            self._look_at_energy(instant)
        if (ratio := self._soft.size_ratio) > GROWN:
            self._tell("size", f"is {ratio:.2g} times as large as at rest at {instant.time:.3g} s")
        if not self._soft.is_folded:
            self._folded_since = None
        elif self._folded_since is None:
            self._folded_since = instant.time
        elif instant.time - self._folded_since >= FOLDED:
            self._tell("fold", f"has been folded over, inside out, since {self._folded_since:.3g} s")

    def _look_at_energy(self, instant: Instant) -> None:
        mass, data = self._model.body_mass[self._carriers], self._data
        potential = -float(mass @ data.xipos[self._carriers] @ self._model.opt.gravity)
        kinetic, elastic = instant.soft_kinetic[self._name], instant.elastic[self._name]
        energy = kinetic + elastic + potential - self._work
        if not self._seen:
            self._seen, self._start, self._moved = True, energy, elastic
        weight = float(mass.sum() * np.linalg.norm(self._model.opt.gravity))
        self._moved = max(self._moved, kinetic, abs(self._work), STILL * weight)
        made = energy - self._start
        least = max(GAIN * self._moved, self._rounding)
        if made > least and made - self._stretched() > least:
            self._tell("energy", f"has made {made:.2g} J of energy from nothing by {instant.time:.3g} s")

    def _stretched(self) -> float:
        """What the last step's turn may have stretched [J]."""
        mass, x = self._soft.mass, self._soft.control_positions
        arm = x - mass @ x / mass.sum()
        momentum = np.cross(arm, self._soft.control_velocities).T @ mass
        second = np.einsum("k,ka,kb->ab", mass, arm, arm)
        rate = np.linalg.lstsq(np.trace(second) * np.eye(3) - second, momentum, rcond=None)[0]
        return TURNING * self._turning * float(np.linalg.norm(rate) * self._model.opt.timestep) ** 4

    def _tell(self, what: str, sentence: str) -> None:
        if what not in self._told:
            self._told.add(what)
            warn(f"{self._name!r} {sentence}")


def _is_free(body: Soft, carriers: NDArray[np.int64], dofs: NDArray[np.int64]) -> bool:
    """Whether its own coordinates are all that moves the body, and a step's work is known."""
    model = body.model
    above, moved = int(body.holder), True
    while above > 0:
        moved &= not model.body_jntnum[above] and model.body_mocapid[above] < 0
        above = int(model.body_parentid[above])
    slides = (model.jnt_type[model.dof_jntid[dofs]] == mujoco.mjtJoint.mjJNT_SLIDE).all()
    own = (model.body_jntnum[carriers] > 0).all() and not model.body_gravcomp[carriers].any()
    return bool(moved and slides and own and model.opt.integrator != mujoco.mjtIntegrator.mjINT_RK4)


def _turning(body: Soft) -> float:
    """A [J/rad⁴]: a step that turns the body by φ stretches it by the energy A φ⁴, largest over the axes."""
    turned = [body.elastic_energy_at(body.rest + np.cross(ANGLE * axis, body.rest)) for axis in np.eye(3)]
    return max(turned) / ANGLE**4
