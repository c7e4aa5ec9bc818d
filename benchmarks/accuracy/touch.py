"""Force where something presses, beside finite elements at the same depth: two flat punches and a ball, from above.

A body is built with the defaults and pressed in `mj_step` without gravity, as `mjframes press` does. The depth counts
from the first force on and is 5 % of what is below. The finite elements are linear (solids/pressed.py).

    python -m benchmarks.accuracy.touch
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import mujoco
import numpy as np

from benchmarks.solids.pressed import Pressed, exact_forces, pressed_bodies
from benchmarks.tables import screen, show, table_of, write_table
from mjframes.app.press import Indenter, press
from mjframes.base.errors import MjframesError
from mjframes.body.build import build
from mjframes.cli.arguments import Parser
from mjframes.cli.commands import exit_code
from mjframes.frames.supports import Fixed
from mjframes.scene.attach import attach
from mjframes.scene.solver import choose_solver

Row = tuple[str, str, float, float, int, float]  # of COLUMNS

TABLE = Path("out/touch.csv")
COLUMNS = ("body", "indenter", "depth", "exact", "frames", "force")  # [m], [N]
FRAMES = (1, 5, 20)
BANDS = ((0.85, 1.15), (0.6, 1.8))  # [-] of the exact force: good, and what nine of ten are in


def measured(some: Pressed, counts: Sequence[int], progress: Callable[[str], None]) -> list[Row]:
    """Return the rows of a body."""
    progress(f"{some.name}: finite elements")
    exact, rows = exact_forces(some), []
    for frames in counts:
        progress(f"{some.name}: {frames} frames")
        rows += [
            (some.name, f"{one.kind} {1e3 * one.size:.3g} mm", some.depth, float(right), frames, force)
            for one, right, force in zip(some.indenters(), exact, forces_of(some, frames), strict=True)
        ]
    return rows


def forces_of(some: Pressed, frames: int) -> list[float]:
    """Return the force of each indenter on a body of frames [N], NaN where `press` refuses."""
    body = build(some.volume, frames, supports=Fixed(some.fixed))
    spec = mujoco.MjSpec()
    spec.option.gravity = [0, 0, 0]
    attach(spec, body, "body")
    choose_solver(spec)
    spec.compile()
    with tempfile.TemporaryDirectory() as folder:
        scene = Path(folder) / "pressed.xml"
        scene.write_text(spec.to_xml(), encoding="utf-8")
        return [_force(scene, one, some) for one in some.indenters()]


def _force(scene: Path, indenter: Indenter, some: Pressed) -> float:
    try:
        found = press(scene, indenter, some.depth, at=(*some.axis, 0.0))
    except MjframesError:
        return float("nan")
    return float(np.interp(some.depth, found.depth, found.force))


def main(argv: Sequence[str] | None = None) -> int:
    parser = Parser(prog="python -m benchmarks.accuracy.touch", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--only", metavar="BODY", help="the one body to measure; the table is not written")
    parser.add_argument("--frames", type=int, nargs="+", default=FRAMES, help="how many")
    parser.add_argument("--table", type=Path, default=TABLE, help=f"file to write (default: {TABLE})")
    arguments = parser.parse_args(argv)
    console, rows = screen(), list[Row]()
    table = table_of("Force / finite elements", "indenter", "depth [mm]", "force [N]", *map(str, arguments.frames))
    for some in pressed_bodies():
        if arguments.only not in (None, some.name):
            continue
        found = measured(some, arguments.frames, console.print)
        rows += found
        for indenter in dict.fromkeys(row[1] for row in found):
            mine = [row for row in found if row[1] == indenter]
            shown = [f"{force / exact:.2f}" for *_, exact, _, force in mine]
            table.add_row(some.name, indenter, f"{1e3 * mine[0][2]:.2f}", f"{mine[0][3]:.3g}", *shown)
    if arguments.only is None:
        write_table(arguments.table, COLUMNS, rows)
    ratios = [force / exact for *_, exact, _, force in rows]
    inside = [(sum(low <= ratio <= high for ratio in ratios), low, high) for low, high in BANDS]
    note = "; ".join(f"{count} of {len(ratios)} within {low:g} to {high:g}" for count, low, high in inside)
    show(console, table, note)
    return 0


if __name__ == "__main__":
    raise SystemExit(exit_code(main))
