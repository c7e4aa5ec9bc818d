"""Random episodes of the tasks of `mjframes.dm`: what warns, what is not finite, what rewards come, what a step costs.

python -m benchmarks.speed.tasks lift_steak_features --episodes 1000
"""

from __future__ import annotations

import re
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from dm_control import composer
from dm_control.rl.control import PhysicsError
from rich.table import Table

from benchmarks.tables import screen, show, table_of
from mjframes import dm
from mjframes.cli.arguments import Parser
from mjframes.cli.commands import exit_code
from mjframes.scene.load import mujoco_warnings

HOLD = 10  # control steps that an action is held: what changes in every step moves next to nothing
NOTE = f"""\
Actions are drawn evenly from their bounds and held for {HOLD} control steps.
warnings: of MuJoCo and of the plugin, one of a kind an episode.  not finite: steps with an observation, a reward or a
state that is not.  failed: episodes that MuJoCo's warnings ended.  a processor second: without drawing lots."""


@dataclass(frozen=True)
class Tried:
    """What came of random episodes.

    warnings: number of each kind, by their words.
    infinite: steps with an observation, reward or state that is not finite.
    failed: episodes that MuJoCo's warnings ended.
    rewards: the lowest and the highest.
    returned: the mean of the episodes' sums.
    seconds: of the processor, without drawing lots.
    """

    task: str
    episodes: int
    steps: int
    warnings: dict[str, int]
    infinite: int
    failed: int
    rewards: tuple[float, float]
    returned: float
    seconds: float


def tried(task: str, episodes: int, seed: int = 0, most_steps: int | None = None) -> Tried:
    """Return what came of random episodes, each cut off behind `most_steps` control steps."""
    environment = dm.load(task, seed)
    random = np.random.default_rng(seed)
    rewards: list[float] = []
    infinite = failed = 0
    seconds = 0.0
    with mujoco_warnings() as warnings:
        for _ in range(episodes):
            step, count = environment.reset(), 0
            action = environment.action_spec()
            chosen = action.minimum
            while not step.last() and count != most_steps:
                if count % HOLD == 0:
                    chosen = random.uniform(action.minimum, action.maximum)
                start = time.process_time()
                try:
                    step = environment.step(chosen)
                except PhysicsError:
                    break
                finally:
                    seconds += time.process_time() - start
                count += 1
                rewards.append(float(step.reward or 0))
                infinite += not _finite(environment, [rewards[-1], *step.observation.values()])
            failed += any(counter.number for counter in environment.physics.data.ptr.warning)
    environment.close()
    kinds = Counter(_kind(text) for text in warnings)
    extremes = (min(rewards, default=0.0), max(rewards, default=0.0))
    return Tried(task, episodes, len(rewards), kinds, infinite, failed, extremes, sum(rewards) / episodes, seconds)


def table(found: Sequence[Tried]) -> Table:
    """Return one row a task."""
    columns = ("episodes", "steps", "warnings", "not finite", "failed", "rewards", "mean return", "a processor second")
    shown = table_of("Random episodes", *columns)
    for one in found:
        kinds = "\n".join(f"{number:,} × {kind}" for kind, number in one.warnings.items()) or "0"
        low, high = one.rewards
        shown.add_row(one.task, f"{one.episodes:,}", f"{one.steps:,}", kinds, f"{one.infinite:,}", f"{one.failed:,}",
                      f"{low:.3g} to {high:.3g}", f"{one.returned:.3g}", f"{one.steps / one.seconds:.0f}")  # fmt: skip
    return shown


def _finite(environment: composer.Environment, seen: Sequence[Any]) -> bool:
    data = environment.physics.data
    return all(np.isfinite(some).all() for some in (*seen, data.qpos, data.qvel, data.qacc))


def _kind(text: str) -> str:
    """The words of a warning before its first number, which is that of a degree of freedom or of the time."""
    return re.split(r"[-+]?\d", text, maxsplit=1)[0].strip()


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; return the exit code."""
    parser = Parser(prog="python -m benchmarks.speed.tasks", description="Run random episodes of the tasks.")
    parser.add_argument("tasks", nargs="+", choices=dm.ALL, help="which")
    parser.add_argument("--episodes", type=int, default=10, help="how many (default: 10)")
    parser.add_argument("--seed", type=int, default=0, help="of starts and actions (default: 0)")
    parser.add_argument("--steps", type=int, default=None, help="of each episode at most (default: its whole length)")
    arguments = parser.parse_args(argv)
    found = [tried(task, arguments.episodes, arguments.seed, arguments.steps) for task in arguments.tasks]
    show(screen(), table(found), NOTE)
    return 0


if __name__ == "__main__":
    raise SystemExit(exit_code(main))
