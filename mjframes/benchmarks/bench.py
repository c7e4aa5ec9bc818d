"""How long the precomputation takes and how many steps a second there are: `mjframes bench`.

The volume and the three numbers of frames are those of the paper's Table 2, by the default method and by the paper's
with its samples. A soft body's step is compared with steps of the same
MuJoCo bodies, of the same masses on the same slides, from whose model the plugin was taken out, which is what any such
tree of bodies costs in MuJoCo: once free of contact, once with as many contacts, between spheres and the floor.
What is compared is measured in turns, and medians are taken, so that a machine that slows down does so for all.
"""

from __future__ import annotations

import csv
import os
import platform
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import mujoco
import numpy as np
from rich.console import Console
from rich.table import Table

from mjframes.base.cache import SWITCH
from mjframes.base.files import replacing
from mjframes.benchmarks.large import GROWTH, Job, Measured, draw_growth, jobs_of, measure, ring_file, standard_jobs
from mjframes.benchmarks.profile import PARTS, contact_share, profile
from mjframes.body.build import build
from mjframes.body.options import Paper
from mjframes.body.soft_body import SoftBody
from mjframes.scene.scene_file import standalone_scene
from mjframes.volume.volume import Volume

VOLUME = Path(__file__).parents[2] / "models" / "steak.npz"
OUTPUT = Path("out") / "bench.csv"


class Size(NamedTuple):
    """How a body is built.

    frames: how many.
    samples: of the paper's method; None for the default one.
    """

    frames: int
    samples: int | None = None

    @property
    def options(self) -> dict[str, Any]:
        """Return the arguments of `build`."""
        return {"frames": self.frames} | ({"method": Paper(self.samples)} if self.samples else {})

    def __str__(self) -> str:
        """Return what tables call it."""
        return f"{self.frames} frames" + (f", {self.samples} samples" if self.samples else "")


# Size: initialization [s], frames a second (with drawing and collisions, at 2.67 GHz): the paper, Table 2
PAPER: dict[Size, tuple[float, float]] = {Size(3, 10): (3, 500), Size(10, 53): (8, 100), Size(20, 140): (12, 40)}

TIMESTEP = 2e-3  # [s]
FALL = 50  # steps before the measured ones: from here on the body touches the box
STEPS = 500  # measured: it lands, bends over the edge of the box and comes to rest
BUILDS = 5  # of which the median is taken
ROUNDS = 7

SOFT, AIR, SPHERES, BODIES = "soft body, contact", "soft body, free", "bodies only, contact", "bodies only, free"
STEP_NOTE = f"""\
{SOFT}: it lands on the edge of a box and the floor.  {AIR}: it falls freely.
{SPHERES}: the same bodies without the plugin, on the floor by as many spheres; what "{SOFT}" is divided by.
{BODIES}: the same bodies without the plugin, falling freely; what "{AIR}" is divided by.
× paper's method: the same step of as many frames whose stiffness is summed over the samples of the paper's table.
The paper's frames a second include drawing, on a processor of 2.67 GHz of its time."""

LAWS = ("corotational", "neo_hookean")
COST_NOTE = f"""\
elasticity: "{AIR}" less "{BODIES}", with the second inertia and factorization that it takes.
× MuJoCo's: "{SOFT}" over "{SPHERES}", whose contacts are of one body each and found at once.
× without elasticity: "{SOFT}" over the same less its elasticity: the same contacts of the same skin."""

LARGE_NOTE = """\
The faster of two runs, each in a process of its own, with the kernels compiled. Processor seconds: of all threads.
Bytes a cell: by how much the process grew, over the cells of the grid."""

CONTACTS = "the plugin's contacts"
PROFILE_NOTE = """\
position: kinematics, inertia and its factorization.  collision: contacts of the patches.
forces: elasticity, the factorization of M + hC + h²K, contact Jacobians.  solver: MuJoCo's, for the contacts.
the plugin's contacts: what collision and forces take more than in free flight."""


@dataclass(frozen=True)
class Building:
    """Medians [s] of `build`: of each stage, and of the whole."""

    size: Size
    stages: dict[str, float]
    total: float


