"""A Jaco arm lifts a T-bone steak: the task `lift_steak_features` of `mjframes.dm`, and a policy written by hand.

The hand drives its fingers over and under the part of the steak that juts out over the block, where that lies, closes
them, goes up and turns its fingers upwards: level, they let a steak slip that they hold by its rim. It needs dm_control
and the extra of films (`pip install "mjframes[dm,video]"`).

    python examples/lift.py --out out
    python examples/lift.py --episodes 20
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
from mjframes.dm.lifting import Layout

Array = NDArray[np.float64]

GOALS = (  # [s], and where the pinch site is to be, from where it grips: across the steak, to it, up [m]
    (0.4, (0.0, 0.15, 0.0)),
    (2.2, (0.0, 0.0, 0.0)),
    (3.8, (0.0, 0.0, 0.0)),
    (6.8, (0.0, 0.0, 0.4)),
)
GRIP = 0.055  # [m] along y from the steak's centre of mass: half of the way to the rim
NEAREST = 0.06  # [m] to the block's middle: fingers stay clear of it
HEIGHT = 0.215  # [m] of the pinch site where it grips
AXES = np.array([[0, -1, 0], [0, 0, -1], [1, 0, 0]])  # of the pinch site: level, a finger above, two below
TILT = (3.0, 4.2), 0.9  # [s] from when to when, [rad] how far the fingers turn upwards
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


def grip(at: Layout, data: mujoco.MjData) -> Array:
    """Return where the pinch site is to be when the fingers close (3,) [m], for a steak that lies on the block."""
    x, y, _ = at.steak.centre_of_mass(data.sensordata)
    return np.array([x, max(y + GRIP, NEAREST), HEIGHT])


def action(model: mujoco.MjModel, data: mujoco.MjData, site: int, target: Array) -> Array:
    """Return the velocities (9,) of the joints that take the pinch site along GOALS to and from `target` [rad/s]."""
    times, places = zip(*GOALS, strict=True)
    goal = target + [np.interp(data.time, times, along) for along in np.transpose(places)]
    angle = np.interp(data.time, TILT[0], (0.0, TILT[1]))
    cosine, sine = np.cos(angle), np.sin(angle)
    axes = np.array([[1, 0, 0], [0, cosine, sine], [0, -sine, cosine]]) @ AXES
    jacobian = np.zeros((6, model.nv))
    mujoco.mj_jacSite(model, data, jacobian[:3], jacobian[3:], site)
    turn = 0.5 * np.cross(data.site_xmat[site].reshape(3, 3), axes, axis=0).sum(axis=1)
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
    target = grip(at, data)
    while not last:
        step = environment.step(action(model, data, at.pinch, target))
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
    parser.add_argument("--episodes", type=int, help="run so many, of seeds from 0 on, without a film")
    arguments = parser.parse_args()
    if arguments.episodes:
        rises: list[float] = []
        for seed in range(arguments.episodes):
            rises.append(lift(started(seed)).rise)
            print(f"seed {seed}: {100 * rises[-1]:.1f} cm up in the last second", flush=True)
        high = sum(rise >= lifting.LIFT for rise in rises)
        print(f"{high} of {len(rises)} steaks are at least {100 * lifting.LIFT:.0f} cm up.")
    else:
        found = run(arguments.out, arguments.seed)
        print(f"reward {found.rewards.sum():.0f} of {len(found.rewards)} steps")
        print(f"In the last second the steak is {100 * found.rise:.1f} cm up, {100 * found.clearance:.1f} cm clear.")
