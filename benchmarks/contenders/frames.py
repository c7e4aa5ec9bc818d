"""Soft bodies of frames, solved in the simulator: what `build` and `attach` make, stepped by `mj_step`.

Forces f_v on voxels act on control point j as Σ_v W_j(v) f_v; voxels are where the view says that they are.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from benchmarks.contenders.equilibrium import release, seconds_per_step, seconds_to_rest, settle
from benchmarks.solids.cases import Case
from mjframes.base.cache import SWITCH
from mjframes.base.choices import PAPER, WHOLE_BODY
from mjframes.base.errors import MjframesError
from mjframes.body.build import build
from mjframes.body.options import Paper
from mjframes.body.soft_body import SoftBody
from mjframes.frames.supports import Fixed
from mjframes.kinematics.control import control_weights
from mjframes.scene.attach import attach
from mjframes.scene.forces import wrenches
from mjframes.scene.solver import choose_solver
from mjframes.scene.view import soft
from mjframes.volume.grid import Grid

Array = NDArray[np.float64]

TYPES = {"affine": 12, "rigid": 6, "quadratic": 30}  # and the degrees of freedom of each
MOST_DOFS = 240  # that are tried
SAMPLES = 3  # [a frame] of the paper's method where its Table 2 has no such number of frames
PAPERS_SAMPLES = {3: 10, 10: 53, 20: 140}  # frames: samples, of its steak
BY_HAND = ", by hand"


@dataclass(frozen=True)
class Setting:
    """One way to build a case's body.

    frames: that are free.
    by_hand: with hats on the centre line, else where `build` places them.
    """

    frames: int
    frame_type: str = "affine"
    method: str = WHOLE_BODY
    by_hand: bool = False
    mass: str = "consistent"

    @property
    def family(self) -> str:
        """Return what it has in common with other numbers of frames."""
        kind = "paper's method" if self.method == PAPER else self.frame_type
        return f"{kind}{BY_HAND if self.by_hand else ''}{', lumped mass' if self.mass == 'lumped' else ''}"

    @property
    def samples(self) -> int | None:
        """Return the number of samples of the paper's method; the default has none."""
        return PAPERS_SAMPLES.get(self.frames, SAMPLES * self.frames) if self.method == PAPER else None

    @property
    def way(self) -> str | Paper:
        """Return the method with its samples, as `build` takes it."""
        return self.method if self.samples is None else Paper(self.samples)


class Simulation:
    """A soft body alone in a world without gravity."""

    def __init__(self, body: SoftBody, grid: Grid) -> None:
        spec = mujoco.MjSpec()
        spec.option.gravity = [0, 0, 0]
        attach(spec, body, "body", contact=False)
        choose_solver(spec)
        try:
            self.model = spec.compile()
        except ValueError as error:
            raise MjframesError(f"MuJoCo cannot compile it ({' '.join(str(error).split())[:200]}).") from error
        self.data = mujoco.MjData(self.model)
        self.view = soft(self.model, self.data, "body", body)
        self.centers = grid.centers
        self.shapes = control_weights(body.fields.weights, body.control, grid.centers)

    def pushed(self, load: Array) -> Callable[[], None]:
        """Return what applies the forces `load` (n, 3) [N] on voxels to the present configuration."""
        force = np.asarray(self.shapes.T @ load)

        def push() -> None:
            at = self.view.control_positions
            self.data.xfrc_applied[:] = wrenches(self.data, self.view.bodies, at, force)

        return push

    def field(self) -> Array:
        """Return the displacements (n, 3) [m] of the voxels."""
        return self.view.positions(self.centers) - self.centers

    def frequencies(self, count: int, rigid: int) -> Array:
        """Return the lowest frequencies (count,) [Hz] at rest, after those of `rigid` motions.

        d->M is M + h² K, here of two steps h; functions that depend on each other have no mass, so 1/(ω² + s).
        """
        mujoco.mj_resetData(self.model, self.data)
        held = []
        for self.model.opt.timestep in (1e-3, 2e-3):
            mujoco.mj_forward(self.model, self.data)
            held.append(np.zeros((self.model.nv,) * 2))
            mujoco.mj_fullM(self.model, self.data, held[-1])
        stiffness = (held[1] - held[0]) / 3e-6
        mass = held[0] - 1e-6 * stiffness
        shift = 1e-3 * float(np.mean(np.diag(stiffness)) / np.mean(np.diag(mass)))
        inverse = linalg.eigh(mass, stiffness + shift * mass, eigvals_only=True)[::-1]
        squares = 1 / inverse[rigid : rigid + count] - shift
        return np.sqrt(np.maximum(squares, 0)) / (2 * np.pi)


