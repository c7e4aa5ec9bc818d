"""What is measured of each contender, and what follows from the table of it.

Error: ‖u − u_ref‖ / ‖u_ref‖ over all voxels. The times of a case are taken in turns, so that a machine that slows down
does so for all, and medians of them are kept.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import median

import numpy as np

from benchmarks.contenders.equilibrium import TIMED_STEP
from benchmarks.contenders.flex import FlexContender, FlexProcess, flex_settings
from benchmarks.contenders.frames import BY_HAND, Contender, settings, solved
from benchmarks.solids.cases import Case
from benchmarks.solids.reference import Reference
from mjframes.base.errors import MjframesError

STALLED = 0.9  # [-] of the error with fewer frames: what does not get below that has stopped converging
SETTLED = 0.02  # [-] error below which that no longer matters: voxels and the held face have their own
USEFUL = (0.05, 0.1, 0.2, 0.3)  # [-] errors at which speeds are compared: the first that frames reach


@dataclass(frozen=True)
class Row:
    """One contender in one case.

    error: relative L2.
    goal_error: signed, relative, of the quantity of interest.
    frames: free ones, 0 for flex.
    step_seconds: of a step of 2 ms.
    steps, rest_seconds: to equilibrium within 1 %, at `timestep` [s].
    edited: a flex whose stiffness was replaced by that of the voxels.
    """

    case: str
    kind: str
    family: str
    name: str
    frames: int
    dofs: int
    error: float
    goal_error: float
    step_seconds: float
    steps: int
    timestep: float
    rest_seconds: float
    build_seconds: float
    edited: bool

    @property
    def rival(self) -> str:
        """Return the kind that it competes for; none for frames placed by hand, which are shown only."""
        return "" if BY_HAND in self.family else self.kind


@dataclass(frozen=True, eq=False)
class Outcome:
    """One case.

    refused: (family, name, reason) of what did not build or come to rest.
    """

    case: Case
    reference: Reference
    rows: list[Row]
    refused: list[tuple[str, str, str]]


def compare(
    case: Case, known: Reference, flex: FlexProcess | None, quick: bool, progress: Callable[[str], None]
) -> Outcome:
    """Return all contenders of a case, solved one after the other, then timed in turns."""
    found: list[tuple[Contender | FlexContender, str, int]] = []
    refused = []
    for setting in settings(case, quick):
        progress(f"{case.title}: {setting.frames} frames, {setting.family}")
        try:
            found.append((solved(case, setting, known.load), "mjframes", setting.frames))
        except MjframesError as error:
            refused.append((setting.family, f"{setting.frames} free frames", str(error)))
    if flex:
        flex.forget()
        for setting in flex_settings(case, quick):
            progress(f"{case.title}: {setting.family}, {setting.name}")
            try:
                found.append((flex.solved(case, setting, known.load), "flex", 0))
            except MjframesError as error:
                refused.append((setting.family, setting.name, str(error)))
    progress(f"{case.title}: time")
    rounds, least = (3, 0.003) if quick else (5, 0.005)
    times = [
        [(one.seconds_per_step(TIMED_STEP, least), one.seconds_to_rest()) for one, _, _ in found] for _ in range(rounds)
    ]
    goal = case.quantity(known.moved)
    rows = [
        Row(
            case=case.name,
            kind=kind,
            family=one.family,
            name=one.name,
            frames=frames,
            dofs=one.dofs,
            error=known.error(one.moved),
            goal_error=case.quantity(one.moved) / goal - 1,
            step_seconds=median(time[0] for time in measured),
            steps=one.steps,
            timestep=one.timestep,
            rest_seconds=median(time[1] for time in measured),
            build_seconds=one.build_seconds,
            edited=isinstance(one, FlexContender) and one.edited,
        )
        for (one, kind, frames), measured in zip(found, zip(*times, strict=True), strict=True)
    ]
    return Outcome(case, known, rows, refused)


def front(rows: Sequence[Row], value: Callable[[Row], float]) -> list[Row]:
    """Return those that nothing else beats in both error and value, by value."""
    best: list[Row] = []
    for row in sorted(rows, key=lambda r: (value(r), r.error)):
        if not best or row.error < best[-1].error:
            best.append(row)
    return best


@dataclass(frozen=True)
class Race:
    """Who is faster at the same error.

    bound: the first of USEFUL that frames reach.
    mine: the frames within it whose lead is the largest.
    theirs: the fastest flex as exact as these or better, None if there is none; `lead` is the ratio of their seconds
    per step.
    fastest, fastest_flex: within the bound, however exact; None if none is.
    """

    case: str
    bound: float
    mine: Row | None
    theirs: Row | None
    fastest: Row | None
    fastest_flex: Row | None

    @property
    def lead(self) -> float:
        """Return the lead: ∞ where no flex that was tried is as exact, 0 where no frames reach the bound."""
        return _ratio(self.theirs, self.mine)

    @property
    def lead_within_bound(self) -> float:
        return _ratio(self.fastest_flex, self.fastest)


def race(case: str, rows: Sequence[Row]) -> Race:
    """Return the race of a case; leads over a flex that exists are preferred to leads over none."""
    reached = [bound for bound in USEFUL if any(r.rival == "mjframes" and r.error <= bound for r in rows)]
    bound = reached[0] if reached else USEFUL[-1]
    frames, flex = ([r for r in rows if r.rival == kind] for kind in ("mjframes", "flex"))
    duels = []
    for row in (r for r in frames if r.error <= bound):
        rival = _fastest([other for other in flex if other.error <= row.error])
        lead = _ratio(rival, row)
        duels.append((np.isfinite(lead), lead, -row.step_seconds, row, rival))
    *_, mine, theirs = max(duels, key=lambda duel: duel[:3]) if duels else (None, None)
    within = [_fastest([r for r in some if r.error <= bound]) for some in (frames, flex)]
    return Race(case, bound, mine, theirs, *within)


def _fastest(rows: Sequence[Row]) -> Row | None:
    return min(rows, key=lambda row: row.step_seconds, default=None)


def _ratio(slow: Row | None, quick: Row | None) -> float:
    if quick is None:
        return 0.0
    return float("inf") if slow is None else slow.step_seconds / quick.step_seconds


@dataclass(frozen=True)
class Slope:
    """Errors of a family over the number of frames.

    order: −slope of log error against log dofs.
    stalled: whether it does not get better with the last doubling."""

    case: str
    family: str
    frames: tuple[int, ...]
    errors: tuple[float, ...]
    order: float
    stalled: bool


def slopes(case: str, rows: Sequence[Row]) -> list[Slope]:
    """Return the slopes of every family with three sizes or more."""
    found = []
    for family in dict.fromkeys(row.family for row in rows):
        own = [row for row in rows if row.family == family]
        if len(own) < 3:
            continue
        errors = np.array([row.error for row in own])
        order = -np.polyfit(np.log([row.dofs for row in own]), np.log(errors), 1)[0]
        stalled = errors[-1] > STALLED * errors[:-1].min() and errors[-1] > SETTLED
        found.append(
            Slope(case, family, tuple(row.frames for row in own), tuple(errors.tolist()), float(order), bool(stalled))
        )
    return found
