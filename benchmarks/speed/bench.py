"""How long the precomputation takes and how many steps a second there are: `make bench`.

The steak is built with the three numbers of frames of the paper's Table 2, by the default method and by the paper's
with its samples. Its steps, by the default method, and with more frames in coarser voxels, are compared with those of
the same MuJoCo bodies without the plugin, and those of a beam with MuJoCo's own flex: see `step_scenes`. What is
compared is measured in turns, and medians are taken, so that a machine that slows down does so for all.
"""

from __future__ import annotations

import argparse
import math
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from benchmarks.contenders.flex import FlexProcess
from benchmarks.contenders.frames import nothing_kept
from benchmarks.solids import cases
from benchmarks.speed.flex_steps import beam, flex_run, matches
from benchmarks.speed.large import CELLS, Job, Measured, jobs_of, measure, ring_file
from benchmarks.speed.profile import contact_share
from benchmarks.speed.step_scenes import BARE, OURS, SCENES, Run
from benchmarks.speed.step_tables import (
    BEAM,
    STEAK,
    STEP_NOTE,
    contact_table,
    draw_steps,
    flex_table,
    readme_table,
    step_table,
)
from benchmarks.speed.steps import Group, Speed, counted, of, prepare
from benchmarks.speed.steps import measure as measure_steps
from benchmarks.tables import machine, screen, show, table_of, write_table
from mjframes.base.errors import MjframesError
from mjframes.base.texts import count
from mjframes.body.build import build
from mjframes.body.options import Paper
from mjframes.body.soft_body import SoftBody
from mjframes.cli.arguments import Parser
from mjframes.cli.commands import exit_code
from mjframes.volume.volume import Volume

OUTPUT = Path("out") / "bench.csv"
COLUMNS = ("table", "frames", "samples", "row", "value", "unit")


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

MANY_FRAMES = (40, 80, 160)  # whose steps are timed, too
COARSE = 8000  # [voxels] of the steak that has as many: steps do not depend on voxels, the time to build them does
BUILDS, ROUNDS = 3, 7  # of which medians are taken
QUICK_BUILDS, QUICK_ROUNDS = 1, 3
BEAM_FRAMES = 3
HOW = "MuJoCo's flex is left out: `make bench`, or --mujoco4 with a Python that has mujoco 4.0.0, brings it in."

LAWS = ("corotational", "neo_hookean")
COST_NOTE = """\
elasticity: free less its bodies alone, with the second inertia and factorization that it takes.
× MuJoCo's: on the edge over the bodies alone, whose contacts are of one body each and found at once.
× without elasticity: over the same less its elasticity: the same contacts of the same skin."""

LARGE_FRAMES = 10
LARGE_NOTE = """\
The faster of two runs, each in a process of its own, with the kernels compiled. Processor seconds: of all threads.
Bytes a cell: by how much the process grew, over the cells of the grid."""


@dataclass(frozen=True)
class Building:
    """Medians [s] of `build`: of each stage, of the whole, and of all processors together."""

    size: Size
    stages: dict[str, float]
    total: float
    processor: float


@dataclass(frozen=True)
class Cost:
    """What a law costs: mean number of points a region (none for the corotational one), and the speeds, free and in
    contact, of a body of that law and of its bodies alone.
    """

    law: str
    points: float
    speeds: tuple[Speed, ...]

    def step(self, scene: str, contender: str = OURS) -> float:
        """Return the time of a step [s]."""
        return of(self.speeds, scene=scene, contender=contender)[0].step

    @property
    def elasticity(self) -> float:
        """Return the time that elasticity takes in a step [s]."""
        return self.step("free") - self.step("free", BARE)

    @property
    def over_bodies(self) -> float:
        """Return the step with contacts over that of the bodies alone with as many [-]."""
        return self.step("contact") / self.step("contact", BARE)

    @property
    def over_no_elasticity(self) -> float:
        """Return the step with contacts over the same without the elasticity's part [-]."""
        return self.step("contact") / (self.step("contact") - self.elasticity)


