"""The file of a collection, by which one that was interrupted goes on: all that its data depend on."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import mujoco

from mjframes.app.collect.options import CollectOptions
from mjframes.base.errors import MjframesError
from mjframes.base.files import replacing
from mjframes.scene import plugin

PLAN = "plan.json"
DECIDING = ("worlds", "seconds", "vary", "push", "control", "rate", "seed", "shard")  # options that data depend on


@cache
def engine() -> str:
    """Return what steps here: MuJoCo's version, and a digest of the plugin's library.  Raise MjframesError without."""
    library = hashlib.sha256(plugin.library_path().read_bytes()).hexdigest()
    return f"mujoco {mujoco.mj_versionString()}, plugin {library[:12]}"


def begin(options: CollectOptions, files: Mapping[str, bytes]) -> None:
    """Write the plan into the folder, new or empty, or find the same one there.  files: of the packed scene.

    Raise MjframesError where there is another plan, or something else.
    """
    folder = Path(options.out)
    path = folder / PLAN
    scene = hashlib.sha256(repr(sorted(files.items())).encode()).hexdigest()[:16]
    plan = {"scene": scene, **{name: getattr(options, name) for name in DECIDING}, "engine": engine()}
    text = json.dumps(plan, indent=1) + "\n"
    if not path.exists():
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise MjframesError(f"{folder}: there is something else already; give a new folder, or an empty one.")
        with replacing(path, "the plan") as partial:
            partial.write_text(text, encoding="utf-8")
        return
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        pairs = {name: (found[name], wanted) for name, wanted in json.loads(text).items()}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise MjframesError(f"{path}: it cannot be read as the plan of a collection; give another folder.") from error
    for name, (before, now) in pairs.items():
        if before != now:
            raise MjframesError(
                f"{folder}: it was begun with {name} {_shown(before)} and not {_shown(now)}; give the same to go on, "
                "or another folder."
            )


def _shown(value: Any) -> str:
    if isinstance(value, list):
        return ", ".join(f"{name}={low:g}:{high:g}" for name, (low, high) in value) or "nothing"
    return str(value)
