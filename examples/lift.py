"""A Jaco arm lifts a T-bone steak: the task `lift_steak_features` of `mjframes.dm`, and a policy written by hand.

The hand drives its fingers over and under the part of the steak that juts out over the block, closes them, goes up and
holds it. Run `python examples/lift.py --out out`; it needs dm_control and the extra of films
(`pip install "mjframes[dm,video]"`).
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from dm_control import composer
from numpy.typing import NDArray

import mjframes as mf
from mjframes import dm
from mjframes.dm import lifting

Array = NDArray[np.float64]

GOALS = (  # [s], and where the pinch site is to be: across the steak, to it, up [m]
    (0.4, (0.0, 0.22, 0.215)),
    (2.2, (0.0, 0.07, 0.215)),
    (3.8, (0.0, 0.07, 0.215)),
    (6.3, (0.0, 0.07, 0.515)),
)
AXES = np.array([[0, -1, 0], [0, 0, -1], [1, 0, 0]])  # of the pinch site: level, a finger above, two below
CLOSE = (2.2, 1.0)  # [s] when, [rad/s] how fast the fingers close
GAIN = 4.0  # [1/s] at which errors of the hand's pose decay
HELD = 1.0  # [s] at the end of an episode that is looked at


@dataclass(frozen=True, eq=False)
class Lifted:
    """rewards: (n,) of the control steps.
    rise: of the steak's centre of mass since it lay on the block, the least over the last second [m].
    clearance: of its lowest point above the block, the least over the last second [m].
    """

    rewards: Array
    rise: float
    clearance: float


def action(model: mujoco.MjModel, data: mujoco.MjData, site: int) -> Array:
    """Return the velocities (9,) of the joints that take the pinch site along GOALS [rad/s]."""
    times, places = zip(*GOALS, strict=True)
    goal = [np.interp(data.time, times, along) for along in np.transpose(places)]
    jacobian = np.zeros((6, model.nv))
    mujoco.mj_jacSite(model, data, jacobian[:3], jacobian[3:], site)
    turn = 0.5 * np.cross(data.site_xmat[site].reshape(3, 3), AXES, axis=0).sum(axis=1)
    error = np.concatenate([goal - data.site_xpos[site], turn])
    arm = np.linalg.lstsq(jacobian[:, :6], GAIN * error, rcond=1e-3)[0]
    start, speed = CLOSE
    limit = model.actuator_ctrlrange[:, 1]
    return np.clip(np.concatenate([arm, np.full(3, speed if data.time > start else 0.0)]), -limit, limit)


def started(seed: int) -> composer.Environment:
    """Return the environment at the start of an episode."""
    environment = dm.load("lift_steak_features", seed)
    environment.reset()
    return environment


def lift(environment: composer.Environment, watch: Callable[[mujoco.MjData], None] = lambda data: None) -> Lifted:
    """Run an episode that has started; `watch` is called after every control step."""
    physics, task = environment.physics, environment.task
    model, data = physics.model.ptr, physics.data.ptr
    at, view, skin = task.layout(physics), task.steak.soft(physics), task.steak.body.skin
    rewards, heights, last = [], [], False
    while not last:
        step = environment.step(action(model, data, at.pinch))
        lowest = (skin.weights @ view.control_positions)[:, 2].min()
        rewards.append(step.reward)
        heights.append((at.steak.centre_of_mass(data.sensordata)[2], lowest))
        watch(data)
        last = step.last()
    count = round(HELD / lifting.CONTROL_TIMESTEP)
    centre, lowest = np.min(heights[-count:], axis=0) - 2 * lifting.BLOCK[2]
    return Lifted(np.array(rewards), float(centre - lifting.THICKNESS), float(lowest))


def run(out: Path, seed: int = 0) -> Lifted:
    """Write lift.mp4 to `out`."""
    out.mkdir(parents=True, exist_ok=True)
    environment = started(seed)
    with mf.film(environment.physics.model.ptr, out / "lift.mp4", camera="beside", size=(960, 540), fps=25) as draw:
        return lift(environment, draw)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder of lift.mp4")
    parser.add_argument("--seed", type=int, default=0, help="of what the episode draws (default: 0)")
    arguments = parser.parse_args()
    found = run(arguments.out, arguments.seed)
    print(f"reward {found.rewards.sum():.0f} of {len(found.rewards)} steps")
    print(f"In the last second the steak is {100 * found.rise:.1f} cm up, {100 * found.clearance:.1f} cm clear.")
