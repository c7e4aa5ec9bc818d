"""What taxels cost: steps a second of a pad under a ball and under a box, with and without them.

python -m benchmarks.speed.taxels
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from statistics import median

import mujoco
import numpy as np

from benchmarks.speed.instructions import instructions
from benchmarks.speed.step_scenes import Run
from benchmarks.tables import screen, show, table_of
from mjframes.body.build import build
from mjframes.body.soft_body import SoftBody
from mjframes.cli.arguments import Parser
from mjframes.cli.commands import exit_code
from mjframes.frames.supports import Fixed
from mjframes.scene import plugin
from mjframes.scene.attach import attach
from mjframes.scene.contact import Contact
from mjframes.scene.solver import choose_solver
from mjframes.scene.taxels import TaxelGrid, add_taxels
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

FRAMES, TIMESTEP, SETTLED, STEPS = 5, 0.002, 300, 400
TAXELS, MARKERS = (16, 16), (9, 7)
OBJECTS = {
    "ball": '<geom type="sphere" size=".03" mass=".5"/>',
    "box": '<geom type="box" size=".02 .02 .02" mass="2"/>',
}
HEIGHTS = {"ball": 0.03, "box": 0.02}  # [m]
SENSORS: Mapping[str, tuple[str, ...]] = {
    "without": (),
    "markers": ("markers",),
    "traction": ("traction",),
    "traction, markers": ("traction", "markers"),
    "and resultant, centre": ("traction", "markers", "resultant", "pressure_centre"),
}
NOTE = f"""\
A pad of 10 × 10 × 2 cm with {FRAMES} frames, glued at its base; 16 × 16 taxels, 9 × 7 markers.
steps a second: of one core, median of runs in turns.  instructions: of a step, by valgrind; without it, left out."""


@cache
def _pad() -> SoftBody:
    volume = Volume.box((0.1, 0.1, 0.02), Material(1e5, 0.45, 1000), spacing=0.005)
    return build(volume, FRAMES, supports=Fixed(volume.side("-z")), damping=(0, 0.02))


def scene(name: str, quantities: Sequence[str], dents: bool) -> Run:
    """Return steps of the pad under an object that lies there, with sensors."""
    body = f'<body pos="0 0 {0.01 + HEIGHTS[name]}"><freejoint/>{OBJECTS[name]}</body>'
    spec = mujoco.MjSpec.from_string(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    spec.option.timestep = TIMESTEP
    attach(spec, _pad(), "pad", contact=Contact(dents=dents))
    for quantity in quantities:
        shape = MARKERS if quantity == "markers" else TAXELS
        add_taxels(spec, _pad(), "pad", TaxelGrid((0, 0, 0.01), (0, 0, 1), (0.08, 0.08), shape), quantity)
    choose_solver(spec)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=SETTLED)
    state = np.empty(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_INTEGRATION))
    mujoco.mj_getState(model, data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
    return Run("pad", FRAMES, name, ", ".join(quantities), model, data, state)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; return the exit code."""
    parser = Parser(prog="python -m benchmarks.speed.taxels", description="Measure what taxels cost.")
    parser.add_argument("--rounds", type=int, default=7, help="how often everything is measured (default: 7)")
    arguments = parser.parse_args(argv)
    plugin.load()
    table = table_of("Steps of a pad with taxels", "object", "dents", "steps a second", "instructions")
    for name in OBJECTS:
        for dents in (False, True):
            runs = {label: scene(name, quantities, dents) for label, quantities in SENSORS.items()}
            seconds: dict[str, list[float]] = {label: [] for label in runs}
            for _ in range(arguments.rounds):
                for label, run in runs.items():
                    seconds[label].append(run.step(STEPS) / STEPS)
            for label, run in runs.items():
                counted = instructions(run)
                known = f"{counted:,.0f}" if counted else ""
                table.add_row(label, name, "yes" if dents else "no", f"{1 / median(seconds[label]):,.0f}", known)
    show(screen(), table, NOTE)
    return 0


if __name__ == "__main__":
    raise SystemExit(exit_code(main))