@contextmanager
def nothing_kept() -> Iterator[None]:
    """Compute every stage meanwhile: what was kept from an earlier run would flatter the times."""
    before = os.environ.get(SWITCH)
    os.environ[SWITCH] = "0"
    try:
        yield
    finally:
        if before is None:
            del os.environ[SWITCH]
        else:
            os.environ[SWITCH] = before


@nothing_kept()
def timed_build(*inputs: Any, **options: Any) -> tuple[SoftBody, float]:
    """Return what `build` makes of these, and the seconds it takes with nothing kept from earlier."""
    start = time.perf_counter()
    return build(*inputs, **options), time.perf_counter() - start


@dataclass(frozen=True, eq=False)
class Contender:
    """A compiled model that has come to rest.

    moved: (n, 3) [m].
    build_seconds: of the precomputation.
    steps: to within 1 %, at `timestep` [s].
    """

    name: str
    family: str
    dofs: int
    moved: Array
    build_seconds: float
    steps: int
    timestep: float
    simulation: Simulation
    push: Callable[[], None]
    goal: Array

    def seconds_per_step(self, timestep: float, least: float) -> float:
        return seconds_per_step(self.simulation.model, self.simulation.data, timestep, least)

    def seconds_to_rest(self) -> float:
        return seconds_to_rest(self.simulation.model, self.simulation.data, self.push, self.steps, self.timestep)

    def release(self, timestep: float, steps: int) -> Array:
        """Return the quantity of interest (steps,) [m] once the load is gone."""
        some = np.flatnonzero(self.goal.any(axis=1))
        goal, at = self.goal[some], self.simulation.centers[some]

        def quantity() -> float:
            return float(np.sum(goal * (self.simulation.view.positions(at) - at)))

        return release(self.simulation.model, self.simulation.data, quantity, timestep, steps)


def settings(case: Case, quick: bool) -> list[Setting]:
    """Return what is tried: the defaults; other types of frames; by hand, on centre lines; the paper's."""
    found = []
    for frames in case.frames:
        found += [Setting(frames, kind) for kind in (("affine",) if quick else TYPES)]
        if case.straight:
            found.append(Setting(frames, by_hand=True))
        found.append(Setting(frames, method=PAPER))
    return [one for one in found if one.frames * TYPES[one.frame_type] <= MOST_DOFS]


def solved(case: Case, setting: Setting, load: Array) -> Contender:
    """Build, attach and bring to rest under `load` (n, 3) [N]. Raise MjframesError where one of these is refused."""
    body, seconds = built(case, setting)
    simulation = Simulation(body, case.grid)
    push = simulation.pushed(load)
    result = settle(simulation.model, simulation.data, push, simulation.field)
    if not result:
        raise MjframesError("the body does not come to rest.")
    return Contender(
        f"{setting.frames} free frames", setting.family, simulation.model.nv, result["moved"], seconds, result["steps"],
        result["timestep"], simulation, push, case.goal,
    )  # fmt: skip


def built(case: Case, setting: Setting) -> tuple[SoftBody, float]:
    """Return the body, and the seconds that it took."""
    places: dict[str, Any] = {"frames": setting.frames}
    if setting.by_hand:
        assert case.places
        places = {"at": case.places(setting.frames), "weights": "linear"}
    return timed_build(
        case.volume,
        method=setting.way,
        frame_type=setting.frame_type,
        mass=setting.mass,
        supports=[Fixed(case.fixed)],
        **places,
    )