@dataclass(frozen=True)
class Speed:
    """How fast one of the four models of a size is.

    contacts, iterations: mean numbers, of the solver's iterations the latter.
    step: median time of one [s].
    """

    size: Size
    name: str
    dofs: int
    contacts: float
    iterations: float
    step: float


@dataclass(frozen=True)
class Cost:
    """What a law costs: mean number of points a region (none for the corotational one), its four models' steps."""

    law: str
    points: float
    speeds: tuple[Speed, ...]

    def step(self, name: str) -> float:
        """Return the time of a step of the model `name` [s]."""
        return next(speed.step for speed in self.speeds if speed.name == name)

    @property
    def elasticity(self) -> float:
        """Return the time that elasticity takes in a step [s]."""
        return self.step(AIR) - self.step(BODIES)

    @property
    def over_bodies(self) -> float:
        """Return the step with contacts over that of the bodies alone with as many [-]."""
        return self.step(SOFT) / self.step(SPHERES)

    @property
    def over_no_elasticity(self) -> float:
        """Return the step with contacts over the same without the elasticity's part [-]."""
        return self.step(SOFT) / (self.step(SOFT) - self.elasticity)


@dataclass(frozen=True, eq=False)
class Run:
    """Steps that can be repeated: `state` is where they start."""

    size: Size
    name: str
    model: mujoco.MjModel
    data: mujoco.MjData
    state: np.ndarray

    def step(self, steps: int) -> float:
        """Return the wall time of so many steps [s]."""
        mujoco.mj_setState(self.model, self.data, self.state, mujoco.mjtState.mjSTATE_INTEGRATION)
        start = time.perf_counter()
        mujoco.mj_step(self.model, self.data, nstep=steps)
        return time.perf_counter() - start

    def contacts(self, steps: int) -> tuple[float, float]:
        """Return the mean numbers of contacts and of the solver's iterations over the steps."""
        mujoco.mj_setState(self.model, self.data, self.state, mujoco.mjtState.mjSTATE_INTEGRATION)
        contacts = iterations = 0
        for _ in range(steps):
            mujoco.mj_step(self.model, self.data)
            contacts += self.data.ncon
            iterations += self.data.solver_niter[0]  # a single tree is a single island
        return contacts / steps, float(iterations) / steps


def main() -> None:
    """Measure, print tables, and write every number to out/bench.csv."""
    os.environ[SWITCH] = "0"  # stages that were kept from an earlier run would flatter the times
    console = screen()
    rows: list[tuple[object, ...]] = [("machine", "", "", name, text, "") for name, text in machine().items()]
    for _, _, _, name, text, _ in rows:
        console.print(f"{name:9}  {text}", highlight=False)
    volume = Volume.load(VOLUME)
    console.print(f"{'volume':9}  {VOLUME.name}, {(volume.labels > 0).sum()} voxels", highlight=False)

    sizes = [size for papers in PAPER for size in (Size(papers.frames), papers)]
    bodies, buildings = measure_builds(volume, sizes, BUILDS)
    show(console, build_table(buildings[::2]))
    show(console, build_table(buildings[1::2]))
    runs = [run for body, size in zip(bodies, sizes, strict=True) for run in prepare_runs(body, volume, size, STEPS)]
    speeds = measure_steps(runs, ROUNDS, STEPS)
    show(console, step_table(speeds), STEP_NOTE)
    profiles = {size: measure_profile([run for run in runs if run.size == size], ROUNDS, STEPS) for size in sizes}
    show(console, profile_table(profiles), PROFILE_NOTE)

    costs = [measure_cost(volume, sizes[0], law, ROUNDS, STEPS) for law in LAWS]
    show(console, cost_table(costs), COST_NOTE)

    with tempfile.TemporaryDirectory() as folder:
        large = list(measure(standard_jobs(folder)))
    show(console, large_table(large), LARGE_NOTE)

    rows += [("large", m.job.frames, m.job.samples, f"{m.cells} cells", m.seconds, "s") for m in large]
    rows += [("rate", m.job.frames, m.job.samples, f"{m.voxels} voxels", m.rate, "1/s") for m in large]
    rows += [("memory", m.job.frames, m.job.samples, f"{m.cells} cells", m.memory / m.cells, "byte") for m in large]
    rows += [("build", *b.size, stage, seconds, "s") for b in buildings for stage, seconds in b.stages.items()]
    rows += [("build", *b.size, "total", b.total, "s") for b in buildings]
    rows += [("step", *s.size, s.name, s.step, "s") for s in speeds]
    rows += [("contacts", *s.size, s.name, s.contacts, "1") for s in speeds]
    rows += [("iterations", *s.size, s.name, s.iterations, "1") for s in speeds]
    rows += [("share", *size, part, share, "1") for size, shares in profiles.items() for part, share in shares.items()]
    rows += [("cost", *cost.speeds[0].size, cost.law, cost.over_bodies, "1") for cost in costs]
    rows += [("elasticity", *cost.speeds[0].size, cost.law, cost.over_no_elasticity, "1") for cost in costs]
    rows += [("paper", *size, "initialization", seconds, "s") for size, (seconds, _) in PAPER.items()]
    rows += [("paper", *size, "frames a second", rate, "1/s") for size, (_, rate) in PAPER.items()]
    with replacing(OUTPUT, "the table") as partial, partial.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([("table", "frames", "samples", "row", "value", "unit"), *rows])
    console.print(f"\n{OUTPUT} holds all of these numbers.", highlight=False)


