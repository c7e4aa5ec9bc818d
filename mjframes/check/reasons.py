"""Why a run does not survive or recover, from what is known of it."""

from __future__ import annotations

from mjframes.check.cases import DENSITY, FRAMES, IMPACT, LENGTH, Case
from mjframes.check.trial import IMPACT_SPEED, Outcome

LENGTHS = 10  # of the bar that an impact may go in a step
DIGITS = 1e9  # [-] h²K/m above which the rigid motion has lost seven of sixteen digits

STIFF = "h²K/m is above 1e9, so that M + h²K holds few digits of M: the pivots of its LᵀDL that belong to rigid \
motions are differences of numbers that much larger"
DEEP = f"at {IMPACT_SPEED:.0f} m/s the bar is many of its lengths deep in the floor when a step first finds the \
contact, and what pushes it out deforms it as much in the next"
OTHER = "it rests in another shape: its elastic forces vanish there too, another minimum of the energy, folded or \
with material turned inside out"
SLOW = "it is on its way, the forces on it have not vanished when the time is up"
UNKNOWN = "unexplained"


def reason(outcome: Outcome) -> str:
    """One sentence."""
    case = outcome.case
    if outcome.survives:
        return OTHER if outcome.balanced else SLOW
    if case.disturbance == IMPACT and case.timestep * IMPACT_SPEED > LENGTHS * LENGTH:
        return DEEP
    return STIFF if stiffness_ratio(case) > DIGITS else UNKNOWN


def stiffness_ratio(case: Case) -> float:
    """h²K/m of a frame [-]: K = E ℓ, m = ρ ℓ³, ℓ its part of the bar's length."""
    return case.timestep**2 * case.stiffest / (DENSITY * (LENGTH / FRAMES) ** 2)