@nothing_kept()
def main_of_steak(quick: bool = False, mujoco4: str | None = None, picture: str | None = None) -> None:
    """Measure, print tables, and write every number to out/bench.csv.

    quick: the paper's numbers of frames only, and less often.  mujoco4: a Python that has MuJoCo 4.0.0, for flex.
    picture: where times over frames are drawn (.png), if anywhere.
    """
    console = screen()
    rows: list[tuple[object, ...]] = [("machine", "", "", name, text, "") for name, text in machine().items()]
    for _, _, _, name, text, _ in rows:
        console.print(f"{name:9}  {text}", highlight=False)
    volume = Volume.load(cases.STEAK)
    console.print(f"{'volume':9}  {cases.STEAK.name}, {(volume.labels > 0).sum()} voxels", highlight=False)

    sizes = [size for papers in PAPER for size in (Size(papers.frames), papers)]
    with _progress(console) as progress:
        progress.add_task("building", total=None)
        built, buildings = measure_builds(volume, sizes, QUICK_BUILDS if quick else BUILDS)
    show(console, build_table(buildings[::2]))
    show(console, build_table(buildings[1::2]))

    bodies = {size.frames: body for size, body in zip(sizes, built, strict=True) if size.samples is None}
    if not quick:
        coarse = volume.resample(COARSE).largest_component()
        with _progress(console) as progress:
            progress.add_task("building bodies of many frames", total=None)
            bodies |= {frames: build(coarse, frames) for frames in MANY_FRAMES}
    rounds = QUICK_ROUNDS if quick else ROUNDS
    speeds, shares, note = measure_everything(console, bodies, rounds, mujoco4, counting=not quick)
    show(console, step_table(speeds, STEAK), STEP_NOTE)
    if of(speeds, body=BEAM):
        show(console, flex_table(speeds), note)
    else:
        console.print(note, highlight=False)
    show(console, contact_table(shares))

    costs = [measure_cost(volume, sizes[0], law, rounds) for law in LAWS]
    show(console, cost_table(costs), COST_NOTE)

    builds = {one.size.frames: one.processor for one in buildings if one.size.samples is None}
    table = readme_table(speeds, builds, {size.frames: numbers for size, numbers in PAPER.items()})
    console.print(f"\nThe table of docs/speed.md:\n{table}", highlight=False, soft_wrap=True, markup=False)
    if picture:
        draw_steps(speeds, picture)
        console.print(f"\n{picture} shows them.", highlight=False)

    rows += [("build", *b.size, stage, seconds, "s") for b in buildings for stage, seconds in b.stages.items()]
    rows += [("build", *b.size, "total", b.total, "s") for b in buildings]
    rows += [("build", *b.size, "processors", b.processor, "s") for b in buildings]
    for s in speeds:
        name = f"{s.body}, {s.scene}, {s.contender}"
        rows += [("step", s.frames, "", name, s.step, "s"), ("dofs", s.frames, "", name, s.dofs, "1")]
        rows += [
            ("contacts", s.frames, "", name, s.contacts, "1"),
            ("iterations", s.frames, "", name, s.iterations, "1"),
        ]
        if s.instructions is not None:
            rows.append(("instructions", s.frames, "", name, s.instructions, "1"))
    rows += [("share", frames, "", "the plugin's contacts", share, "1") for frames, share in shares.items()]
    rows += [("cost", *sizes[0], cost.law, cost.over_bodies, "1") for cost in costs]
    rows += [("elasticity", *sizes[0], cost.law, cost.over_no_elasticity, "1") for cost in costs]
    rows += [("paper", *size, "initialization", seconds, "s") for size, (seconds, _) in PAPER.items()]
    rows += [("paper", *size, "frames a second", rate, "1/s") for size, (_, rate) in PAPER.items()]
    write_table(OUTPUT, COLUMNS, rows)
    console.print(f"\n{OUTPUT} holds all of these numbers.", highlight=False)


def measure_everything(
    console: Console, bodies: Mapping[int, SoftBody], rounds: int, mujoco4: str | None, counting: bool
) -> tuple[list[Speed], dict[int, float], str]:
    """Return the speeds of the bodies, by frames, and of the beam beside flex; what share of steps in contact is the
    plugin's work on these; what is to be said of flex.
    """
    with FlexProcess(mujoco4) if mujoco4 else nullcontext() as process, _progress(console) as progress:
        task = progress.add_task("preparing scenes", total=None)
        found = {(frames, scene): prepare(STEAK, body, scene) for frames, body in bodies.items() for scene in SCENES}
        groups = {key: group for key, group in found.items() if group}
        beams, note = flex_groups(process) if process else ([], HOW)
        everything = [*groups.values(), *beams]
        progress.update(task, description="stepping", total=rounds * len(everything), completed=0)
        speeds = measure_steps(everything, rounds, lambda: progress.advance(task))
        progress.update(task, description="shares of a step", total=None)
        shares = {}
        for frames in bodies:
            if (frames, "contact") in groups:
                touching, free = (groups[frames, scene].runs[0] for scene in ("contact", "free"))
                assert isinstance(touching, Run)
                assert isinstance(free, Run)
                shares[frames] = contact_share(touching, free, groups[frames, "contact"].steps, rounds)
        progress.update(task, description="counting instructions")
        return counted(speeds, everything) if counting else speeds, shares, note


