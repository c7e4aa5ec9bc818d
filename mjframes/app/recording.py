"""What a run of a scene was: its instants, their energies, what it came to."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

STILL = 1e-6  # [m], [rad] that all has to fall, or a coordinate to go, for an energy that is worth a number
STATE = ("qpos", "qvel", "act", "ctrl")
NOTABLE = 1e-3  # [-] of the energy that moved: a smaller gain is not worth a number
DRIVEN = "; the work of the actuators is in it"
ELASTIC_ALONE = ", of elastic energy alone: steps that turn very stiff bodies stretch them a little"


@dataclass(frozen=True, eq=False)
class State:
    """The state that a step starts from: time [s], and STATE as MjData has them."""

    time: float
    qpos: np.ndarray
    qvel: np.ndarray
    act: np.ndarray
    ctrl: np.ndarray


@dataclass(frozen=True, eq=False)
class Instant:
    """What is measured at an instant.

    time: [s].  kinetic, potential: of everything [J].
    elastic, soft_kinetic: of each soft body, by name [J].  contacts: how many.
    penetration: the deepest in the steps since the instant before, 0 where nothing touched [m].
    normal_force: sum over contacts [N].  soft_force: sum over the contacts of each soft body, by name [N]; one between
    two of them counts for both.  rigid_force: sum over contacts of rigid geoms alone [N].
    speed: of the fastest body's centre of mass [m/s].
    """

    time: float
    kinetic: float
    potential: float
    elastic: dict[str, float]
    soft_kinetic: dict[str, float]
    contacts: int
    penetration: float
    normal_force: float
    soft_force: dict[str, float]
    rigid_force: float
    speed: float

    @property
    def total(self) -> float:
        """Kinetic + potential + elastic energy [J]."""
        return self.kinetic + self.potential + sum(self.elastic.values())


@dataclass(frozen=True, eq=False)
class Recording:
    """What a run gave.

    instants: at most RECORDS of them, evenly spread.  states: at these instants; of a log, those that it has.
    steps: number of `mj_step` calls.  seconds: wall time in them, NaN where that is not known.  timestep: [s].
    weight: of all that moves [N].
    log_seconds: wall time that a log took, NaN without one.  driven: whether actuators ever pushed; not in a log.
    """

    instants: tuple[Instant, ...]
    states: tuple[State, ...]
    steps: int
    seconds: float
    timestep: float
    weight: float
    log_seconds: float = math.nan
    driven: bool = False

    @property
    def steps_per_second(self) -> float:
        """Of `mj_step` alone, without drawing and logging."""
        return self.steps / self.seconds

    @property
    def real_time_factor(self) -> float:
        """Simulated time per wall time in `mj_step`."""
        return self.steps * self.timestep / self.seconds

    @property
    def penetration(self) -> float:
        """The deepest of the run [m]."""
        return max(instant.penetration for instant in self.instants)

    @property
    def final_penetration(self) -> float:
        """The deepest of the last second [m]."""
        end = self.instants[-1].time
        return max(instant.penetration for instant in self.instants if instant.time > end - 1)

    @property
    def energy(self) -> np.ndarray:
        """(k,) total energy at the instants [J]."""
        return np.array([instant.total for instant in self.instants])

    @property
    def motion(self) -> np.ndarray:
        """(k,) kinetic and potential energy at the instants [J]."""
        return np.array([instant.kinetic + instant.potential for instant in self.instants])

    @property
    def energy_scale(self) -> float:
        """The largest kinetic energy, or difference of potential ones, or of elastic ones where actuators drive [J]."""
        stored = [(instant.potential, self.driven * sum(instant.elastic.values())) for instant in self.instants]
        return max(max(instant.kinetic for instant in self.instants), float(np.ptp(stored, axis=0).max()))

    @property
    def farthest(self) -> float:
        """How far a coordinate could go at the largest speed of any [m], [rad]; infinite without states."""
        fastest = max((float(np.abs(one.qvel).max(initial=0.0)) for one in self.states), default=math.inf)
        return self.steps * self.timestep * fastest

    @property
    def motion_gain(self) -> float:
        """The most by which kinetic and potential energy together exceed the total energy of the start [J].

        Without the elastic energy, which is nothing to rely on where a material is very stiff: a step h that turns such
        a body by ω h stretches it by (ω h)²/2, and it stays so while it turns.
        """
        return max(0.0, float((self.motion - self.energy[0]).max()))

    @property
    def energy_gain(self) -> float:
        """The most by which the total energy ever exceeds that of the start [J]; 0 for a passive scene."""
        return float((self.energy - self.energy[0]).max())


def summary(recording: Recording) -> str:
    """The lines that `mjframes run` prints."""
    lines = [
        f"steps         {recording.steps} of {recording.timestep * 1e3:g} ms",
        f"speed         {recording.steps_per_second:.0f} steps/s, {recording.real_time_factor:.2f} × real time",
        f"penetration   {recording.penetration * 1e3:.3f} mm at most, "
        f"{recording.final_penetration * 1e3:.3f} mm in the last second",
        f"energy        {_balance(recording)}",
    ]
    if not math.isnan(recording.log_seconds):
        lines.append(f"log           {1e6 * recording.log_seconds / recording.steps:.1f} µs a step")
    return "\n".join(lines)


def _balance(recording: Recording) -> str:
    """What became of the energy that moved, in words."""
    scale = recording.energy_scale
    if scale <= STILL * recording.weight or recording.farthest <= STILL:
        return "nothing moved"
    change = recording.energy[0] - recording.energy[-1]
    end = f"{change:.3g} J less" if change >= 0 else f"{-change:.3g} J more"
    gain = recording.energy_gain
    above = f"{gain:.2g} J ({gain / scale:.1%})" if gain > NOTABLE * scale else "never"
    alone = recording.motion_gain <= NOTABLE * scale < gain
    why = DRIVEN if recording.driven and gain > NOTABLE * scale else ELASTIC_ALONE if alone else ""
    return (
        f"{scale:.3g} J moved; kinetic, potential and elastic energy are {end} at the end than at the start, "
        f"and {above} above it in between{why}"
    )
