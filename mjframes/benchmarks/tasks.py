"""Random episodes of the tasks of `mjframes.dm`: whether anything warns or is not finite, and what a step costs.

python -m mjframes.benchmarks.tasks lift_steak_features --episodes 1000
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass

import numpy as np

from mjframes import dm
from mjframes.scene.load import mujoco_warnings

HOLD = 10  # control steps that an action is held: what changes in every step moves next to nothing


@dataclass(frozen=True)
class Tried:
    """warnings: what MuJoCo said.  infinite: steps with an observation or reward that is not finite.
    unfinished: episodes that dm_control ended for the physics.  seconds: of the processor, without drawing lots.
    """

    task: str
    episodes: int
    steps: int
    seconds: float
    warnings: tuple[str, ...]
    infinite: int
    unfinished: int

    def __str__(self) -> str:
        rate = self.steps / self.seconds
        return (
            f"{self.task}: {self.episodes} episodes, {self.steps} steps, {len(self.warnings)} warnings, "
            f"{self.infinite} steps not finite, {self.unfinished} episodes failed, {rate:.0f} steps a second"
        )


def tried(task: str, episodes: int, seed: int = 0, most_steps: int | None = None) -> Tried:
    """Return what came of random episodes, each cut off behind `most_steps`."""
    environment = dm.load(task, seed)
    random = np.random.default_rng(seed)
    steps = infinite = unfinished = 0
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
                step = environment.step(chosen)
                seconds += time.process_time() - start
                count += 1
                finite = np.isfinite(step.reward or 0) and all(np.isfinite(x).all() for x in step.observation.values())
                infinite += not finite
            counters = environment.physics.data.ptr.warning
            unfinished += any(counter.number for counter in counters)
            steps += count
    environment.close()
    return Tried(task, episodes, steps, seconds, tuple(warnings), infinite, unfinished)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("tasks", nargs="+", choices=dm.ALL, help="which")
    parser.add_argument("--episodes", type=int, default=10, help="how many (default: 10)")
    parser.add_argument("--seed", type=int, default=0, help="of starts and actions (default: 0)")
    parser.add_argument("--steps", type=int, default=None, help="of each episode at most")
    arguments = parser.parse_args()
    for task in arguments.tasks:
        print(tried(task, arguments.episodes, arguments.seed, arguments.steps), flush=True)
