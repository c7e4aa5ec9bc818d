"""The task of lifting the steak with MuJoCo's flex in the steak's place: what a control step costs, how exact each is.

Arm, hand, block, start and random actions are those of `mjframes.dm.lift`; the flex has the voxels' stiffness, the
steak's damping and its contacts. Errors are those of the report's steak, which is held at one end and pulled at the
other, against finite elements; there are the flexes of each kind that `make bench-worlds` shows.

    python -m benchmarks.speed.lift_flex --mujoco4 .venv-mujoco4/bin/python
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np
from dm_control import mjcf
from numpy.typing import NDArray
from rich.table import Table

from benchmarks.contenders.flex import ORDER, FlexProcess, best_flex
from benchmarks.contenders.frames import Setting, solved
from benchmarks.solids.cases import STEAK, steak
from benchmarks.solids.reference import refined
from benchmarks.speed.tasks import HOLD
from benchmarks.speed.worlds import FLEX_DOFS
from benchmarks.tables import screen, show, table_of
from mjframes.base.errors import MjframesError
from mjframes.cli.arguments import Parser
from mjframes.cli.commands import exit_code
from mjframes.dm import lift, lifting

Array = NDArray[np.float64]

ACTIONS, ACTIONS_FLEX = 250, 20  # control steps of an episode, and of a flex's, which takes long
EPISODES = 3  # of which the median is taken
TOUCH = f"""<contact selfcollide="none" condim="{lift.CONTACT.condim}" priority="{lift.CONTACT.priority}"
    friction="{" ".join(map(str, lift.CONTACT.friction or ()))}"/>"""
NOTE = """\
env-steps/s: control steps of 40 ms a processor second, random actions, of MuJoCo alone.  error: of displacements of the
steak that is held and pulled, at rest, against finite elements."""


@dataclass(frozen=True)
class Lifting:
    """One way to make the steak that is lifted.

    error: relative L2 of displacements.  rate: env-steps a processor second.  warnings: of MuJoCo, by name.
    """

    name: str
    dofs: int
    error: float
    rate: float
    warnings: dict[str, int]


@dataclass(frozen=True, eq=False)
class Episode:
    """What both kinds of steak are given.

    qpos: where ours starts.  joints: the arm's and the hand's angles [rad].
    turn, position: pose of the steak's coordinates.  controls: (ACTIONS, 9) [rad/s].
    """

    qpos: Array
    joints: dict[str, float]
    turn: Array
    position: Array
    controls: Array


def episodes(scene: lift.Scene, physics: mjcf.Physics, count: int) -> list[Episode]:
    """Return starts of the task and random actions."""
    model, random, found = physics.model.ptr, np.random.default_rng(0), []
    at = scene.layout(model)
    names = [joint.full_identifier for joint in (*scene.arm.joints, *scene.hand.joints)]
    limit = model.actuator_ctrlrange[:, 1]
    for _ in range(count):
        qpos = lifting.starting(model, at, random).qpos
        physics.data.qpos[:] = qpos
        physics.forward()
        position, quaternion = scene.steak.get_pose(physics)
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, quaternion)
        joints = dict(zip(names, qpos[[*at.arm, *at.hand]].tolist(), strict=True))
        drawn = np.repeat(random.uniform(-limit, limit, (ACTIONS // HOLD, len(limit))), HOLD, axis=0)
        found.append(Episode(qpos, joints, turn.reshape(3, 3), position, drawn))
    return found


def own_rate(model: mujoco.MjModel, episode: Episode) -> tuple[float, dict[str, int]]:
    """Return control steps a processor second of the steak of frames, and MuJoCo's warnings."""
    data = mujoco.MjData(model)
    data.qpos[:] = episode.qpos
    mujoco.mj_forward(model, data)
    before = time.process_time()
    for control in episode.controls:
        data.ctrl[:] = control
        mujoco.mj_step(model, data, nstep=lifting.STEPS)
    seconds = time.process_time() - before
    warned = {mujoco.mjtWarning(i).name: int(w.number) for i, w in enumerate(data.warning) if w.number}
    return len(episode.controls) / seconds, warned


def measure(python: str) -> tuple[list[Lifting], list[str]]:
    """Return the steak of frames and, in its place, the flex of each kind; and a line of each that MuJoCo refuses."""
    case = steak(STEAK)
    known = refined(case)
    most = known.error(solved(case, Setting(lift.FRAMES), known.load).moved)
    scene = lift.scene()
    physics = mjcf.Physics.from_mjcf_model(scene.arena.mjcf_model)
    model, both = physics.model.ptr, episodes(scene, physics, EPISODES)
    whole = replace(case, fixed=np.zeros_like(case.fixed))
    mine: list[float] = []
    found: list[Lifting] = []
    refused: list[str] = []
    warned: dict[str, int] = {}
    scene.steak.detach()
    with tempfile.TemporaryDirectory() as folder, FlexProcess(python) as process:
        mjcf.export_with_assets(scene.arena.mjcf_model, folder, "scene.xml")
        for kind in ORDER:
            best, _ = best_flex(case, kind, known, most, FLEX_DOFS, process)
            if best is None:
                continue
            rates, warnings = [], {}
            try:
                flex = process.placed(whole, best.setting, Path(folder) / "scene.xml", TOUCH, lift.DAMPING[1])
                for one in both:  # in turns: a machine that is busy for a while is so for both
                    rate, some = own_rate(model, one)
                    mine.append(rate)
                    warned |= some
                    controls = one.controls[:ACTIONS_FLEX]
                    seconds, some = flex.act(one.joints, one.turn, one.position, controls, lifting.STEPS)
                    rates.append(len(controls) / seconds)
                    warnings |= some
                found.append(Lifting(best.name, flex.dofs, best.error, float(np.median(rates)), warnings))
            except MjframesError as reason:
                refused.append(f"{best.name}: {str(reason).removeprefix('flex: ')}")
            process.forget()
    return [Lifting(f"{lift.FRAMES} frames", model.nv, most, float(np.median(mine)), warned), *found], refused


def table(found: Sequence[Lifting]) -> Table:
    """Return one row each."""
    shown = table_of("Lifting the steak", "degrees of freedom", "error", "env-steps/s", "× slower", "warnings")
    for one in found:
        slower = f"{found[0].rate / one.rate:.1f}"
        warned = ", ".join(f"{number} × {name}" for name, number in one.warnings.items()) or "0"
        shown.add_row(one.name, str(one.dofs), f"{100 * one.error:.1f} %", f"{one.rate:.2f}", slower, warned)
    return shown


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; return the exit code."""
    parser = Parser(prog="python -m benchmarks.speed.lift_flex", description="Lift a steak of frames and one of flex.")
    parser.add_argument("--mujoco4", metavar="PYTHON", required=True, help="a Python that has MuJoCo 4.0.0, for flex")
    found, refused = measure(parser.parse_args(argv).mujoco4)
    show(screen(), table(found), "\n".join([NOTE, *refused]))
    return 0


if __name__ == "__main__":
    raise SystemExit(exit_code(main))
