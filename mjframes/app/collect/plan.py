"""What is collected: all that the data depends on, and its file, by which an interrupted collection goes on."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from functools import cache
from pathlib import Path

import mujoco

from mjframes.base.errors import MjframesError
from mjframes.base.files import replacing
from mjframes.scene import plugin
from mjframes.volume.material import is_number

PLAN = "plan.json"
CONTROLS = ("none", "random")

Bounds = tuple[float, float]


@dataclass(frozen=True)
class Plan:
    """What is collected. Two equal ones give the same bytes.

    scene: digest of its files.  worlds: how many.  seconds: of each [s].
    vary: what is drawn for each world, and its bounds, see `variation`.  push: bodies, and bounds of forces [N].
    control: one of CONTROLS.  rate: entries a simulated second [Hz].  seed: of all draws.  shard: worlds in a file.
    engine: what steps, of `engine`.
    Raise MjframesError for what cannot be.
    """

    scene: str
    worlds: int
    seconds: float
    vary: tuple[tuple[str, Bounds], ...]
    push: tuple[tuple[str, Bounds], ...]
    control: str
    rate: float
    seed: int
    shard: int
    engine: str

    def __post_init__(self) -> None:
        for name, least in (("worlds", 1), ("seed", 0), ("shard", 1)):
            value = getattr(self, name)
            if not isinstance(value, int) or isinstance(value, bool) or value < least:
                raise MjframesError(f"{name} is {value!r}; give a whole number from {least} on.")
        for name, unit in (("seconds", "time in seconds"), ("rate", "number of entries a second")):
            if not (is_number(getattr(self, name)) and getattr(self, name) > 0):
                raise MjframesError(f"{name} is {getattr(self, name)!r}; give a positive {unit}.")
        if self.control not in CONTROLS:
            raise MjframesError(f"control is {self.control!r}; it is one of {', '.join(CONTROLS)}.")

    @property
    def shards(self) -> int:
        """Return how many files there are."""
        return math.ceil(self.worlds / self.shard)

    def of_shard(self, number: int) -> range:
        """Return the worlds in a file."""
        return range(number * self.shard, min(self.worlds, (number + 1) * self.shard))


@cache
def engine() -> str:
    """Return what steps here: MuJoCo's version, and a digest of the plugin's library.  Raise MjframesError without."""
    library = hashlib.sha256(plugin.library_path().read_bytes()).hexdigest()
    return f"mujoco {mujoco.mj_versionString()}, plugin {library[:12]}"


def digest(files: Mapping[str, bytes]) -> str:
    """Return 16 hexadecimal digits of a packed scene."""
    found = hashlib.sha256()
    for name, content in sorted(files.items()):
        found.update(f"{name}\0{len(content)}\0".encode() + content)
    return found.hexdigest()[:16]


def begin(plan: Plan, folder: Path) -> None:
    """Write the plan into a folder, new or empty, or find the same one there.

    Raise MjframesError where there is another plan, or something else.
    """
    path = folder / PLAN
    if not path.exists():
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise MjframesError(f"{folder}: there is something else already; give a new folder, or an empty one.")
        with replacing(path, "the plan") as partial:
            partial.write_text(json.dumps(asdict(plan), indent=1) + "\n", encoding="utf-8")
        return
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        values = {field.name: found[field.name] for field in fields(Plan)}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise MjframesError(f"{path}: it cannot be read as the plan of a collection; give another folder.") from error
    wanted = json.loads(json.dumps(asdict(plan)))
    for name, value in values.items():
        if value != wanted[name]:
            raise MjframesError(
                f"{folder}: it was begun with {name} {_shown(value)} and not {_shown(wanted[name])}; give the same to "
                "go on, or another folder."
            )


def _shown(value: object) -> str:
    if isinstance(value, list):
        return ", ".join(f"{name}={low:g}:{high:g}" for name, (low, high) in value) or "nothing"
    return str(value)
