"""Steps of all scenes and numbers of frames, timed in turns, and how their time grows with the frames."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from statistics import median

import numpy as np

from benchmarks.speed.instructions import instructions
from benchmarks.speed.step_scenes import BARE, OURS, Run, Steps, bare_run, soft_run
from mjframes.body.soft_body import SoftBody

MOST_DOFS = 2000  # of a scene: larger ones take minutes
LEAST_STEPS, MOST_STEPS = 20, 400  # that are timed at once
SECONDS = 0.1  # [s] that they shall take
PILOT = 5  # steps that tell how long one takes


@dataclass(frozen=True, eq=False)
class Group:
    """What is compared: contenders in one scene, ours first, each making so many steps."""

    steps: int
    runs: tuple[Steps, ...]


@dataclass(frozen=True)
class Speed:
    """How fast one of them is.

    contacts, iterations: mean numbers, of the solver's iterations the latter.
    step: median time of one [s].
    instructions: of one; None where they were not counted.
    """

    body: str
    frames: int
    scene: str
    contender: str
    dofs: int
    contacts: float
    iterations: float
    step: float
    instructions: float | None = None


def prepare(name: str, body: SoftBody, scene: str) -> Group | None:
    """Return a soft body and its bodies alone in a scene; None for more than `MOST_DOFS` degrees of freedom."""
    if (3 if scene == "stack" else 1) * 3 * len(body.control.frame) > MOST_DOFS:
        return None
    soft = soft_run(name, body, scene)
    steps = int(np.clip(round(PILOT * SECONDS / soft.step(PILOT)), LEAST_STEPS, MOST_STEPS))
    return Group(steps, (soft, bare_run(name, body, scene, soft.contacts(steps)[0])))


def measure(groups: Sequence[Group], rounds: int, progress: Callable[[], None] = lambda: None) -> list[Speed]:
    """Return the speed of every run, measured in turns; `progress` is called after each round of a group."""
    found = [[run.contacts(group.steps) for run in group.runs] for group in groups]
    times: list[list[list[float]]] = [[[] for _ in group.runs] for group in groups]
    for _ in range(rounds):
        for group, taken in zip(groups, times, strict=True):
            for run, some in zip(group.runs, taken, strict=True):
                some.append(run.step(group.steps) / group.steps)
            progress()
    return [
        Speed(run.body, run.frames, run.scene, run.contender, run.dofs, *touching, median(some))
        for group, taken, contacts in zip(groups, times, found, strict=True)
        for run, some, touching in zip(group.runs, taken, contacts, strict=True)
    ]


def counted(speeds: Sequence[Speed], groups: Sequence[Group]) -> list[Speed]:
    """Return the speeds, those of soft bodies of this process with the instructions of a step."""
    runs = [run for group in groups for run in group.runs]
    return [
        replace(speed, instructions=instructions(run)) if isinstance(run, Run) and run.contender == OURS else speed
        for speed, run in zip(speeds, runs, strict=True)
    ]


def of(speeds: Sequence[Speed], **chosen: object) -> list[Speed]:
    """Return those whose fields are what is chosen, as `scene="stack"`."""
    return [some for some in speeds if all(getattr(some, name) == value for name, value in chosen.items())]


def growth(speeds: Sequence[Speed], first: int, last: int) -> float | None:
    """Return the exponent of the step's time in the number of frames, fitted from `first` to `last`, or None."""
    some = [speed for speed in speeds if first <= speed.frames <= last]
    if len(some) < 2:
        return None
    return float(np.polyfit(np.log([s.frames for s in some]), np.log([s.step for s in some]), 1)[0])


def over_bare(speeds: Sequence[Speed], frames: int, scene: str, body: str) -> float | None:
    """Return the step of a soft body over that of its bodies alone."""
    mine, bare = (of(speeds, frames=frames, scene=scene, body=body, contender=name) for name in (OURS, BARE))
    return mine[0].step / bare[0].step if mine and bare else None
