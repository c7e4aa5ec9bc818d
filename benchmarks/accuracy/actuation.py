"""How far chambers, cables and muscles move a body, beside finite elements: the mean of its end face, at rest.

Finite elements (solids/actuated.py) are bricks of order 2 on the voxels of half the body, geometrically non-linear, of
the law that the body has, and once more of neo-Hooke's, which says what the law matters. Pressure follows the walls.
`mesh` is how much farther the smallest force moves bricks that are half as large: what the reference is off by.

    python -m benchmarks.accuracy.actuation
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from benchmarks.solids.actuated import LAWS, Law, equilibria
from benchmarks.solids.bricks import Bricks, at_points, bricks
from benchmarks.solids.lengths import Field, Length, walls
from benchmarks.solids.lengths import Path as CablePath
from benchmarks.tables import screen, show, table_of, write_table
from examples import finger
from mjframes.body.build import build
from mjframes.cli.arguments import Parser
from mjframes.cli.commands import exit_code
from mjframes.frames.supports import Fixed
from mjframes.scene.attach import attach
from mjframes.scene.muscles import Muscle
from mjframes.scene.tendons import Chamber, Fibre
from mjframes.scene.view import soft
from mjframes.volume.grid import voxel_grid
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

Array = NDArray[np.float64]
Row = tuple[Any, ...]  # of COLUMNS

TABLE = Path(__file__).with_suffix(".csv")
COLUMNS = ("body", "force", "unit", "frames", "tip", "reference", "neo_hooke", "mesh")  # tips [m]
FRAMES = (5, 10)
LONGEST = 30_000  # [steps] until a body has to rest
STILL, QUIET = 1e-3, 20  # [1/s] of the way, the speed that counts as rest; in how many looks, ten steps apart


@dataclass(frozen=True, eq=False)
class Case:
    """A body that is symmetric about the middle of y, held at the first layer along x, and one tendon.

    tendon: of the body.
    length: the same in bricks, of the half y ≥ middle with its corner at the origin.
    forces: on the tendon, ascending in size, each a multiple of `increment` of the last one.
    unit: of the forces.
    axis: along which the end moves most.
    """

    name: str
    volume: Volume
    tendon: Any
    length: Callable[[Bricks], Length]
    forces: tuple[float, ...]
    unit: str
    axis: int = 2

    def end(self) -> Array:
        """Return the centres (n, 3) [m] of the voxels of the last layer, from the first corner."""
        last, *across = self.volume.labels.shape
        index = np.stack(np.meshgrid([last - 1], *map(np.arange, across), indexing="ij"), axis=-1)
        return (index.reshape(-1, 3) + 0.5) * self.volume.spacing

    def held(self) -> NDArray[np.bool_]:
        """Return the voxels that do not move, a mask (nx, ny, nz)."""
        mask = np.zeros(self.volume.labels.shape, bool)
        mask[0] = True
        return mask


def finger_case() -> Case:
    """Return the finger of examples/finger.py."""
    return _chamber_case("finger", finger.volume(), (100.0, 5000.0, 10000.0))


def sheet_case() -> Case:
    """Return a finger of that size whose lowest layer is a firm sheet, with a chamber above it."""
    labels = finger.volume().labels.copy()
    labels[labels == 0] = 1
    labels[3:-2, 2:-2, 3:-2] = 0
    labels[:, :, 0] = 2
    return _chamber_case("finger on a sheet", _firm(labels, finger.EDGE, 2e5, 0.4), (100.0, 5000.0, 10000.0))


def bellows_case() -> Case:
    """Return bellows on a firm sheet: a chamber that is wider and higher every other two layers."""
    labels = np.ones((41, 10, 10), np.uint8)
    labels[3:-2, 3:-3, 3:-2] = 0
    for start in range(3, 39, 4):
        labels[start : start + 2, 2:-2, 3:-1] = 0
    labels[:, :, 0] = 2
    return _chamber_case("bellows on a sheet", _firm(labels, 2.5e-3, 1e5, 0.45), (100.0, 1500.0, 3000.0))


def tube_case() -> Case:
    """Return a tube that becomes longer."""
    labels = np.ones((33, 8, 8), np.uint8)
    labels[3:-2, 2:-2, 2:-2] = 0
    volume = Volume.from_labels(labels, 2.5e-3, {1: Material(1e5, 0.45, 1000)})
    return _chamber_case("tube", volume, (100.0, 2000.0, 4000.0), axis=0)


def _firm(labels: NDArray[np.uint8], edge: float, young: float, poisson: float) -> Volume:
    """A volume of rubber (1) and a sheet (2) that is 50 times as stiff."""
    materials = {1: Material(young, poisson, 1000), 2: Material(50 * young, 0.4, 1000)}
    return Volume.from_labels(labels, edge, materials)


def _chamber_case(name: str, volume: Volume, forces: tuple[float, ...], axis: int = 2) -> Case:
    """A volume whose one cavity is a chamber."""
    cavity = volume.labels == 0
    half = cavity.shape[1] // 2

    def length(mesh: Bricks) -> Length:
        return walls(mesh, np.kron(cavity[:, half:], np.ones((mesh.split,) * 3, bool)))

    return Case(name, volume, Chamber(cavity), length, forces, "Pa", axis)


def cantilever_case() -> Case:
    """Return a solid bar, five times as long as thick, with a cable below the middle that ends at a firm plate."""
    size, across = 0.02, 6  # [m], voxels
    edge = size / across
    labels = np.ones((5 * across + 2, across, across), np.uint8)
    labels[-1] = 2
    materials = {1: Material(2e5, 0.4, 1000), 2: Material(2e7, 0.4, 1000)}
    volume = Volume.from_labels(labels, edge, materials)
    low = edge  # [m] above the lower side
    x = (np.arange(len(labels)) + 0.5) * edge
    points = np.column_stack([x, np.full_like(x, size / 2), np.full_like(x, low)])
    path = CablePath(np.array([(at, 0.0, low) for at in x], np.float64), share=0.5)
    pull = 2e5 * size**4 / 12 * np.radians(45) / ((size / 2 - low) * 5 * size)  # EI θ / (e L) [N]
    forces = tuple(float(-share * pull) for share in (0.02, 0.5, 1.0))
    return Case("cantilever", volume, Fibre(list(points)), lambda mesh: path, forces, "N")


def muscle_case(name: str, across: int = 4, upper: bool = True) -> Case:
    """Return a bar whose upper half, or all of it, is a muscle along it."""
    labels = np.ones((4 * across + 1, across, across), np.uint8)
    if upper:
        labels[:, :, across // 2 :] = 2
    flesh = Material(2e5, 0.4, 1000)
    volume = Volume.from_labels(labels, 0.02 / across, {1: flesh, 2: flesh})
    half = labels[:, across // 2 :]

    def length(mesh: Bricks) -> Length:
        some = np.flatnonzero(half[half > 0][mesh.voxel] == labels.max())
        return Field(some, np.tile([1.0, 0, 0], (len(some), 1)))

    tendon = Muscle(int(labels.max()), (1, 0, 0))
    return Case(name, volume, tendon, length, (-200.0, -10000.0, -20000.0), "Pa", 2 if upper else 0)


def cases() -> list[Case]:
    """Return what is measured."""
    chambers = [finger_case(), sheet_case(), bellows_case(), tube_case()]
    return [*chambers, cantilever_case(), muscle_case("muscle, upper half"), muscle_case("muscle", upper=False)]


def reference(case: Case, law: Law, forces: Sequence[float], split: int = 1) -> Array:
    """Return how far finite elements move the end (f, 3) [m] under each force."""
    half = case.volume.labels.shape[1] // 2
    volume = Volume.from_labels(case.volume.labels[:, half:], case.volume.spacing, case.volume.materials)
    grid = voxel_grid(volume)
    held = grid.index[:, 0] == 0
    mesh, low = (bricks(grid, held, order, parts, mirrored=True) for order, parts in ((2, split), (1, 2 * split)))
    end = case.end() - (0, half * volume.spacing[1], 0)
    shapes = at_points(mesh, end[end[:, 1] > 0])
    found = equilibria(mesh, low, law, [(case.length(mesh), forces[-1])], [force / forces[-1] for force in forces])
    return np.array([(shapes @ moved).mean(axis=0) for moved in found]) * (1, 0, 1)


def simulated(case: Case, frames: int, law: str) -> Array:
    """Return how far the body of frames moves the end (f, 3) [m] under each force, after steps until it rests."""
    body = build(case.volume, frames, law=law, supports=Fixed(case.held()))
    spec = mujoco.MjSpec()
    spec.option.gravity = [0, 0, 0]
    attach(spec, body, "body", contact=False, tendons={"tendon": case.tendon})
    motor = spec.add_actuator(name="motor", target="tendon", trntype=mujoco.mjtTrn.mjTRN_TENDON)
    motor.set_to_motor()
    model = spec.compile()
    data = mujoco.MjData(model)
    view = soft(model, data, "body", body)
    end = case.end() + case.volume.origin
    mujoco.mj_forward(model, data)
    start, found = view.positions(end), []
    for force in case.forces:
        data.ctrl[0], quiet = force, 0
        for _ in range(LONGEST // 10):
            mujoco.mj_step(model, data, nstep=10)
            quiet = quiet + 1 if np.abs(data.qvel).max() < STILL * np.abs(data.qpos).max() else 0
            if quiet == QUIET:  # a swing is slow at its ends only
                break
        mujoco.mj_forward(model, data)
        found.append((view.positions(end) - start).mean(axis=0))
    return np.array(found)


def measured(case: Case, law: str, refine: bool, progress: Callable[[str], None]) -> list[Row]:
    """Return the rows of a case."""
    progress(f"{case.name}: finite elements")
    exact = reference(case, LAWS[law], case.forces)[:, case.axis]
    other = reference(case, LAWS["neo-hookean"], case.forces)[:, case.axis]
    mesh = float("nan")
    if refine:
        progress(f"{case.name}: finite elements, refined")
        mesh = reference(case, LAWS[law], case.forces[:1], 2)[0, case.axis] / exact[0] - 1
    rows = []
    for frames in FRAMES:
        progress(f"{case.name}: {frames} frames")
        tips = simulated(case, frames, law)[:, case.axis]
        rows += [
            (case.name, force, case.unit, frames, *map(float, values), mesh)
            for force, *values in zip(case.forces, tips, exact, other, strict=True)
        ]
    return rows


def kept(path: Path) -> dict[str, list[Row]]:
    """Return the rows of a table from earlier, by body."""
    found: dict[str, list[Row]] = {}
    if path.is_file():
        with path.open(encoding="utf-8") as file:
            for name, force, unit, frames, *values in list(csv.reader(file))[1:]:
                found.setdefault(name, []).append((name, float(force), unit, int(frames), *map(float, values)))
    return found


def main(argv: Sequence[str] | None = None) -> int:
    parser = Parser(prog="python -m benchmarks.accuracy.actuation", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--only", metavar="BODY", help="the one body to measure; the rows of others stay")
    parser.add_argument("--no-refined", action="store_true", help="leave the refined finite elements out")
    parser.add_argument("--table", type=Path, default=TABLE, help="file to write (default: that of the clone)")
    arguments = parser.parse_args(argv)
    console = screen()
    rows = kept(arguments.table)
    for case in cases():
        if arguments.only in (None, case.name):
            rows[case.name] = measured(case, "corotational", not arguments.no_refined, console.print)
            write_table(arguments.table, COLUMNS, [row for known in cases() for row in rows.get(known.name, [])])
    table = table_of("Tip at rest", "force", "frames", "tip [mm]", "elements", "tip/elements", "neo-Hooke", "mesh")
    shown = [arguments.only] if arguments.only else rows
    for name, force, unit, frames, tip, exact, other, mesh in (row for body in shown for row in rows.get(body, [])):
        table.add_row(
            name, f"{force:g} {unit}", str(frames), f"{1e3 * tip:.4f}", f"{1e3 * exact:.4f}", f"{tip / exact:.3f}",
            f"{other / exact:.3f}", f"{mesh:+.1%}",
        )  # fmt: skip
    show(console, table)
    return 0


if __name__ == "__main__":
    raise SystemExit(exit_code(main))