def main_of_file(source: str, count: int | None, frames: Sequence[int]) -> None:
    """Print the row of Table 2 for a mesh in a grid of `count` cells, or for a volume of `count` voxels."""
    show(screen(), large_table(list(measure(jobs_of(source, count, frames)))), LARGE_NOTE)


def main_of_growth(picture: str) -> None:
    """Draw a picture (.png) of time and memory from 10⁴ to 2·10⁷ cells."""
    with tempfile.TemporaryDirectory() as folder:
        ring = ring_file(folder)
        measured = list(measure([Job(ring, cells, 10) for cells in GROWTH]))
    draw_growth(measured, picture)
    show(screen(), large_table(measured), f"{LARGE_NOTE}\n{picture} shows them.")


def large_table(measured: Sequence[Measured]) -> Table:
    """Return the table with one row a body."""
    columns = ("cells", "voxels", "seconds", "voxels/s", "processor seconds", "bytes a cell", "the paper's seconds")
    table = table_of("Precomputation of large volumes, from the file to the saved body", *columns)
    for m in measured:
        table.add_row(
            f"{Path(m.job.source).stem}, {Size(m.job.frames, m.job.samples)}",
            *(f"{m.cells:,}", f"{m.voxels:,}", f"{m.seconds:.2f}", f"{m.rate:,.0f}", f"{m.processor:.2f}"),
            f"{m.memory / m.cells:.0f}",
            f"{m.job.paper[1]:g} ({m.job.paper[0]})" if m.job.paper else "",
        )
    return table


def machine() -> dict[str, str]:
    """Return what the numbers depend on: processor, what else it does, system, versions."""
    packages = ("mujoco", "numpy", "scipy", "numba")
    return {
        "processor": f"{_processor()}, {os.cpu_count()} cores, of which steps use one",
        "load": f"{os.getloadavg()[0]:.1f} cores busy in the last minute",
        "system": f"{platform.system()} {platform.machine()}, Python {platform.python_version()}",
        "versions": ", ".join(f"{name} {version(name)}" for name in packages),
    }


def measure_builds(
    volume: Volume, sizes: Sequence[Size], repeats: int
) -> tuple[tuple[SoftBody, ...], tuple[Building, ...]]:
    """Return the soft bodies of the sizes, and how long it took to build them once the kernels were compiled."""
    for size in sizes[:2]:  # of each method
        build(volume, **size.options)
    timings: list[list[dict[str, float]]] = [[] for _ in sizes]
    bodies: tuple[SoftBody, ...] = ()
    for _ in range(repeats):
        built, stages = zip(*(_timed_build(volume, size) for size in sizes), strict=True)
        bodies = built
        for timing, seconds in zip(timings, stages, strict=True):
            timing.append(seconds)
    return bodies, tuple(
        Building(
            size,
            {stage: median(timing[stage] for timing in repeated) for stage in repeated[0]},
            median(sum(timing.values()) for timing in repeated),
        )
        for size, repeated in zip(sizes, timings, strict=True)
    )


