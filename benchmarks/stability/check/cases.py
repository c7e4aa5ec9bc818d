"""What is tried out: bodies × Young's moduli × time steps × disturbances.

A free bar of 6 × 3 × 3 mm, three frames, 1000 kg/m³ and ν = 0.4; its law, frames and Young's modulus E vary. All are
built by the default method but for one, by the paper's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from mjframes.base.choices import COROTATIONAL, PAPER, WHOLE_BODY
from mjframes.body.build import build
from mjframes.body.soft_body import SoftBody
from mjframes.elasticity.law_table import LAWS
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

SHAPE, SPACING = (12, 6, 6), 5e-4  # voxels, [m]
LENGTH = SHAPE[0] * SPACING  # [m]
DENSITY, POISSON = 1000.0, 0.4  # [kg/m³], [-]
FRAMES = 3
RATIO = 1e9  # [-] of the stiffness of the bar's halves, where they differ
FREE_BEAM = 22.4  # [-] (4.73)², of the lowest vibration of a bar with free ends: ω = 22.4 √(E I / ρ A) / L²

YOUNG = (1e0, 1e3, 1e6, 1e9, 1e12)  # [Pa]
STEPS = (1e-4, 2e-3, 1 / 30)  # [s]
FREE = ("scrambled", "mirrored", "inside out", "stretched 10×", "flattened")
IMPACT, HEAVY, LIGHT = "impact at 10⁴ g", "under 10⁴ × its mass", "under 10⁻⁴ × its mass"
DISTURBANCES = (*FREE, IMPACT, HEAVY, LIGHT)


@dataclass(frozen=True)
class Kind:
    """A body but for its stiffness.

    frames: their types.
    two: materials, half and half.
    integrator: MuJoCo's.
    method: of `build`.
    """

    name: str
    law: str = COROTATIONAL
    frames: str | tuple[str, ...] = "affine"
    two: bool = False
    integrator: str = "Euler"
    method: str = WHOLE_BODY


MIXED = ("rigid", "affine", "quadratic")
KINDS = (
    Kind("corotational"),
    *(Kind(law.replace("_", "-"), law) for law in LAWS),
    Kind("quadratic frames", frames="quadratic"),
    Kind("quadratic frames, neo-hookean", "neo_hookean", "quadratic"),
    Kind("mixed frames", frames=MIXED),
    Kind("mixed frames, neo-hookean", "neo_hookean", MIXED),
    Kind("point frames", frames="point"),
    Kind("stiffness 1 : 10⁹", two=True),
    Kind("stiffness 1 : 10⁹, neo-hookean", "neo_hookean", two=True),
    Kind("rigid frames", frames="rigid"),
    Kind("rigid frames, implicit", frames="rigid", integrator="implicit"),
    Kind("the paper's method", method=PAPER),
    Kind("the paper's method, neo-hookean", "neo_hookean", "quadratic", method=PAPER),
)


@dataclass(frozen=True)
class Case:
    """One run.

    young: Young's modulus, of the softer half where there are two [Pa].
    timestep: [s].
    """

    kind: Kind
    young: float
    timestep: float
    disturbance: str

    @property
    def seed(self) -> list[int]:
        """Return the seed of its random state: one of its own, the same each time."""
        numbers = round(np.log10(self.young)), round(1 / self.timestep)
        return [KINDS.index(self.kind), *numbers, DISTURBANCES.index(self.disturbance)]

    @property
    def frequency(self) -> float:
        """Return ω of the lowest bending vibration, as if all were as soft as the softer half [rad/s]."""
        return FREE_BEAM * SHAPE[1] * SPACING / 12**0.5 / LENGTH**2 * (self.young / DENSITY) ** 0.5

    @property
    def stiffest(self) -> float:
        """Return Young's modulus of the stiffer half [Pa]."""
        return self.young * (RATIO if self.kind.two else 1)


def all_cases() -> list[Case]:
    """Return all cases, about a thousand."""
    return _product(KINDS, YOUNG, STEPS, DISTURBANCES)


def few_cases() -> list[Case]:
    """Return about a hundred of them."""
    kinds = [kind for kind in KINDS if kind.name in ("corotational", "neo-hookean", "mixed frames") or kind.two]
    return _product(kinds, YOUNG[::2], STEPS[1:], ("scrambled", "stretched 10×", IMPACT, HEAVY))


def _product(
    kinds: Sequence[Kind], young: Sequence[float], steps: Sequence[float], disturbances: Sequence[str]
) -> list[Case]:
    """Body by body, so that each is built once. Of two materials the stiffer one has no more than 1e12 Pa."""
    return [
        Case(kind, e, h, disturbance)
        for kind in kinds
        for e in young
        if not kind.two or RATIO * e <= max(YOUNG)
        for h in steps
        for disturbance in disturbances
    ]


@cache
def body(kind: Kind, young: float) -> SoftBody:
    """Return the soft body of a case, without damping."""
    labels = np.ones(SHAPE, int)
    materials = {1: Material(young, POISSON, DENSITY)}
    if kind.two:
        labels[SHAPE[0] // 2 :] = 2
        materials[2] = Material(RATIO * young, POISSON, DENSITY)
    volume = Volume.from_labels(labels, SPACING, materials)
    return build(volume, FRAMES, method=kind.method, frame_type=kind.frames, law=kind.law)
