"""The motions, and how much energy each makes out of nothing.

dropped: on a plane, turned at random, its lowest point 10 to 15 cm above.  thrown: it flies and spins, without gravity.
squeezed: standing along an axis of its volume between two plates, to three fifths, then they are gone.  disturbed: let
go from a state in which frames are turned and moved, without gravity. Nothing is damped.

Gains are relative to what moves: the energy of falling to the plane, of the throw, the largest work that the plates
have done, the elastic energy of the disturbed state. `gain` is the most by which the total energy exceeds that of the
start, without the work of the plates; `settled` leaves out what a step's turn stretches (world.py); `motion` leaves out
all of the elastic energy. What makes energy shows in the last two.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from benchmarks.stability.energy.world import GRAVITY, Course, Plates, World, run

Array = NDArray[np.float64]

SECONDS = 2.0  # [s] of a run
STEPS = (5e-4, 2e-3, 5e-3)  # [s]
LIMIT = 1e-3  # [-] of what moves: a larger gain is one
HEIGHTS = (0.10, 0.15)  # [m]
SPEED, SPINS = 1.0, (5.0, 25.0)  # [m/s], [rad/s]
BENT, SHIFT, STRAIN = 0.6, 0.1, 0.15  # [rad] and, of the size, [-] of a disturbed frame; [-] of its gradient
CLOSING, CLOSED = 0.4, 0.5  # [s] until plates are at their nearest, until they go
CLEARANCE = 0.05  # [-] of the height, before
SQUEEZE = 0.4  # [-] of the height
TURNING = 2.0  # [-] of one step's stretch: where it was measured, 0.9 to 1.4 of it were there


@dataclass(frozen=True)
class Gain:
    """What a run gained [-], not finite where MuJoCo reset the state; see above.

    moved: what it is relative to [J].  turned: what a step's turn may have stretched, at most [-].
    """

    gain: float
    settled: float
    motion: float
    moved: float
    turned: float

    @property
    def worst(self) -> float:
        """Return what has to stay below LIMIT."""
        return max(self.settled, self.motion)


def gain_of(course: Course, moved: float, turning: float) -> Gain:
    """Return what a run gained.  moved: [J].  turning: A of the body [J/rad⁴]."""
    if not course.finite:
        return Gain(np.inf, np.inf, np.inf, moved, 0.0)
    total, start = course.total, course.total[0]
    turned = TURNING * turning * course.turn**4
    motion = course.motion - course.work
    found = [float((some - start).max()) / moved for some in (total, total - turned, motion)]
    return Gain(found[0], found[1], found[2], moved, float(turned.max()) / moved)


def dropped(world: World, timestep: float, seed: int) -> Gain:
    """Drop the body on the floor."""
    world.reset(timestep, gravity=True, floor=True)
    rng = np.random.default_rng(seed)
    x = world.rest @ Rotation.random(rng=rng).as_matrix().T
    height = rng.uniform(*HEIGHTS)
    world.move(above_floor(world, x, height))
    return gain_of(run(world, SECONDS), world.mass * GRAVITY * height, world.turning)


def thrown(world: World, timestep: float, seed: int) -> Gain:
    """Let the body fly and spin."""
    world.reset(timestep)
    throw(world, seed)
    return _flown(world, float(world.data.sensordata[1]))


def disturbed(world: World, timestep: float, seed: int) -> Gain:
    """Let the body go from a state in which frames are turned and moved."""
    world.reset(timestep)
    world.move(bent(world, np.random.default_rng(seed)))
    return _flown(world, world.elastic)


def squeezed(world: World, timestep: float, seed: int) -> Gain:
    """Squeeze the body between two plates, and let it go."""
    world.reset(timestep, plates=True)
    x = np.roll(world.rest, seed, axis=1)
    low, high = _extent(world, x)
    clear = CLEARANCE * (high - low)
    plates = _closing(low - clear, high + clear, SQUEEZE * (high - low))
    world.move(x)
    course = run(world, SECONDS, plates)
    return gain_of(course, max(float(course.work.max()), np.finfo(float).tiny), world.turning)


def above_floor(world: World, x: Array, height: float) -> Array:
    """Return control points (k, 3) [m] moved so that the lowest point of the surface is at a height [m]."""
    return x + np.array([0, 0, height - (world.surface @ x)[:, 2].min()])


def throw(world: World, seed: int) -> None:
    """Set a velocity and a spin."""
    rng = np.random.default_rng(seed)
    spin = Rotation.random(rng=rng).apply([0, 0, rng.uniform(*SPINS)])
    world.move(world.rest, np.cross(spin, world.rest) + SPEED * Rotation.random(rng=rng).as_matrix()[0])


def bent(world: World, rng: np.random.Generator, angle: float = BENT, mirrored: bool = False) -> Array:
    """Return control points (k, 3) with each frame turned by up to `angle` [rad], moved and stretched at random."""
    x = world.rest.copy()
    for frame in np.unique(world.frame):
        own = world.frame == frame
        centre = world.rest[own].mean(axis=0)
        turn = Rotation.from_rotvec(rng.uniform(0, angle) * Rotation.random(rng=rng).as_matrix()[0]).as_matrix()
        stretch = np.diag([-1.0 if mirrored else 1.0, 1, 1]) + STRAIN * rng.uniform(-1, 1, (3, 3))
        x[own] = centre + (world.rest[own] - centre) @ (turn @ stretch).T + SHIFT * world.size * rng.uniform(-1, 1, 3)
    return x


MOTIONS: dict[str, Callable[[World, float, int], Gain]] = {
    "dropped": dropped,
    "thrown": thrown,
    "squeezed": squeezed,
    "disturbed": disturbed,
}


def _flown(world: World, moved: float) -> Gain:
    return gain_of(run(world, SECONDS), moved, world.turning)


def _extent(world: World, x: Array) -> tuple[float, float]:
    height = (world.surface @ x)[:, 2]
    return float(height.min()), float(height.max())


def _closing(low: float, high: float, by: float) -> Plates:
    """The faces of plates that come nearer by `by` [m] together, smoothly, wait and are gone."""

    def faces(time: float) -> tuple[float, float] | None:
        if time > CLOSED:
            return None
        moved = by / 2 * np.sin(np.pi / 2 * min(1.0, time / CLOSING)) ** 2
        return low + moved, high - moved

    return faces