def prepare_runs(body: SoftBody, volume: Volume, size: Size, steps: int) -> tuple[Run, ...]:
    """Return the four models: the soft body that falls on the edge of a box and the floor, and its comparisons."""
    soft = _start(size, SOFT, _scene(body, volume, contact=True).compile())
    spheres = _without_plugin(_scene(body, volume, contact=False))
    _add_spheres(spheres, round(soft.contacts(steps)[0]), float(np.ptp(body.control.rest)))
    return (
        soft,
        _start(size, AIR, _scene(body, volume, contact=False).compile()),
        _start(size, SPHERES, spheres.compile()),
        _start(size, BODIES, _without_plugin(_scene(body, volume, contact=False)).compile()),
    )


def measure_steps(runs: Sequence[Run], rounds: int, steps: int) -> tuple[Speed, ...]:
    """Measure all runs in turns, `rounds` times."""
    contacts = [run.contacts(steps) for run in runs]
    timings = [[run.step(steps) / steps for run in runs] for _ in range(rounds)]
    return tuple(
        Speed(run.size, run.name, run.model.nv, *touching, median(seconds))
        for run, touching, seconds in zip(runs, contacts, zip(*timings, strict=True), strict=True)
    )


def measure_cost(volume: Volume, size: Size, law: str, rounds: int, steps: int) -> Cost:
    """Measure the four models of a size with elasticity of that law."""
    body = build(volume, **size.options, law=law)
    of_law = body.quadrature or body.cells
    points = float(np.mean([len(some) for some in of_law.volume])) if of_law else 0.0
    return Cost(law, points, measure_steps(prepare_runs(body, volume, size, steps), rounds, steps))


def measure_profile(runs: Sequence[Run], rounds: int, steps: int) -> dict[str, float]:
    """Return shares of the step of a size's soft body in contact: of its parts, and of the plugin's contact work."""
    chosen = {run.name: run for run in runs if run.name in (SOFT, AIR)}
    found = profile(
        {name: run.data for name, run in chosen.items()},
        {name: partial(run.step, steps) for name, run in chosen.items()},
        rounds,
    )
    whole = sum(found[SOFT].values())
    return {part: found[SOFT][part] / whole for part in PARTS} | {CONTACTS: contact_share(found[SOFT], found[AIR])}


def build_table(buildings: Sequence[Building]) -> Table:
    """Return the seconds of each stage, one column a size."""
    table = table_of(
        "Precomputation, seconds, with the kernels compiled", *(str(building.size) for building in buildings)
    )
    for stage in buildings[0].stages:
        table.add_row(stage, *(f"{building.stages[stage]:.3f}" for building in buildings))
    table.add_row("total", *(f"{building.total:.2f}" for building in buildings), style="bold")
    table.add_row("the paper's", *(f"{found[1][0]:g}" if (found := _papers(b.size)) else "" for b in buildings))
    return table


def step_table(speeds: Sequence[Speed]) -> Table:
    """Return one row a model; the soft ones have the ratio to the same bodies without elasticity."""
    step = {(speed.size, speed.name): speed.step for speed in speeds}
    columns = ("contacts", "iterations", "µs a step", "steps/s", "× real time", "× bodies", "× paper's method")
    columns += ("the paper's frames/s",)
    table = table_of(f"Steps of {TIMESTEP * 1e3:g} ms on one core", *columns)
    for speed in speeds:
        if speed.name == SOFT:
            table.add_row(f"{speed.size}, {speed.dofs} degrees of freedom", style="bold")
        reference = {SOFT: SPHERES, AIR: BODIES}.get(speed.name)
        papers = _papers(speed.size)
        other = step.get((papers[0], speed.name)) if papers and reference and speed.size.samples is None else None
        table.add_row(
            f"  {speed.name}",
            f"{speed.contacts:.1f}",
            f"{speed.iterations:.1f}",
            f"{speed.step * 1e6:.1f}",
            f"{1 / speed.step:.0f}",
            f"{TIMESTEP / speed.step:.2f}",
            f"{speed.step / step[speed.size, reference]:.1f}" if reference else "",
            f"{speed.step / other:.2f}" if other else "",
            f"{papers[1][1]:g}" if speed.name == SOFT and papers else "",
        )
    return table


