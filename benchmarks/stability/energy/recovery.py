"""Starts that no body should stay in, and whether it comes back: let go damped, without floor and gravity.

Velocities are damped at the rate of the body's lowest vibration, as in `stability/check`. A body is back when its
surface is within 2 % of its size of that at rest, rigidly moved to fit. `rests` drops one and says what still moves
after 5 s.
"""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh
from scipy.spatial.transform import Rotation

from benchmarks.stability.energy.motions import HEIGHTS, above_floor
from benchmarks.stability.energy.world import GRAVITY, World
from benchmarks.stability.states import misfit
from mjframes.scene.inertia import mass_matrix
from mjframes.scene.load import DIVERGED

Array = NDArray[np.float64]

BACK = 0.02  # [-] of the body's size
TIMESTEP = 2e-3  # [s]
PERIODS = 40.0  # of the lowest vibration
STEPS = (500, 15_000)  # at least and at most
LEAST_DECAY = 0.98  # [-] of velocities in a step
LOOK = 50  # [steps] between looks
CALM = 4  # good looks one after another
NOISE = 1e-3  # [-] of the size, so that no state is exactly symmetric
REST_SECONDS, REST_DAMPING = 5.0, 2.0  # [s], [1/s]
STILL = 1e-4  # [-] of the energy of the fall
RIGID = 6  # motions without stiffness


def lowest_rate(world: World) -> float:
    """Return ω of the lowest vibration at rest [1/s], from finite differences of the force."""
    world.reset(TIMESTEP)
    step = 1e-6 * world.size
    stiffness = np.zeros((world.model.nv, world.model.nv))
    for column in range(world.model.nv):
        forces = []
        for side in (step, -step):
            world.data.qpos[:] = 0
            world.data.qpos[column] = side
            mujoco.mj_forward(world.model, world.data)
            forces.append(world.data.qfrc_passive.copy())
        stiffness[column] = (forces[1] - forces[0]) / (2 * step)
    world.reset(TIMESTEP)
    values = eigh((stiffness + stiffness.T) / 2, mass_matrix(world.model, world.data), eigvals_only=True)
    return float(np.sqrt(max(values[RIGID], 1e-12)))


def recovers(world: World, start: str, seed: int, rate: float) -> float:
    """Return the shape's error [-] that is left of one of `STARTS`.  rate: ω of the lowest vibration [1/s]."""
    world.reset(TIMESTEP)
    rng = np.random.default_rng(seed)
    noise = NOISE * world.size * rng.normal(size=world.rest.shape)
    world.move(STARTS[start](world, rng) + noise)
    decay = max(np.exp(-rate * TIMESTEP), LEAST_DECAY)
    steps = int(np.clip(PERIODS * 2 * np.pi / rate / TIMESTEP, *STEPS))
    calm, error = 0, np.inf
    for step in range(steps):
        mujoco.mj_step(world.model, world.data)
        world.data.qvel *= decay
        if step % LOOK == LOOK - 1:
            if world.data.warning.number[DIVERGED].any():
                return np.inf
            mujoco.mj_kinematics(world.model, world.data)
            error = misfit(world.surface @ world.view.control_positions, world.surface @ world.rest) / world.size
            calm = calm + 1 if error < BACK else 0
            if calm == CALM:
                break
    return error


def rests(world: World, seed: int) -> float:
    """Return the kinetic energy of a damped body 5 s after a fall, to that of the fall [-]."""
    world.reset(TIMESTEP, gravity=True, floor=True)
    x = world.rest @ Rotation.random(rng=np.random.default_rng(seed)).as_matrix().T
    world.move(above_floor(world, x, HEIGHTS[0]))
    kinetic = []
    for _ in range(round(REST_SECONDS / TIMESTEP)):
        mujoco.mj_step(world.model, world.data)
        world.data.qvel *= np.exp(-REST_DAMPING * TIMESTEP)
        kinetic.append(float(world.data.sensordata[1]))
    if world.data.warning.number[DIVERGED].any():
        return np.inf
    return max(kinetic[-LOOK:]) / (world.mass * GRAVITY * HEIGHTS[0])


def _flat(kept: int) -> Callable[[World, np.random.Generator], Array]:
    """A start with so many of three random axes kept."""

    def start(world: World, rng: np.random.Generator) -> Array:
        axes = np.linalg.qr(rng.normal(size=(3, 3)))[0][:, :kept]
        return world.rest @ axes @ axes.T

    return start


def _mirrored(world: World, rng: np.random.Generator) -> Array:
    axis = Rotation.random(rng=rng).as_matrix()[0]
    return world.rest @ (np.eye(3) - 2 * np.outer(axis, axis))


def _inside_out(world: World, rng: np.random.Generator) -> Array:
    del rng
    return -world.rest


def _scrambled(world: World, rng: np.random.Generator) -> Array:
    return world.rest + 0.5 * world.size * rng.uniform(-1, 1, world.rest.shape)


STARTS: dict[str, Callable[[World, np.random.Generator], Array]] = {
    "to a plane": _flat(2),
    "to a line": _flat(1),
    "to a point": _flat(0),
    "mirrored": _mirrored,
    "inside out": _inside_out,
    "scrambled": _scrambled,
}
