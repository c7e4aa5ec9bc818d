"""What many worlds cost: `make bench-worlds`.

The steak of three frames lies on the edge of a box, each world with a stiffness of its own, stepped by `mujoco.batch`:
world-steps a second, beside one world stepped alone; whether each world is the single run of its stiffness, bit by bit;
memory, beside the same bodies without the plugin with as many contacts. Then the task of lifting the steak beside what
others published of theirs; and the report's steak, pulled, beside MuJoCo's flex of each kind, of as many cells as it
takes to be as exact, or else the most exact that comes to rest.
"""

from __future__ import annotations

import copy
import gc
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import mujoco
import numpy as np
from mujoco.batch import Batch
from rich.table import Table

from benchmarks.contenders.equilibrium import TIMED_STEP
from benchmarks.contenders.flex import ORDER, FlexProcess, best_flex
from benchmarks.contenders.frames import Setting, solved
from benchmarks.contenders.side_by_side import batch_rate, integration_state, single_rate
from benchmarks.solids.cases import STEAK, Case
from benchmarks.solids.cases import steak as pulled_steak
from benchmarks.solids.reference import refined
from benchmarks.speed.step_scenes import BARE, OURS, bare_run, soft_run
from benchmarks.tables import machine, screen, show, table_of, write_table
from mjframes.base.errors import MjframesError
from mjframes.body.build import build
from mjframes.cli.arguments import Parser
from mjframes.cli.commands import exit_code
from mjframes.scene import plugin
from mjframes.volume.volume import Volume

OUTPUT = Path("out") / "bench-worlds.csv"
FRAMES = 3
SETTLED = 150  # steps after which it lies on the box
CONTACTS = 200  # steps over which the bodies without plugin have as many contacts
WORLDS = (1, 16, 256, 1024, 4096)
THREADS = (1, 2)
FACTORS = (0.5, 2.0)  # of stiffness: the worlds' are spread between
LEAST = 20_000  # world-steps that a rate is taken of
ROUNDS = 3  # of which the median is taken
COMPARED, COMPARED_STEPS = 1000, 20  # worlds whose bits are compared, and for how many steps
HELD = 1000  # mjDatas, or worlds, whose memory is measured
FLEX_WORLDS, FLEX_LEAST = 8, 400
FLEX_DOFS = 2500  # of a flex that is tried: finer ones take minutes to come to rest, and are ever slower
LIFT_WORLDS, LIFT_ACTIONS = 64, 25

# env-steps/s of Isaac-Lift-Soft-Franka, in which a Franka lifts a soft block of one material, as measured by others:
# https://github.com/newton-physics/newton/issues/4141 (3 September 2026)
PUBLISHED = (
    ("Franka and block, Isaac Lab 3.0 with PhysX", 1024, "RTX 5090", 18_622),
    ("Franka and block, Isaac Lab 3.0 with Newton's MJWarp and VBD", 4096, "RTX 5090", 11_808),
)

RATE_NOTE = """\
× threads: world-steps a second over those of one world stepped alone, times the threads; by wall time, and by the time
that processors spend on it, which a busy machine does not change."""
MEMORY_NOTE = f"""\
Growth of the resident size by {HELD} of them after some steps with contacts, in a process of their own.
"{BARE}": the same bodies without the plugin, with as many contacts: MuJoCo's own."""
LIFT_NOTE = """\
Jaco and steak: mjframes.envs.LiftSteakVector, random actions of 40 ms, steps of the scene within.  Franka and block: a
task of another robot and body, https://github.com/newton-physics/newton/issues/4141; the machines are not alike."""
FLEX_NOTE = f"""\
Steps of 2 ms, no contact, from rest.  error: of displacements at rest, against finite elements.  Of each kind of flex
the coarsest is shown that is as exact as the frames, or else the most exact that comes to rest, of those of up to
{FLEX_DOFS:,} degrees of freedom."""


