"""Linear isotropic materials: Hooke's law σ = λ tr(ε) I + 2 μ ε (the paper, §2), and the compliance 1/E of §4.1."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from mjframes.base.constants import RIGID_POISSON, RIGID_YOUNG
from mjframes.base.errors import MjframesError
from mjframes.base.numbers import is_number
from mjframes.volume.library import LIBRARY

YOUNG = (1e-3, 1e15)  # [Pa] far beyond foam and diamond; in between no square of a stiffness overflows
DENSITY = (1e-6, 1e9)  # [kg/m³]


@dataclass(frozen=True)
class Material:
    """A linear isotropic material.

    Parameters
    ----------
    young
        Young's modulus [Pa], 1e-3 to 1e15.
    poisson
        Poisson's ratio [-], 0 ≤ ν < 0.5.
    density
        Density [kg/m³], 1e-6 to 1e9.
    name
        Name, for messages, skins and `mjframes.scale`.
    rgba
        Colour that it is drawn in, four numbers from 0 to 1.
    is_rigid
        Whether it does not deform, see `Material.rigid`.
    law_constants
        Constants of a hyperelastic law by name, as `{"c10": 2e3}`. Those that are missing follow from `young` and
        `poisson`.

    Raises
    ------
    MjframesError
        For values outside these ranges.
    """

    young: float
    poisson: float
    density: float
    name: str = ""
    rgba: tuple[float, float, float, float] = (0.8, 0.6, 0.55, 1.0)
    is_rigid: bool = False
    law_constants: Mapping[str, float] = field(default_factory=dict, hash=False)

    def __post_init__(self) -> None:
        of = f" of material {self.name!r}" if self.name else ""
        if not isinstance(self.name, str):
            raise MjframesError(f"name of a material is {self.name!r}; it must be text.")
        if not (is_number(self.young) and YOUNG[0] <= self.young <= YOUNG[1]):
            raise MjframesError(
                f"young{of} is {self.young!r}; it must be a positive Young's modulus in pascals, "
                f"{YOUNG[0]:g} to {YOUNG[1]:g}."
            )
        if not (is_number(self.poisson) and 0 <= self.poisson < 0.5):
            raise MjframesError(f"poisson{of} is {self.poisson!r}; it must lie in [0, 0.5), for flesh take 0.45.")
        if not (is_number(self.density) and DENSITY[0] <= self.density <= DENSITY[1]):
            raise MjframesError(
                f"density{of} is {self.density!r}; it must be a positive density in kg/m³, "
                f"{DENSITY[0]:g} to {DENSITY[1]:g}."
            )
        if np.shape(self.rgba) != (4,) or not all(is_number(c) and 0 <= c <= 1 for c in self.rgba):
            raise MjframesError(f"rgba{of} is {self.rgba!r}; it must be four numbers between 0 and 1.")
        constants = self.law_constants
        if not isinstance(constants, Mapping) or not all(map(is_number, constants.values())):
            raise MjframesError(f'law_constants{of} is {constants!r}; it must map names to numbers, as {{"mu": 2e4}}.')

    @classmethod
    def rigid(
        cls,
        density: float,
        *,
        name: str = "",
        rgba: tuple[float, float, float, float] = (0.93, 0.9, 0.8, 1.0),
    ) -> Material:
        """Return a material that does not deform.

        All its points share one weight vector (the paper, §4.4).

        Parameters
        ----------
        density
            Density [kg/m³].
        name, rgba
            Name and colour, as of `Material`.
        """
        return cls(RIGID_YOUNG, RIGID_POISSON, density, name, rgba, is_rigid=True)

    @classmethod
    def named(cls, name: str) -> Material:
        """Return a material of the library. `mjframes materials` lists it with its sources.

        Parameters
        ----------
        name
            Name in the library, as "silicone-00-30".

        Raises
        ------
        MjframesError
            If the library has no material of that name.
        """
        if name not in LIBRARY:
            raise MjframesError(f"name is {name!r}; the library has {', '.join(LIBRARY)}.")
        known = LIBRARY[name]
        if known.young is None:
            return cls.rigid(known.density, name=name, rgba=known.rgba)
        return cls(known.young, known.poisson, known.density, name, known.rgba)

    @property
    def compliance(self) -> float:
        """Return 1/E [1/Pa] for the compliance distance (5); 0 for a rigid material."""
        return 0.0 if self.is_rigid else 1.0 / self.young

    @property
    def lame(self) -> tuple[float, float]:
        """Return Lamé's (λ, μ) [Pa]."""
        e, nu = self.young, self.poisson
        return e * nu / ((1 + nu) * (1 - 2 * nu)), e / (2 * (1 + nu))
