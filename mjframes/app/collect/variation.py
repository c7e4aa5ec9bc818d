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
from mujoco.batch import Batch

from mjframes.app.collect.options import Bounds
from mjframes.base.errors import MjframesError
from mjframes.scene.moving import Movable, movable
from mjframes.scene.scaling import materials, scale
from mjframes.scene.view import soft_names

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

    @property
    def is_factor(self) -> bool:
        """Return whether it is of a material, and not of the start."""
        return self.what not in SHIFTS + TURNS

    def draw(self, seed: int, world: int) -> float:
        """Return the value of a world."""
        low, high = self.bounds
        share = stream(seed, world, self.name).random()
        return float(low * (high / low) ** share) if self.is_factor else low + (high - low) * share


def variations(model: mujoco.MjModel, vary: Sequence[tuple[str, Bounds]]) -> tuple[Variation, ...]:
    """Return what is asked for as `steak.stiffness`, with bounds.

    Raise MjframesError for other texts, factors that are not positive, and what the model does not have.
    """
    found = []
    for name, bounds in vary:
        body, dot, what = name.rpartition(".")
        if not (dot and body and what):
            raise MjframesError(f"vary has {name!r}; give BODY and what of it, as steak.stiffness.")
        one = Variation(body, what, bounds)
        if one.is_factor and bounds[0] <= 0:
            raise MjframesError(f"vary of {name!r} goes from {bounds[0]:g}; factors are positive, as 0.5:2.")
        known = materials(model, body)
        if what not in KEYS and mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, body) < 0:
            have = ", ".join(map(repr, soft_names(model))) or "none"
            raise MjframesError(f"vary has {name!r}, but the scene has no body {body!r}; its soft bodies are: {have}.")
        if what not in KEYS and [what in (called, str(label)) for label, called in known.items()].count(True) != 1:
            can = ", ".join([*KEYS, *(called or str(label) for label, called in known.items())])
            raise MjframesError(f"vary has {name!r}, but what of {body!r} can vary is: {can}.")
        if one.is_factor:
            scale(model, body)  # changes nothing, but tells of a body that cannot be scaled
        found.append(one)
    return tuple(found)


def set_materials(batch: Batch, found: Sequence[Variation], drawn: Sequence[Mapping[str, float]]) -> None:
    """Give each world of a batch the materials that are drawn for it; what is not drawn stays as it is."""
    factors: dict[str, dict[str, np.ndarray]] = {}
    for one in found:
        if one.is_factor:
            factors.setdefault(one.body, {})[one.what] = np.array([some[one.name] for some in drawn])
    ones = np.ones(len(drawn))
    for body, of in factors.items():
        common, damping = of.get(STIFFNESS, ones), None
        stiffness: dict[int, np.ndarray] | None = None
        if of.keys() - set(DAMPING):
            known = materials(batch.model, body).items()
            stiffness = {label: common * of.get(called, of.get(str(label), ones)) for label, called in known}
        if of.keys() & set(DAMPING):
            damping = np.stack([of.get(what, ones) for what in DAMPING], axis=1)
        scale(batch, body, materials=stiffness, damping=damping)


def movables(model: mujoco.MjModel, data: mujoco.MjData, found: Sequence[Variation]) -> dict[str, Movable]:
    """Return the bodies whose start varies; data: at the start.  Raise MjframesError for what cannot be moved."""
    return {one.body: movable(model, data, one.body) for one in found if not one.is_factor}


def starts(qpos: np.ndarray, moved: Mapping[str, Movable], drawn: Sequence[Mapping[str, float]]) -> np.ndarray:
    """Return `qpos` (n, nq) at the start of n worlds.  qpos: (nq,) of the scene's start."""
    found, turn = np.tile(qpos, (len(drawn), 1)), np.empty(4)
    for row, values in zip(found, drawn, strict=True):
        for body, some in moved.items():
            shift, angles = ([values.get(f"{body}.{what}", 0.0) for what in keys] for keys in (SHIFTS, TURNS))
            mujoco.mju_euler2Quat(turn, np.radians(angles), "XYZ")  # capitals: about axes that do not turn
            some.move(row, np.array(shift), turn)
    return found


def stream(seed: int, world: int, name: str) -> np.random.Generator:
    """Return the random numbers of one name in one world."""
    key = int.from_bytes(hashlib.blake2b(name.encode(), digest_size=8).digest(), "little")
    return np.random.Generator(np.random.Philox(np.random.SeedSequence(seed, spawn_key=(world, key))))