@dataclass(frozen=True)
class Rate:
    """World-steps a second of so many worlds on so many threads, and those of one world alone at the same time.

    wall, processor: a second of each.  alone, alone_processor: of one world.
    """

    worlds: int
    threads: int
    wall: float
    processor: float
    alone: float
    alone_processor: float

    @property
    def efficiency(self) -> float:
        """Return the share of threads times one world alone [-]."""
        return self.wall / (self.threads * self.alone)

    @property
    def processor_efficiency(self) -> float:
        """Return the same by processor time [-]."""
        return self.processor / self.alone_processor


def measure_all(mujoco4: str | None) -> None:
    """Measure, print tables, and write every number to out/bench-worlds.csv.

    mujoco4: a Python that has MuJoCo 4.0.0, for flex; None leaves flex out.
    """
    console = screen()
    for name, text in machine().items():
        console.print(f"{name:9}  {text}", highlight=False)
    body = build(Volume.load(STEAK), FRAMES)
    soft = soft_run("steak", body, "contact")
    bare = bare_run("steak", body, "contact", soft.contacts(CONTACTS)[0])
    models = {OURS: soft.model, BARE: bare.model}
    start = lying(models[OURS])
    rates = list(measure_rates(models[OURS], start, WORLDS, THREADS, LEAST))
    show(console, rate_table(rates), RATE_NOTE)
    different = [differences(models[OURS], start, COMPARED, threads, COMPARED_STEPS) for threads in THREADS]
    for threads, count in zip(THREADS, different, strict=True):
        console.print(f"{count} of {COMPARED:,} worlds differ from single runs of their stiffness, {threads} threads")
    memories = measure_memory(models)
    show(console, memory_table(memories), MEMORY_NOTE)
    rows: list[tuple[object, ...]] = [("machine", "", "", name, text, "") for name, text in machine().items()]
    rows += [("rate", r.worlds, r.threads, "wall", r.wall, "1/s") for r in rates]
    rows += [("rate", r.worlds, r.threads, "processor", r.processor, "1/s") for r in rates]
    rows += [("alone", r.worlds, r.threads, "wall", r.alone, "1/s") for r in rates]
    rows += [("alone", r.worlds, r.threads, "processor", r.alone_processor, "1/s") for r in rates]
    rows += [("differ", COMPARED, threads, "", count, "1") for threads, count in zip(THREADS, different, strict=True)]
    rows += [("memory", HELD, "", f"{name}, {way}", size, "byte") for (name, way), size in memories.items()]
    lifts = list(measure_lift(THREADS))
    show(console, lift_table(lifts), LIFT_NOTE)
    for threads, rates_of_lift in zip(THREADS, lifts, strict=False):
        pairs = zip(("wall", "processor"), rates_of_lift, strict=True)
        rows += [("lift", LIFT_WORLDS, threads, name, rate, "1/s") for name, rate in pairs]
    if mujoco4:
        beside, restless = measure_flex(pulled_steak(STEAK), mujoco4)
        show(console, flex_table(beside), "\n".join([FLEX_NOTE, *restless]))
        rows += [("flex", FLEX_WORLDS, 1, f"{one.name}, {key}", value, unit) for one in beside
                 for key, value, unit in (("error", one.error, "1"), ("rate", one.processor, "1/s"))]  # fmt: skip
    write_table(OUTPUT, ("table", "worlds", "threads", "row", "value", "unit"), rows)
    console.print(f"\n{OUTPUT} holds all of these numbers.", highlight=False)


def lying(model: mujoco.MjModel) -> np.ndarray:
    """Return the state in which the steak lies on the edge of the box."""
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=SETTLED)
    return integration_state(model, data)


def stiffnesses(model: mujoco.MjModel, worlds: int) -> np.ndarray:
    """Return `numeric_data` (worlds, nnumericdata) of worlds whose one soft body is each as stiff as no other."""
    (numeric,) = [i for i in range(model.nnumeric) if model.numeric(i).name.endswith(":stiffness")]
    found = np.tile(model.numeric_data, (worlds, 1))
    address = int(model.numeric_adr[numeric])
    found[:, address : address + int(model.numeric_size[numeric])] = np.geomspace(*FACTORS, worlds)[:, None]
    return found


