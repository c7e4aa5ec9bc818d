"""The command `python -m benchmarks.speed.dents`: what dents cost a step, of the steak on a floor and on an edge.

Scenes with and without dents take turns, and the least time of the processor counts.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np

from benchmarks.tables import screen, show, table_of
from mjframes.body.build import build
from mjframes.body.soft_body import SoftBody
from mjframes.cli.arguments import Parser
from mjframes.cli.commands import exit_code
from mjframes.scene.attach import attach
from mjframes.scene.contact import Contact
from mjframes.scene.solver import choose_solver
from mjframes.volume.volume import Volume

STEAK = Path(__file__).parents[2] / "models" / "steak.npz"
FRAMES = (3, 10, 20)
BELOW = {"floor": (0.03, ""), "edge": (0.13, '<geom type="box" size=".1 .3 .05" pos="-.1 0 .05"/>')}
STEPS, TURNS = 400, 3
SCENE = """<mujoco><option timestep="0.002"/><worldbody><geom type="plane" size="1 1 .1"/>{}</worldbody></mujoco>"""


def main(argv: Sequence[str] | None = None) -> int:
    """Print the table; return the exit code."""
    parser = Parser(prog="python -m benchmarks.speed.dents", description="Measure what dents cost.")
    parser.parse_args(argv)
    volume = Volume.load(STEAK)
    found = table_of("A step of the steak", "with dents [µs]", "without [µs]", "ratio")
    for frames in FRAMES:
        body = build(volume, frames)
        for below in BELOW:
            least = {True: np.inf, False: np.inf}
            for _ in range(TURNS):
                for dents in least:
                    least[dents] = min(least[dents], step_time(body, below, dents))
            times = (f"{1e6 * least[dents]:.0f}" for dents in least)
            found.add_row(f"{frames} frames, {below}", *times, f"{least[True] / least[False]:.2f}")
    show(screen(), found)
    return 0


def step_time(body: SoftBody, below: str, dents: bool) -> float:
    """Time of the processor for a step [s], once the steak has fallen."""
    height, geoms = BELOW[below]
    spec = mujoco.MjSpec.from_string(SCENE.format(geoms))
    attach(spec, body, "steak", pos=(0, 0, height), contact=Contact(dents=dents))
    choose_solver(spec)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=STEPS)
    start = time.process_time()
    mujoco.mj_step(model, data, nstep=STEPS)
    return (time.process_time() - start) / STEPS


if __name__ == "__main__":
    raise SystemExit(exit_code(main))
