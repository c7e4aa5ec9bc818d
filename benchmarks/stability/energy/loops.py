"""Closed loops in configuration space: a force that is the gradient of an energy does no work round one.

Random states are joined by straight lines, ∮ f · dq = Σ ∫ f(q_a + s Δq) · Δq ds, by adaptive Gauss–Kronrod
quadrature, relative to the mean elastic energy of the states. f is the plugin's, `qfrc_passive` at rest: of bodies on
slides alone the lines are straight for the control points, too. The second number is the most by which the work along a
line differs from what the energy says, relative to the same.

Where a region's rotation jumps f jumps with it, and each jump needs a nest of intervals: lines between folded states
leave the quadrature in doubt.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.integrate import quad_vec

from benchmarks.stability.energy.motions import bent
from benchmarks.stability.energy.world import World
from benchmarks.stability.states import move_points

Array = NDArray[np.float64]

STATES = 3  # of a loop
LIMIT = 1e-6  # [-]
PRECISION = 2e-7  # [-] of the mean energy, asked of the quadrature of a line
MOST = 60  # intervals of a line
THIN = 1e-2  # [-] what is left of a collapsed body's thickness


@dataclass(frozen=True)
class Loop:
    """What a loop gave, relative to the mean elastic energy of its states [-].

    work: round it.  mismatch: of work and energy along the worst of its lines.  doubt: error of the quadrature.
    """

    work: float
    mismatch: float
    doubt: float


def round_loop(force: Callable[[Array], Array], energy: Callable[[Array], float], states: Array) -> Loop:
    """Go round a loop.

    force: (nv,) at q (nv,).  energy: there [J].  states: (s, nv) of its corners.
    """
    energies = np.array([energy(q) for q in states])
    mean = max(float(energies.mean()), np.finfo(float).tiny)
    works, doubt = [], 0.0
    for a, b in zip(states, np.roll(states, -1, axis=0), strict=True):
        done, error = quad_vec(
            lambda s, a=a, b=b: float(force(a + s * (b - a)) @ (b - a)), 0, 1, epsabs=PRECISION * mean, limit=MOST
        )[:2]
        works.append(float(done))
        doubt += float(error)
    mismatch = np.abs(np.array(works) + np.roll(energies, -1) - energies).max()
    return Loop(abs(sum(works)) / mean, float(mismatch) / mean, doubt / mean)


def loop_of(world: World, kind: str, seed: int) -> Loop:
    """Go round a loop of random states of one of `KINDS`. Control points have to be on slides."""
    world.reset(world.model.opt.timestep)
    rng = np.random.default_rng(seed)
    states = []
    for number in range(STATES):
        move_points(world.view, KINDS[kind](world, rng, number))
        states.append(world.data.qpos.copy())
    world.data.qvel[:] = 0

    def force(q: Array) -> Array:
        world.data.qpos[:] = q
        mujoco.mj_fwdPosition(world.model, world.data)
        mujoco.mj_fwdVelocity(world.model, world.data)
        return world.data.qfrc_passive.copy()

    def energy(q: Array) -> float:
        world.data.qpos[:] = q
        mujoco.mj_forward(world.model, world.data)
        return world.elastic

    return round_loop(force, energy, np.array(states))


def _bent(world: World, rng: np.random.Generator, number: int) -> Array:
    del number
    return bent(world, rng)


def _folded(world: World, rng: np.random.Generator, number: int) -> Array:
    del number
    return bent(world, rng, angle=np.pi)


def _inverted(world: World, rng: np.random.Generator, number: int) -> Array:
    """Every other state, so that lines pass through what is flat."""
    return bent(world, rng, mirrored=number % 2 == 1)


def _collapsed(world: World, rng: np.random.Generator, number: int) -> Array:
    """To a plane, a line, a point."""
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    thin = np.where(np.arange(3) <= number, THIN, 1.0)
    noise = THIN * world.size * rng.normal(size=world.rest.shape)
    return world.rest @ (axes * thin) @ axes.T + noise


KINDS: dict[str, Callable[[World, np.random.Generator, int], Array]] = {
    "bent": _bent,
    "folded": _folded,
    "inverted": _inverted,
    "collapsed": _collapsed,
}