def flex_groups(process: FlexProcess) -> tuple[list[Group], str]:
    """Return the beam in all scenes, of frames, bodies alone and flex, and how exact these are.

    process: the `FlexProcess` that steps flex.
    """
    case = beam()
    chosen = matches(case, BEAM_FRAMES, process)
    body = build(case.volume, BEAM_FRAMES)
    groups, refused = [], []
    for place, scene in enumerate(SCENES):
        group = prepare(BEAM, body, scene)
        assert group
        runs = list(group.runs)
        for number, match in enumerate(chosen):
            try:
                runs.append(
                    flex_run(BEAM, match, scene, case.volume, len(chosen) * place + number, group.steps, process)
                )
            except MjframesError as error:
                refused.append(f"{match.contender}, {scene}: {error}")
        groups.append(Group(group.steps, tuple(runs)))
    lines = [
        f"In brackets: over that of frames. Flex is that of MuJoCo {process.version}, with the faster of its solvers."
    ]
    lines.append("Errors in the report's cantilever:")
    lines += [f"  {BEAM_FRAMES} frames {match.error_of_frames:.2%}" for match in chosen[:1]]
    for match in chosen:
        worse = "" if match.error <= match.error_of_frames else ", the most exact that was tried"
        lines.append(f"  {match.contender}, {match.setting.name} {match.error:.2%}{worse}")
    return groups, "\n".join([*lines, *refused])


def main_of_large() -> None:
    """Print the table of a ring of about a million voxels, and write it to out/bench.csv."""
    with tempfile.TemporaryDirectory() as folder:
        large = list(measure([Job(ring_file(folder), CELLS, LARGE_FRAMES)]))
    show(screen(), large_table(large), LARGE_NOTE)
    rows: list[tuple[object, ...]] = []
    rows += [("large", m.job.frames, "", f"{m.cells} cells", m.seconds, "s") for m in large]
    rows += [("rate", m.job.frames, "", f"{m.voxels} voxels", m.rate, "1/s") for m in large]
    rows += [("memory", m.job.frames, "", f"{m.cells} cells", m.memory / m.cells, "byte") for m in large]
    write_table(OUTPUT, COLUMNS, rows)


def main_of_file(source: str, count: int | None, frames: Sequence[int]) -> None:
    """Print the table of a mesh in a grid of `count` cells, or of a volume of `count` voxels."""
    show(screen(), large_table(list(measure(jobs_of(source, count, frames)))), LARGE_NOTE)


def large_table(measured: Sequence[Measured]) -> Table:
    """Return the table with one row a body."""
    columns = ("cells", "voxels", "seconds", "voxels/s", "processor seconds", "bytes a cell")
    table = table_of("Precomputation of large volumes, from the file to the saved body", *columns)
    for m in measured:
        table.add_row(
            f"{Path(m.job.source).stem}, {m.job.frames} frames",
            *(f"{m.cells:,}", f"{m.voxels:,}", f"{m.seconds:.2f}", f"{m.rate:,.0f}", f"{m.processor:.2f}"),
            f"{m.memory / m.cells:.0f}",
        )
    return table


def measure_builds(
    volume: Volume, sizes: Sequence[Size], repeats: int
) -> tuple[tuple[SoftBody, ...], tuple[Building, ...]]:
    """Return the soft bodies of the sizes, and how long it took to build them once the kernels were compiled."""
    for size in sizes[:2]:  # of each method
        build(volume, **size.options)
    timings: list[list[dict[str, float]]] = [[] for _ in sizes]
    processor: list[list[float]] = [[] for _ in sizes]
    bodies: tuple[SoftBody, ...] = ()
    for _ in range(repeats):
        built, stages, busy = zip(*(_timed_build(volume, size) for size in sizes), strict=True)
        bodies = built
        for timing, seconds, total, some in zip(timings, stages, processor, busy, strict=True):
            timing.append(seconds)
            total.append(some)
    return bodies, tuple(
        Building(
            size,
            {stage: median(timing[stage] for timing in repeated) for stage in repeated[0]},
            median(sum(timing.values()) for timing in repeated),
            median(busy),
        )
        for size, repeated, busy in zip(sizes, timings, processor, strict=True)
    )


