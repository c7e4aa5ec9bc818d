"""What may be asked of `collect`: its arguments, each declared once and checked before anything runs."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field

from mjframes.base import texts
from mjframes.base.errors import MjframesError
from mjframes.base.numbers import is_number, is_whole
from mjframes.base.options import option, require_choices

CONTROLS = NONE, RANDOM = "none", "random"

Bounds = tuple[float, float]
Wanted = Mapping[str, Bounds] | Sequence[tuple[str, Bounds]]


@dataclass(frozen=True)
class CollectOptions:
    """The arguments of `collect`; a field is also an option of `mjframes collect`, if a text can say it.

    Raise MjframesError for the first one that is wrong. `vary` and `push` become tuples of names and bounds.
    """

    scene: str | os.PathLike[str] = field(metadata=option("MJCF file"))
    out: str | os.PathLike[str] = field(
        metadata=option("folder that is new, empty, or holds the same collection, which then goes on")
    )
    _: KW_ONLY
    worlds: int = field(metadata=option("number of worlds", reads=texts.count, metavar="N"))
    seconds: float = field(
        default=3.0, metadata=option("how long each world runs [s]", reads=texts.factor, metavar="S")
    )
    vary: Wanted = field(
        default=(),
        metadata=option(
            "bounds of what each world draws: a material, stiffness, alpha or beta [factors], x, y, z [m], roll, "
            'pitch, yaw [degrees] of the start; steak.flesh=0.5:2, in Python {"steak.flesh": (0.5, 2)}',
            reads=texts.bounds,
            metavar="BODY.WHAT=LOW:HIGH",
            repeated=True,
        ),
    )
    push: Wanted = field(
        default=(),
        metadata=option(
            "bounds of a force of 0.1 s on a body [N], its direction, place and time drawn: steak=0:5, in Python "
            '{"steak": (0, 5)}',
            reads=texts.bounds,
            metavar="BODY=LOW:HIGH",
            repeated=True,
        ),
    )
    control: str = field(
        default=NONE,
        metadata=option("random draws each actuator's control anew every 0.1 s from its range", choices=CONTROLS),
    )
    rate: float = field(
        default=30.0, metadata=option("entries per simulated second [Hz]", reads=texts.factor, metavar="HZ")
    )
    seed: int = field(default=0, metadata=option("seed of all draws", reads=texts.seed, metavar="N"))
    shard: int = field(default=128, metadata=option("number of worlds in a file", reads=texts.count, metavar="N"))
    threads: int | None = field(
        default=None,
        metadata=option(
            "number of threads; the default is one per processor, on a cluster one per shard",
            reads=texts.count,
            metavar="N",
        ),
    )
    ray: str | None = field(
        default=None,
        metadata=option(
            "address of a Ray cluster that computes the shards, or local for one on this machine",
            reads=str,
            metavar="ADDRESS",
        ),
    )
    progress: bool = field(default=False, metadata=option("whether to show a progress bar on a terminal"))

    def __post_init__(self) -> None:
        for name, right in (("scene", "the path of an MJCF file (.xml)"), ("out", "the path of a folder")):
            if not isinstance(value := getattr(self, name), (str, os.PathLike)):
                raise MjframesError(f"{name} is a {type(value).__name__}; give {right}.")
        for name, least in (("worlds", 1), ("seed", 0), ("shard", 1), ("threads", 1)):
            value = getattr(self, name)
            if not (is_whole(value) and value >= least) and not (name == "threads" and value is None):
                raise MjframesError(f"{name} is {value!r}; give a whole number from {least} on.")
        for name, unit in (("seconds", "time in seconds"), ("rate", "number of entries a second")):
            if not (is_number(getattr(self, name)) and getattr(self, name) > 0):
                raise MjframesError(f"{name} is {getattr(self, name)!r}; give a positive {unit}.")
        require_choices(self)
        for name in ("vary", "push"):
            object.__setattr__(self, name, _by_name(name, getattr(self, name)))

    def worlds_of(self, shard: int) -> range:
        """Return the worlds in a file."""
        return range(shard * self.shard, min(self.worlds, (shard + 1) * self.shard))


def _by_name(what: str, given: object) -> tuple[tuple[str, Bounds], ...]:
    """Names and bounds.  Raise MjframesError for anything else, and for a name that comes twice."""
    pairs = list(given.items()) if isinstance(given, Mapping) else given
    if not isinstance(pairs, Sequence) or not all(isinstance(pair, Sequence) and len(pair) == 2 for pair in pairs):
        raise MjframesError(f"{what} is {given!r}; give bounds by name, as {{'steak.stiffness': (0.5, 2)}}.")
    found: dict[str, Bounds] = {}
    for name, bounds in ((str(name), bounds) for name, bounds in pairs):
        if name in found:
            raise MjframesError(f"{what} has {name!r} twice; leave one of them out.")
        is_pair = isinstance(bounds, Sequence) and len(bounds) == 2 and all(map(is_number, bounds))
        if not is_pair or bounds[0] > bounds[1]:
            raise MjframesError(f"{what} of {name!r} is {bounds!r}; give two numbers, the lower one first, as 0.5:2.")
        found[name] = float(bounds[0]), float(bounds[1])
    return tuple(found.items())
