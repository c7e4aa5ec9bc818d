"""What differs from world to world, and how it is drawn: `steak.stiffness=0.5:2`, a body, what of it, two bounds.

    flesh              factor of the moduli of that material, by its name or label; see `scene.scaling.scale`
    stiffness          factor of all moduli, times those of materials; alpha, beta: of Rayleigh's damping
    x, y, z            [m] by which the body starts elsewhere, along the world's axes
    roll, pitch, yaw   [degrees] by which it starts turned, about the world's x, then y, then z, through its centre

Factors are drawn evenly in their logarithm, the others evenly. Each draw depends on the seed, the world and its own
name alone: neither more worlds nor more variations change the others.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from mjframes.app.collect.plan import Bounds
from mjframes.base.errors import MjframesError
from mjframes.scene.moving import Movable, movable
from mjframes.scene.scaling import materials, scale
from mjframes.volume.material import is_number

STIFFNESS, DAMPING = "stiffness", ("alpha", "beta")
SHIFTS, TURNS = ("x", "y", "z"), ("roll", "pitch", "yaw")
KEYS = (STIFFNESS, *DAMPING, *SHIFTS, *TURNS)


@dataclass(frozen=True)
class Variation:
    """One thing that differs.

    body: its name.  what: one of KEYS, or a material.  bounds: of what is drawn, lower and upper.
    """

    body: str
    what: str
    bounds: Bounds

    @property
    def name(self) -> str:
        return f"{self.body}.{self.what}"

    def draw(self, seed: int, world: int) -> float:
        """Return the value of a world."""
        low, high = self.bounds
        share = stream(seed, world, self.name).random()
        if self.what in SHIFTS + TURNS:
            return low + (high - low) * share
        return float(low * (high / low) ** share)


def variations(vary: Sequence[tuple[str, Bounds]]) -> tuple[Variation, ...]:
    """Return what is asked for as `steak.stiffness`, with bounds.

    Raise MjframesError for other texts, factors that are not positive, and what is asked for twice.
    """
    found: dict[str, Variation] = {}
    for name, bounds in vary:
        body, dot, what = name.rpartition(".")
        if not (dot and body and what):
            raise MjframesError(f"vary has {name!r}; give BODY and what of it, as steak.stiffness.")
        low, _ = bounds
        if what not in SHIFTS + TURNS and low <= 0:
            raise MjframesError(f"vary of {name!r} goes from {low:g}; factors are positive, as 0.5:2.")
        if name in found:
            raise MjframesError(f"vary has {name!r} twice; leave one of them out.")
        found[name] = Variation(body, what, bounds)
    return tuple(found.values())


def checked(bounds: object, what: str) -> Bounds:
    """Return two bounds.  Raise MjframesError, `what` is …, where they are none."""
    if isinstance(bounds, Sequence) and len(bounds) == 2 and all(map(is_number, bounds)) and bounds[0] <= bounds[1]:
        return float(bounds[0]), float(bounds[1])
    raise MjframesError(f"{what} is {bounds!r}; give two numbers, the lower one first, as 0.5:2.")


def stream(seed: int, world: int, name: str) -> np.random.Generator:
    """Return the random numbers of one name in one world."""
    key = int.from_bytes(hashlib.blake2b(name.encode(), digest_size=8).digest(), "little")
    return np.random.Generator(np.random.Philox(np.random.SeedSequence(seed, spawn_key=(world, key))))


class Varied:
    """A model's materials and start as the variations make them.

    model: whose `numeric_data` is written to in between.  data: at the start, after `mj_forward`.
    Raise MjframesError for bodies that the model does not have, or whose material or start cannot be changed.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, found: Sequence[Variation]) -> None:
        self._model, self._built, self._start = model, model.numeric_data.copy(), data.qpos.copy()
        self._factors: dict[str, list[str]] = {}
        self._movable: dict[str, Movable] = {}
        for one in found:
            if one.what not in SHIFTS + TURNS:
                self._factors.setdefault(one.body, []).append(one.what)
            elif one.body not in self._movable:
                self._movable[one.body] = movable(model, data, one.body)
            if one.what not in KEYS and len(_labels(model, one)) != 1:
                own = [called or str(label) for label, called in materials(model, one.body).items()]
                known = ", ".join([*KEYS, *own])
                raise MjframesError(f"vary has {one.name!r}, but what of {one.body!r} can vary is: {known}.")
        self.numerics({})  # what cannot be scaled is told of now

    def numerics(self, values: Mapping[str, float]) -> np.ndarray:
        """Return `numeric_data` for drawn values; what is not drawn stays as it is."""
        try:
            for body, factors in self._factors.items():
                of = {what: values.get(f"{body}.{what}", 1.0) for what in factors}
                damping = [of.get(what, 1.0) for what in DAMPING] if of.keys() & set(DAMPING) else None
                scale(self._model, body, self._stiffness(body, of), damping=damping)
            return self._model.numeric_data.copy()
        finally:
            self._model.numeric_data[:] = self._built

    def _stiffness(self, body: str, of: Mapping[str, float]) -> float | dict[int | str, float] | None:
        """Factors of moduli as `scale` takes them, from those that are drawn for a body."""
        common = of.get(STIFFNESS)
        if not of.keys() - set(KEYS):
            return common
        known = materials(self._model, body).items()
        return {label: (common or 1.0) * of.get(called, of.get(str(label), 1.0)) for label, called in known}

    def qpos(self, values: Mapping[str, float]) -> np.ndarray:
        """Return `qpos` at the start for drawn values."""
        found = self._start.copy()
        for body, some in self._movable.items():
            shift = np.array([values.get(f"{body}.{what}", 0.0) for what in SHIFTS])
            angles = np.radians([values.get(f"{body}.{what}", 0.0) for what in TURNS])
            turn = np.empty(4)
            mujoco.mju_euler2Quat(turn, angles, "XYZ")  # capitals: about axes that do not turn
            some.move(found, shift, turn)
        return found


def _labels(model: mujoco.MjModel, one: Variation) -> list[int]:
    """The materials that a variation's `what` may mean."""
    return [label for label, called in materials(model, one.body).items() if one.what in (called, str(label))]