def measure_cost(volume: Volume, size: Size, law: str, rounds: int) -> Cost:
    """Measure a body with elasticity of that law, free and in contact."""
    body = build(volume, **size.options, law=law)
    of_law = body.quadrature or body.cells
    points = float(np.mean([len(some) for some in of_law.volume])) if of_law else 0.0
    groups = [group for scene in ("free", "contact") if (group := prepare(STEAK, body, scene))]
    return Cost(law, points, tuple(measure_steps(groups, rounds)))


def build_table(buildings: Sequence[Building]) -> Table:
    """Return the seconds of each stage, one column a size."""
    table = table_of(
        "Precomputation, seconds, with the kernels compiled", *(str(building.size) for building in buildings)
    )
    for stage in buildings[0].stages:
        table.add_row(stage, *(f"{building.stages[stage]:.3f}" for building in buildings))
    table.add_row("total", *(f"{building.total:.2f}" for building in buildings), style="bold")
    table.add_row("of all processors together", *(f"{building.processor:.2f}" for building in buildings))
    table.add_row("the paper's", *(f"{found[1][0]:g}" if (found := _papers(b.size)) else "" for b in buildings))
    return table


def cost_table(costs: Sequence[Cost]) -> Table:
    """Return what elasticity adds to the same bodies, one row a law."""
    columns = ("points a region", "µs, contact", "elasticity, µs", "× MuJoCo's", "× without elasticity")
    table = table_of(f"Cost over the bodies alone, {costs[0].speeds[0].frames} frames", *columns)
    for cost in costs:
        table.add_row(
            cost.law,
            f"{cost.points:.1f}" if cost.points else "",
            f"{cost.step('contact') * 1e6:.1f}",
            f"{cost.elasticity * 1e6:.1f}",
            f"{cost.over_bodies:.1f}",
            f"{cost.over_no_elasticity:.2f}",
        )
    return table


def _timed_build(volume: Volume, size: Size) -> tuple[SoftBody, dict[str, float], float]:
    """The body, the seconds of each stage, and those of all processors together."""
    names: list[str] = []
    times: list[float] = []

    def progress(stage: str) -> None:
        names.append(stage.split(":")[0])
        times.append(time.perf_counter())

    before = time.process_time()
    body = build(volume, **size.options, progress=progress)
    times.append(time.perf_counter())
    processor = time.process_time() - before
    spent = dict.fromkeys(names, 0.0)
    for name, seconds in zip(names, np.diff(times).tolist(), strict=True):
        spent[name] += seconds
    return body, spent, processor


def _papers(size: Size) -> tuple[Size, tuple[float, float]] | None:
    """The paper's entry of as many frames."""
    return next((entry for entry in PAPER.items() if entry[0].frames == size.frames), None)


@contextmanager
def _progress(console: Console) -> Iterator[Progress]:
    """Show what is done, on a terminal only."""
    with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
        yield progress


def _amount(text: str) -> int:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value >= 1000):
        raise argparse.ArgumentTypeError(f"{text!r} is not a number from 1000 on")
    return int(value)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; return the exit code."""
    parser = Parser(
        prog="python -m benchmarks.speed.bench",
        description="Measure precomputation and steps, beside bodies alone and flex.",
    )
    parser.add_argument("file", nargs="?", metavar="FILE", help="only the precomputation of this mesh or volume")
    sizes = parser.add_mutually_exclusive_group()
    sizes.add_argument("--cells", dest="count", type=_amount, metavar="N", help="of a mesh's grid (default 7e6)")
    sizes.add_argument("--voxels", dest="count", type=_amount, metavar="N", help="inside a volume (default 5e5)")
    parser.add_argument("--frames", type=count, nargs="+", default=[3, 10, 20], metavar="N", help="(default 3 10 20)")
    parser.add_argument("--large", action="store_true", help="only the precomputation of about a million voxels")
    parser.add_argument("--quick", action="store_true", help="3, 10 and 20 frames only, and less often")
    parser.add_argument("--mujoco4", metavar="PYTHON", help="a Python that has MuJoCo 4.0.0, for flex")
    parser.add_argument("--picture", metavar="FILE", help="figure to write of times over frames (.png)")
    arguments = parser.parse_args(argv)
    if arguments.file:
        main_of_file(arguments.file, arguments.count, arguments.frames)
    elif arguments.large:
        main_of_large()
    else:
        main_of_steak(arguments.quick, arguments.mujoco4, arguments.picture)
    return 0


if __name__ == "__main__":
    raise SystemExit(exit_code(main))
