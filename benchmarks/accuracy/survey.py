"""Bodies nobody tuned, built with the defaults and stepped to rest under every load: what a user gets.

For each body and number of frames: errors ‖u − u_ref‖ / ‖u_ref‖ over all voxels, the worst load of a kind; those of
natural frequencies; seconds of the precomputation and of a step. The paper's method stands beside it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import median

import mujoco
import numpy as np
from numpy.typing import NDArray

from benchmarks.contenders.equilibrium import TIMED_STEP, TIMESTEPS, seconds_per_step, settle
from benchmarks.contenders.frames import Setting, Simulation, timed_build
from benchmarks.solids.bodies import Body, Load
from benchmarks.solids.exact import MODES, Exact
from mjframes.base.choices import PAPER, WHOLE_BODY
from mjframes.base.errors import MjframesError
from mjframes.frames.supports import Fixed

Array = NDArray[np.float64]

FRAMES = (3, 5, 10, 20)
PROMISED_FRAMES = 5
FREE = 0.01  # [-] of the loads of a free body that are put on it: it answers in proportion
STATIC = ("weight", "end")  # kinds of loads that bounds are for


@dataclass(frozen=True)
class Judged:
    """One body, built in one way.

    errors: [-] of each kind of load, of its worst.
    worst: name of the worst static load.
    same_mesh: error of the static ones against finite elements on the voxels.
    frequency: the largest relative error of the first ones, signed.
    estimate: `body.error`, (weight, pushes).
    """

    body: str
    method: str
    frames: int
    dofs: int
    errors: dict[str, float]
    worst: str
    same_mesh: float
    frequency: float
    estimate: tuple[float, float]
    step_seconds: float
    build_seconds: float

    @property
    def static(self) -> float:
        """Return the worst of own weight and forces on ends."""
        return max(self.errors[kind] for kind in STATIC if kind in self.errors)

    def push(self, share: str) -> float:
        """Return the worst push on that share of the surface."""
        return self.errors[f"push {share}"]


@dataclass(frozen=True, eq=False)
class Verdict:
    """One body with all that was built of it.

    refused: (method, frames, reason).
    """

    body: Body
    exact: Exact
    rows: list[Judged]
    refused: list[tuple[str, int, str]]

    def of(self, method: str) -> list[Judged]:
        return [row for row in self.rows if row.method == method]

    def bounded(self, row: Judged) -> float:
        """Return the error that the body's bound is for."""
        return row.same_mesh if self.body.same_mesh else row.static

    @property
    def promised(self) -> tuple[float, str, bool] | None:
        """Return the static error at PROMISED_FRAMES that the body's bound is for, its load, and whether that holds."""
        for row in self.of(WHOLE_BODY):
            if row.frames == PROMISED_FRAMES:
                error = self.bounded(row)
                return error, row.worst, error <= self.body.bound
        return None

    @property
    def mesh(self) -> float:
        """Return the most that finite elements on the voxels are off by under the static loads [-]."""
        static = [load.kind in STATIC for load in self.body.loads()]
        return float(self.exact.mesh[static].max())

    @property
    def growth(self) -> float:
        """Return the most that the static error is larger than with fewer frames [-]."""
        errors = [row.static for row in self.of(WHOLE_BODY)]
        return max((after / before for k, after in enumerate(errors) for before in errors[:k]), default=0.0)


def judge(body: Body, known: Exact, quick: bool, progress: Callable[[str], None]) -> Verdict:
    """Build the body with the defaults and by the paper's method, with each number of frames."""
    rows, refused, loads = [], [], body.loads()
    for method in (WHOLE_BODY, PAPER):
        for frames in FRAMES[:2] if quick else FRAMES:
            progress(f"{body.title}: {frames} frames{', the paper’s method' if method == PAPER else ''}")
            try:
                rows.append(_judged(body, known, loads, Setting(frames, method=method)))
            except MjframesError as error:
                refused.append((method, frames, str(error)))
    return Verdict(body, known, rows, refused)


def _judged(body: Body, known: Exact, loads: Sequence[Load], setting: Setting) -> Judged:
    fixed = [] if body.fixed is None else [Fixed(body.fixed)]
    made, seconds = timed_build(body.volume, frames=setting.frames, method=setting.way, supports=fixed)
    simulation = Simulation(made, body.grid)
    frequencies = simulation.frequencies(MODES, 6 if body.fixed is None else 0)
    errors: dict[str, dict[str, float]] = {}  # by kind, by name
    same_mesh = 0.0
    for load, force, moved, coarse in zip(loads, known.loads, known.moved, known.coarse, strict=True):
        found = _at_rest(simulation, body, load, force)
        errors.setdefault(load.kind, {})[load.name] = _distance(found, moved)
        if load.kind in STATIC:
            same_mesh = max(same_mesh, _distance(found, coarse))
    static = {name: error for kind in STATIC for name, error in errors.get(kind, {}).items()}
    off = frequencies / known.frequencies - 1
    estimate = (np.nan, np.nan)
    if made.error:
        estimate = (np.nan if made.error.weight is None else made.error.weight, made.error.pushes)
    return Judged(
        body=body.name,
        method=setting.method,
        frames=setting.frames,
        dofs=simulation.model.nv,
        errors={kind: max(some.values()) for kind, some in errors.items()},
        worst=max(static, key=lambda name: static[name]),
        same_mesh=same_mesh,
        frequency=float(off[np.argmax(np.abs(off))]),
        estimate=estimate,
        step_seconds=median(seconds_per_step(simulation.model, simulation.data, TIMED_STEP, 0.005) for _ in range(5)),
        build_seconds=seconds,
    )


def _at_rest(simulation: Simulation, body: Body, load: Load, force: Array) -> Array:
    """Displacements (n, 3) [m] under `force` (n, 3) [N]; own weight is MuJoCo's gravity."""
    push, timesteps, part = simulation.pushed(force), TIMESTEPS, 1.0
    if body.fixed is None:
        push, timesteps, part = _stopped(simulation, simulation.pushed(FREE * force)), TIMESTEPS[1:], FREE
    if load.kind == "weight":
        mass = body.grid.density.sum() * body.grid.cell_volume
        simulation.model.opt.gravity[:] = force.sum(axis=0) / mass
        push = _nothing
    simulation.data.xfrc_applied[:] = 0
    result = settle(simulation.model, simulation.data, push, lambda: body.apart(simulation.field()), timesteps)
    simulation.model.opt.gravity[:] = 0
    if not result:
        raise MjframesError(f"it does not come to rest under {load.name!r}.")
    mujoco.mj_resetData(simulation.model, simulation.data)
    return result["moved"] / part


def _stopped(simulation: Simulation, push: Callable[[], None]) -> Callable[[], None]:
    """The same push from a stop.

    A free body that is pushed from behind would turn over, as its balance is unstable; so slowly that it comes to rest
    before, unless turns add up, steps are long or the bend, which gives the forces their arms, is large.
    """

    def stop() -> None:
        simulation.data.qvel[:] = 0
        push()

    return stop


def _nothing() -> None:
    pass


def _distance(found: Array, moved: Array) -> float:
    return float(np.linalg.norm(found - moved) / np.linalg.norm(moved))
