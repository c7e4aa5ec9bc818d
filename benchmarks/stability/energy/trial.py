"""All that is measured of one body, row by row."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

from benchmarks.stability.energy import loops, motions, order, recovery
from benchmarks.stability.energy.bodies import Subject
from benchmarks.stability.energy.world import World, world
from mjframes.base.errors import MjframesError

GAIN, LOOP, MADE, RETURN, REST = "gain", "loop", "made as h → 0", "return", "rest"
MEASURES = ("gain", "loop", "order", "return", "rest")  # as the command line names them


@dataclass(frozen=True)
class Plan:
    """How much is measured of each body.

    steps: [s].  drops: attitudes.  loops: of each kind.  measures: which are taken.
    """

    steps: tuple[float, ...] = motions.STEPS
    drops: int = 3
    loops: int = 2
    measures: tuple[str, ...] = MEASURES


QUICK = Plan(steps=(2e-3,), drops=1, loops=1, measures=("gain", "loop", "return", "rest"))


@dataclass(frozen=True)
class Number:
    """One number.

    measure: what kind.  case: of which motion, loop or start.  timestep: [s].  run: which of these.
    value, limit: what it is, and what it has to stay below.
    others: what else was measured there, by name.
    """

    measure: str
    case: str
    timestep: float
    run: int
    value: float
    limit: float
    others: Mapping[str, float] = field(default_factory=dict)

    @property
    def passes(self) -> bool:
        """Return whether the value is below its limit; NaN is not."""
        return self.value <= self.limit


@dataclass(frozen=True)
class Found:
    """What was measured of a body.  why: it could not be, "" where it could."""

    subject: Subject
    voxels: int
    numbers: tuple[Number, ...]
    why: str = ""

    def of(self, measure: str, case: str | None = None) -> list[Number]:
        """Return the numbers of one kind, and of one case where it is given."""
        return [n for n in self.numbers if n.measure == measure and case in (None, n.case)]


@dataclass(frozen=True)
class Job:
    """A body and how much is measured of it."""

    subject: Subject
    plan: Plan


def measured(job: Job) -> Found:
    """Build a body and measure it."""
    try:
        body = job.subject.build()
    except MjframesError as error:
        return Found(job.subject, 0, (), str(error))
    made = world(body)
    numbers = tuple(number for measure in job.plan.measures for number in _TAKEN[measure](made, job))
    return Found(job.subject, body.voxels, numbers)


def _gains(made: World, job: Job) -> Iterator[Number]:
    for name, motion in motions.MOTIONS.items():
        for number in range(job.plan.drops if name == "dropped" else 1):
            for timestep in job.plan.steps:
                gain = motion(made, timestep, job.subject.seed + number)
                others = {"total": gain.gain, "motion": gain.motion, "turned": gain.turned, "moved_J": gain.moved}
                yield Number(GAIN, name, timestep, number, gain.worst, motions.LIMIT, others)


def _loops(made: World, job: Job) -> Iterator[Number]:
    for kind in loops.KINDS:
        for number in range(job.plan.loops):
            loop = loops.loop_of(made, kind, job.subject.seed + number)
            others = {"mismatch": loop.mismatch, "doubt": loop.doubt}
            yield Number(LOOP, kind, 0.0, number, loop.work, loops.LIMIT, others)


def _drifts(made: World, job: Job) -> Iterator[Number]:
    for name in order.MOTIONS:
        drift = order.drift(made, name, job.subject.seed)
        drifts = zip(order.STEPS, drift.drift, strict=True)
        others = {"order": drift.order} | {f"drift_{h * 1e3:g}ms": value for h, value in drifts}
        yield Number(MADE, name, order.STEPS[-1], 0, drift.made[-1], motions.LIMIT, others)


def _returns(made: World, job: Job) -> Iterator[Number]:
    rate = recovery.lowest_rate(made)
    for start in recovery.STARTS:
        error = recovery.recovers(made, start, job.subject.seed, rate)
        yield Number(RETURN, start, recovery.TIMESTEP, 0, error, recovery.BACK)


def _rests(made: World, job: Job) -> Iterator[Number]:
    moving = recovery.rests(made, job.subject.seed)
    yield Number(REST, "dropped", recovery.TIMESTEP, 0, moving, recovery.STILL)


_TAKEN: dict[str, Callable[[World, Job], Iterator[Number]]] = dict(
    zip(MEASURES, (_gains, _loops, _drifts, _returns, _rests), strict=True)
)
