"""How a soft body touches: the contact parameters of its patch geoms, in MuJoCo's words."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import mujoco
import numpy as np

from mjframes.base.errors import MjframesError
from mjframes.base.numbers import is_number, is_whole

LENGTHS = {"friction": 3, "solref": 2, "solimp": 5}
CONDIMS = (1, 3, 4, 6)
IMPEDANCE = (  # of solimp: what each number is, and its range
    ("first impedance", 0.0, 1.0),
    ("second impedance", 0.0, 1.0),
    ("width", 0.0, math.inf),
    ("midpoint", 0.0, 1.0),
    ("power", 1.0, math.inf),
)


@dataclass(frozen=True)
class Contact:
    """How a soft body collides, as a geom's attributes in MJCF.

    The default of `solref` has half of MuJoCo's time constant: soft bodies that fall on each other penetrate a third to
    a half as deep, and half as deep at rest. With a rigid geom at MuJoCo's default of 0.02 s it is mixed to 0.015 s.

    Objects that cross the thickness of a body in a few milliseconds still pass through it, such as a ball at 10 m/s
    through a slab of 5 cm. `solref=(0.005, 1)` with `priority=1` stops that ball.

    Parameters
    ----------
    friction
        Sliding [-], torsional [m] and rolling [m] friction. The default is MuJoCo's.
    margin, gap
        Lengths [m] as in MJCF. The default is MuJoCo's.
    solref, solimp
        Parameters of the constraint, as in MJCF.
    condim
        Dimension of the contact: 1, 3, 4 or 6. The default is MuJoCo's.
    contype, conaffinity
        Bits. Two geoms collide if the contype of one has a bit of the other's conaffinity. By default a soft body meets
        rigid geoms and other soft bodies. It never meets itself.
    priority
        The parameters of the geom with the higher priority count. Those of equal ones are mixed.
    dents
        Whether the flesh below a contact gives way beyond what the frames show, as finite elements say.

    Raises
    ------
    MjframesError
        For values that MuJoCo would refuse.
    """

    friction: tuple[float, ...] | None = None
    margin: float | None = None
    gap: float | None = None
    solref: tuple[float, ...] | None = (0.01, 1.0)
    solimp: tuple[float, ...] | None = None
    condim: int | None = None
    contype: int = 1
    conaffinity: int = 1
    priority: int | None = None
    dents: bool = True

    def __post_init__(self) -> None:
        for name, length in LENGTHS.items():
            values = getattr(self, name)
            if values is None:
                continue
            shortest = length if name == "solref" else 1
            if np.ndim(values) != 1 or not (shortest <= np.size(values) <= length and all(map(is_number, values))):
                counts = f"{shortest} to {length}" if shortest < length else f"{length}"
                raise MjframesError(f"{name} is {values!r}; give a sequence of {counts} finite numbers.")
        if self.friction is not None and np.min(self.friction) < 0:
            raise MjframesError(f"friction is {self.friction!r}; its coefficients must be ≥ 0.")
        if self.solref is not None and (self.solref[0] > 0) != (self.solref[1] > 0):
            raise MjframesError(
                f"solref is {self.solref!r}; give a time constant and a damping ratio, both positive, as (0.02, 1), or "
                "a stiffness and a damping, both negative."
            )
        for i, value in enumerate(self.solimp or ()):
            name, low, high = IMPEDANCE[i]
            if not low <= value <= high:
                raise MjframesError(
                    f"solimp is {self.solimp!r}, but its {name} must be between {low:g} and {high:g}, as in MuJoCo's "
                    "(0.9, 0.95, 0.001, 0.5, 2)."
                )
        for name in ("margin", "gap"):
            value = getattr(self, name)
            if value is not None and not (is_number(value) and value >= 0):
                raise MjframesError(f"{name} is {value!r}; it must be a length ≥ 0 in metres.")
        if self.condim is not None and (self.condim not in CONDIMS or isinstance(self.condim, bool)):
            raise MjframesError(f"condim is {self.condim!r}; it must be 1, 3, 4 or 6.")
        for name in ("contype", "conaffinity"):
            value = getattr(self, name)
            if not (is_whole(value) and 0 <= value < 2**31):
                raise MjframesError(f"{name} is {value!r}; it must be a bit mask of 31 bits.")
        if not isinstance(self.dents, bool):
            raise MjframesError(f"dents is {self.dents!r}; it must be True or False.")
        if self.priority is not None and not (is_whole(self.priority) and abs(self.priority) < 2**31):
            raise MjframesError(f"priority is {self.priority!r}; it must be a whole number.")

    def write(self, geom: mujoco.MjsGeom) -> None:
        """Put the parameters into a geom of a spec."""
        for field in fields(self):
            value = getattr(self, field.name)
            if value is None or field.name == "dents":  # that is the plugin's
                continue
            if field.name in LENGTHS:
                getattr(geom, field.name)[: np.size(value)] = value
            else:
                setattr(geom, field.name, value)