def profile_table(profiles: dict[Size, dict[str, float]]) -> Table:
    """Return percentages, one column a size."""
    table = table_of(f"Where the step of {SOFT} goes, percent", *map(str, profiles))
    for part in (*PARTS, CONTACTS):
        cells = (f"{100 * shares[part]:.0f}" for shares in profiles.values())
        table.add_row(part, *cells, style="bold" if part == CONTACTS else "")
    return table


def cost_table(costs: Sequence[Cost]) -> Table:
    """Return what elasticity adds to the same bodies, one row a law."""
    columns = ("points a region", "µs, contact", "elasticity, µs", "× MuJoCo's", "× without elasticity")
    table = table_of(f"Cost over the bodies alone, {costs[0].speeds[0].size}", *columns)
    for cost in costs:
        table.add_row(
            cost.law,
            f"{cost.points:.1f}" if cost.points else "",
            f"{cost.step(SOFT) * 1e6:.1f}",
            f"{cost.elasticity * 1e6:.1f}",
            f"{cost.over_bodies:.1f}",
            f"{cost.over_no_elasticity:.2f}",
        )
    return table


def _timed_build(volume: Volume, size: Size) -> tuple[SoftBody, dict[str, float]]:
    names: list[str] = []
    times: list[float] = []

    def progress(stage: str) -> None:
        names.append(stage.split(":")[0])
        times.append(time.perf_counter())

    body = build(volume, **size.options, progress=progress)
    times.append(time.perf_counter())
    spent = dict.fromkeys(names, 0.0)
    for name, seconds in zip(names, np.diff(times).tolist(), strict=True):
        spent[name] += seconds
    return body, spent


def _scene(body: SoftBody, volume: Volume, contact: bool) -> mujoco.MjSpec:
    """The body above a floor, and under five eighths of its length a box."""
    spec = standalone_scene(body, volume, name="body", contact=contact)
    spec.option.timestep = TIMESTEP
    length, width, _ = np.ptp(body.skin.vertices, axis=0)
    half = np.array([length / 2, width, max(length, width) / 12])
    spec.worldbody.add_geom(
        name="box", type=mujoco.mjtGeom.mjGEOM_BOX, size=half, pos=[half[0] - length / 8, 0, half[2]]
    )
    return spec


def _without_plugin(spec: mujoco.MjSpec) -> mujoco.MjSpec:
    """The same bodies, joints and masses; nothing holds them together."""
    for body in spec.bodies:
        body.plugin.active = False
    for instance in list(spec.plugins):
        spec.delete(instance)
    return spec


def _add_spheres(spec: mujoco.MjSpec, count: int, size: float) -> None:
    """`count` spheres that touch the floor, evenly over the bodies; a body without one falls. The box is left out."""
    spec.delete(spec.geom("box"))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    moving = [body for body in spec.bodies if body.joints]
    radius = size / 100
    for number in range(count):
        body = moving[number % len(moving)]
        aside = 3 * radius * (number // len(moving))
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=[radius, 0, 0],
            pos=[aside, 0, radius - data.body(body.name).xpos[2]],
            mass=0,
            contype=1,
            conaffinity=0,
        )


def _start(size: Size, name: str, model: mujoco.MjModel) -> Run:
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=FALL)
    state = np.zeros(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_INTEGRATION))
    mujoco.mj_getState(model, data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
    return Run(size, name, model, data, state)


def _processor() -> str:
    information = Path("/proc/cpuinfo")
    lines = information.read_text().splitlines() if information.is_file() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or "unknown"


def screen() -> Console:
    """Return where tables are printed."""
    console = Console()
    if not console.is_terminal:
        console.width = 160  # tables are as wide as they need; a pipe's 80 columns would break them
    return console


def show(console: Console, table: Table, note: str = "") -> None:
    """Print a table, and what is to be said of it."""
    console.print()
    console.print(table)
    if note:
        console.print(note, highlight=False)


def _papers(size: Size) -> tuple[Size, tuple[float, float]] | None:
    """The paper's entry of as many frames."""
    return next((entry for entry in PAPER.items() if entry[0].frames == size.frames), None)


def table_of(title: str, *columns: str) -> Table:
    """Return a table without rows; its first column has no name."""
    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    table.add_column("")
    for column in columns:
        table.add_column(column, justify="right")
    return table
