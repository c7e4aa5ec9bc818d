"""Why a run does not survive or recover, told from what was measured of it."""

from __future__ import annotations

from dataclasses import dataclass

from benchmarks.stability.check.cases import IMPACT, LENGTH
from benchmarks.stability.check.evidence import FAST
from benchmarks.stability.check.trial import BALANCED, IMPACT_SPEED, Outcome

ROUNDED = 1e-3  # [-] of the mass, lost to rounding errors of h²K

PASSED = "passed the floor: deep in it when a step finds the contact, and what pushes it out deforms it as much again"
SPUN = "spun up: a rigid frame turns so far in a step that torques held over the step give it energy"
DIGITS = "lost digits: rounding errors of h²K are no longer small beside the mass"
GREW = "gained energy from step to step"
INVERTED = "rests inverted: elastic forces vanish with voxels turned inside out, another minimum of the energy"
FOLDED = "rests in another shape: elastic forces vanish with no voxel turned inside out"
MOVING = "still moving when the time is up"

LETTERS = {PASSED: "P", SPUN: "S", DIGITS: "D", GREW: "G", INVERTED: "I", FOLDED: "O", MOVING: "M"}  # of the map


@dataclass(frozen=True)
class Reason:
    """Why a run does not recover.

    kind: a sentence that runs share.
    numbers: what was measured of this one.
    """

    kind: str
    numbers: str


def reason(outcome: Outcome) -> Reason:
    """Return why a run does not recover."""
    return _of_lost(outcome) if outcome.evidence.end is None else _of_end(outcome)


def _of_lost(outcome: Outcome) -> Reason:
    case, evidence = outcome.case, outcome.evidence
    grown = f"energy × {outcome.gain:.2g} until it is lost at step {evidence.steps}"
    if outcome.warning:
        grown += f" ({outcome.warning})"
    if evidence.sank and (not evidence.spun or evidence.sank <= evidence.spun):
        deep = f"{evidence.depth:.3g} lengths deep, by one from step {evidence.sank} on"
        reach = f", {case.timestep * IMPACT_SPEED / LENGTH:.3g} lengths a step" if case.disturbance == IMPACT else ""
        return Reason(PASSED, f"its middle {deep}{reach}; {grown}")
    if evidence.spun:
        return Reason(SPUN, f"a rigid frame turns {FAST} rad a step from step {evidence.spun} on; {grown}")
    if evidence.rounding > ROUNDED:
        return Reason(
            DIGITS,
            f"h²K/m reaches {evidence.stiffness:.1e}, its rounding errors {evidence.rounding:.1e} of the mass; {grown}",
        )
    return Reason(GREW, f"{grown}; h²K/m = {evidence.stiffness:.1e}")


def _of_end(outcome: Outcome) -> Reason:
    end = outcome.evidence.end
    assert end is not None
    shape = f"shape error {outcome.error:.2g}"
    if end.force > BALANCED:
        moving = (
            f"after {outcome.evidence.time:.3g} s with {end.speed:.1e} lengths/s and forces of {end.force:.1e} E ℓ²"
        )
        return Reason(MOVING, f"{moving}; {shape}, {end.earlier:.2g} at half of that time")
    energy = f"elastic energy {end.energy:.1e} E V"
    points, voxels = end.inverted
    if points == voxels == 0:
        return Reason(FOLDED, f"{energy}; {shape}")
    where = f"{voxels} of {end.voxels} voxels and {points} of {end.samples} points where the law is evaluated"
    return Reason(INVERTED, f"det F < 0 at {where}, {energy}; {shape}")