def measure_rates(
    model: mujoco.MjModel, start: np.ndarray, worlds: Sequence[int], threads: Sequence[int], least: int
) -> Iterator[Rate]:
    """Yield the medians of rates that are taken in turns with those of one world alone."""
    for count in worlds:
        numerics = stiffnesses(model, count)
        single = copy.copy(model)
        single.numeric_data[:] = numerics[count // 2]
        for some in threads:
            pairs = [
                (batch_rate(model, start, count, some, least, numerics), single_rate(single, start, least // 4))
                for _ in range(ROUNDS)
            ]
            (wall, processor), (alone, alone_processor) = np.median(pairs, axis=0)
            yield Rate(count, some, wall, processor, alone, alone_processor)


def differences(model: mujoco.MjModel, start: np.ndarray, worlds: int, threads: int, steps: int) -> int:
    """Return how many worlds of one batch end in other bits than a single run with their stiffness."""
    numerics = stiffnesses(model, worlds)
    batch = Batch(model, worlds, threads)
    batch.expand("numeric_data")[:] = numerics
    batch.state[:] = start
    for _ in range(steps):
        batch.step()
    single, found = copy.copy(model), 0
    data = mujoco.MjData(single)
    for row, numeric in zip(batch.state, numerics, strict=True):
        single.numeric_data[:] = numeric
        mujoco.mj_setState(single, data, start, mujoco.mjtState.mjSTATE_INTEGRATION)
        mujoco.mj_step(single, data, nstep=steps)
        found += not np.array_equal(row, integration_state(single, data))
    return found


def measure_memory(models: dict[str, mujoco.MjModel]) -> dict[tuple[str, str], float]:
    """Return bytes of an mjData, and of a world of a batch, of each model."""
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        for number, (name, model) in enumerate(models.items()):
            path = str(Path(folder) / f"{number}.mjb")
            mujoco.mj_saveModel(model, path)
            for way in ("mjData", "world of a batch"):
                with ProcessPoolExecutor(1, get_context("spawn")) as pool:
                    found[name, way] = pool.submit(_grown, path, way == "mjData").result()
    return found


def _grown(path: str, alone: bool) -> float:
    """Bytes by which this process grows with each mjData, or world of a batch, of a binary model."""
    plugin.load()
    model = mujoco.MjModel.from_binary_path(path)
    warm = mujoco.MjData(model)  # what all of a model share
    mujoco.mj_step(model, warm, nstep=SETTLED)
    state = integration_state(model, warm)
    gc.collect()
    before = _resident()
    held: list[object] = []
    if alone:
        for _ in range(HELD):
            data = mujoco.MjData(model)
            mujoco.mj_setState(model, data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
            mujoco.mj_step(model, data, nstep=3)
            held.append(data)
    else:
        batch = Batch(model, HELD, 1)
        batch.state[:] = state
        if model.nnumeric:
            batch.expand("numeric_data")
        batch.step(nstep=3)
        held.append(batch)
    return (_resident() - before) / HELD


def _resident() -> int:
    """Bytes of this process that are in memory."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096


def measure_lift(threads: Sequence[int]) -> Iterator[tuple[float, float]]:
    """Yield env-steps of the steak that is lifted, with random actions, on so many threads: a second of wall time, and
    a second of the processor.

    Yield nothing where Gymnasium or dm_control is missing, or dm_control does not work with this MuJoCo.
    """
    try:
        from mjframes.envs.lift_steak import LiftSteakVector
    except (ImportError, MjframesError):
        return
    for some in threads:
        worlds = LiftSteakVector(LIFT_WORLDS, some)
        worlds.reset(seed=0)
        worlds.action_space.seed(0)
        actions = [worlds.action_space.sample() for _ in range(1 + LIFT_ACTIONS)]
        worlds.step(actions[0])
        start = time.perf_counter(), time.process_time()
        for action in actions[1:]:
            worlds.step(action)
        steps = LIFT_WORLDS * LIFT_ACTIONS
        yield steps / (time.perf_counter() - start[0]), steps / (time.process_time() - start[1])


@dataclass(frozen=True)
class Beside:
    """One way to make the pulled steak.

    error: relative L2 of the displacements.  wall, processor: world-steps a second on one thread.
    """

    name: str
    dofs: int
    error: float
    wall: float
    processor: float


def measure_flex(case: Case, python: str) -> tuple[list[Beside], list[str]]:
    """Return frames and the flex of each kind that goes beside them; and a line of each flex that came to no rest."""
    known = refined(case)
    mine = solved(case, Setting(FRAMES), known.load)
    most = known.error(mine.moved)
    model = mine.simulation.model
    model.opt.timestep = TIMED_STEP
    mujoco.mj_resetData(model, mine.simulation.data)
    mujoco.mj_forward(model, mine.simulation.data)
    mine.push()
    start = integration_state(model, mine.simulation.data)
    my_rates, found, restless = [], [], []
    with FlexProcess(python) as flex:
        for kind in ORDER:
            best, refused = best_flex(case, kind, known, most, FLEX_DOFS, flex)
            restless += refused
            if best:
                rates = []
                for _ in range(ROUNDS):  # in turns: a machine that is busy for a while is so for both
                    my_rates.append(batch_rate(model, start, FLEX_WORLDS, 1, 40 * FLEX_LEAST))
                    rates.append(best.contender.batch_rate(FLEX_WORLDS, 1, FLEX_LEAST))
                wall, processor = np.median(rates, axis=0).tolist()
                found.append(Beside(best.name, best.contender.dofs, best.error, wall, processor))
            flex.forget()
    wall, processor = np.median(my_rates, axis=0).tolist()
    return [Beside(f"{FRAMES} frames", mine.dofs, most, wall, processor), *found], restless


def rate_table(rates: Sequence[Rate]) -> Table:
    """Return one row for each number of worlds and threads."""
    columns = ("threads", "world-steps/s", "× threads", "a processor second", "× threads")
    table = table_of(f"Steps of so many worlds side by side, each a steak of {FRAMES} frames in contact", *columns)
    for r in rates:
        table.add_row(f"{r.worlds:,}", str(r.threads), f"{r.wall:,.0f}", f"{r.efficiency:.2f}",
                      f"{r.processor:,.0f}", f"{r.processor_efficiency:.2f}")  # fmt: skip
    return table


def memory_table(memories: dict[tuple[str, str], float]) -> Table:
    """Return the bytes of each, and what is beyond MuJoCo's own."""
    table = table_of("Memory, kB", "soft body", "MuJoCo's own", "beyond it")
    for way in dict.fromkeys(way for _, way in memories):
        own, bare = memories[OURS, way] / 1e3, memories[BARE, way] / 1e3
        table.add_row(way, f"{own:.1f}", f"{bare:.1f}", f"{own - bare:.1f}")
    return table


def lift_table(rates: Sequence[tuple[float, float]]) -> Table:
    """Return one row for each number of threads, and what others published."""
    table = table_of("Lifting a soft body", "worlds", "machine", "env-steps/s", "a processor second")
    for threads, (wall, processor) in zip(THREADS, rates, strict=False):
        here = f"this one, threads: {threads}"
        table.add_row("Jaco and steak", f"{LIFT_WORLDS:,}", here, f"{wall:,.0f}", f"{processor:,.0f}")
    for name, worlds, machine_name, rate in PUBLISHED:
        table.add_row(name, f"{worlds:,}", machine_name, f"{rate:,}", "–")
    return table


def flex_table(beside: Sequence[Beside]) -> Table:
    """Return one row for frames and each flex."""
    columns = ("degrees of freedom", "error", "world-steps/s, one thread", "a processor second", "× slower")
    table = table_of(f"The steak, pulled, {FLEX_WORLDS} worlds, beside MuJoCo's flex", *columns)
    for one in beside:
        ratio = f"{beside[0].processor / one.processor:.1f}"
        table.add_row(one.name, str(one.dofs), f"{100 * one.error:.1f} %", f"{one.wall:,.0f}", f"{one.processor:,.0f}",
                      ratio)  # fmt: skip
    return table


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; return the exit code."""
    parser = Parser(prog="python -m benchmarks.speed.worlds", description="Measure what many worlds side by side cost.")
    parser.add_argument("--mujoco4", metavar="PYTHON", help="a Python that has MuJoCo 4.0.0, for flex")
    measure_all(parser.parse_args(argv).mujoco4)
    return 0


if __name__ == "__main__":
    raise SystemExit(exit_code(main))
