"""Collecting: shard after shard until all are there, then the table. Killed at any time, it goes on where it was."""

from __future__ import annotations

import csv
import hashlib
import os
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from rich.console import Console
from rich.progress import track

from mjframes.app.collect.cluster import on_cluster
from mjframes.app.collect.plan import Bounds, Plan, begin, digest, engine
from mjframes.app.collect.shard import shard_bytes, shard_path, stepping_of
from mjframes.app.collect.sums import is_finished, read_sums, write_sums
from mjframes.app.collect.variation import checked
from mjframes.app.log.worlds import WORLD
from mjframes.base.errors import MjframesError
from mjframes.base.files import replacing
from mjframes.base.packages import optional
from mjframes.base.threads import processors
from mjframes.scene.load import load_scene
from mjframes.scene.packed import pack

TABLE = "worlds.csv"
PARTIAL = re.compile(r"\.[\w-]+\.(\d+)\.partial\.\w+")  # see `base.files.replacing`


@dataclass(frozen=True)
class Collection:
    """What `collect` has written.

    Parameters
    ----------
    folder
        Folder of the shards and of the table.
    worlds
        Number of worlds.
    shards
        Files of the shards.
    ended
        Number of worlds that ended early because MuJoCo warned of them.
    """

    folder: Path
    worlds: int
    shards: tuple[Path, ...]
    ended: int


def collect(
    scene: str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    worlds: int,
    seconds: float,
    vary: Mapping[str, Bounds] | Sequence[tuple[str, Bounds]] = (),
    push: Mapping[str, Bounds] | Sequence[tuple[str, Bounds]] = (),
    control: str = "none",
    rate: float = 30.0,
    seed: int = 0,
    shard: int = 128,
    threads: int | None = None,
    ray: str | None = None,
    progress: bool = False,
) -> Collection:
    """Step many worlds of a scene and write their states, their sensors and what was drawn for each.

    What is written does not depend on the number of threads, nor on whether the collection was interrupted, to the bit.

    Parameters
    ----------
    scene
        MJCF file.
    out
        Folder that is new, empty, or holds the same collection, which then goes on.
    worlds
        Number of worlds.
    seconds
        How long each world runs [s].
    vary
        Bounds of what is drawn for each world, as `{"steak.stiffness": (0.5, 2)}`. The page on many worlds lists what
        can vary.
    push
        Bounds of a force on a body [N], as `{"steak": (0, 5)}`.
    control
        `"random"` draws each actuator's control anew every 0.1 s from its range. `"none"` leaves the controls alone.
    rate
        Entries per simulated second [Hz].
    seed
        Seed of all draws.
    shard
        Number of worlds in a file.
    threads
        Number of threads. The default is one per processor; on a cluster, one per shard.
    ray
        Address of a Ray cluster that computes the shards, or `"local"` for one on this machine.
    progress
        Whether to show a progress bar on a terminal.

    Returns
    -------
    Collection
        The folder and its files.

    Raises
    ------
    MjframesError
        For arguments out of range, for a folder with another collection, and for files that cannot be written.
    """
    if threads is not None and (not isinstance(threads, int) or threads < 1):
        raise MjframesError(f"threads is {threads!r}; give a whole number from 1 on.")
    optional("mcap.writer", "a shard", "log")
    _, spec = load_scene(scene)
    files = pack(spec)
    bounds = _bounds_by_name(vary, "vary"), _bounds_by_name(push, "push")
    plan = Plan(digest(files), worlds, seconds, *bounds, control, rate, seed, shard, engine())
    stepping_of(plan, files)  # what cannot be is told of before there is a folder
    folder = Path(out)
    begin(plan, folder)
    _clear(folder)
    paths = tuple(shard_path(folder, number) for number in range(plan.shards))
    sums = read_sums(folder)
    missing = [number for number, path in enumerate(paths) if not is_finished(path, sums)]
    if ray is None:
        work = partial(shard_bytes, plan, files, threads=threads or processors())
        found: Iterator[tuple[int, bytes]] = ((number, work(number)) for number in missing)
    else:
        found = on_cluster(ray, plan, files, missing, threads or 1)
    hidden = not (progress and sys.stderr.isatty())
    console = Console(stderr=True)
    for number, content in track(found, "shards", len(missing), console=console, transient=True, disable=hidden):
        sums[paths[number].name] = hashlib.sha256(content).hexdigest()
        write_sums(folder, sums)  # first: a shard that is there has its digest
        with replacing(paths[number], "the shard") as partial_path:
            partial_path.write_bytes(content)
    rows = [row | {"file": path.name} for path in paths for row in _rows(path)]
    _write_table(folder / TABLE, rows)
    return Collection(folder, len(rows), paths, sum(bool(row["ended"]) for row in rows))


def _bounds_by_name(given: object, what: str) -> tuple[tuple[str, Bounds], ...]:
    pairs = list(given.items()) if isinstance(given, Mapping) else given
    if not isinstance(pairs, Sequence) or not all(isinstance(pair, Sequence) and len(pair) == 2 for pair in pairs):
        raise MjframesError(f"{what} is {given!r}; give bounds by name, as {{'steak.stiffness': (0.5, 2)}}.")
    return tuple((str(name), checked(bounds, f"{what} of {str(name)!r}")) for name, bounds in pairs)


def _clear(folder: Path) -> None:
    """Remove what killed processes left half-written."""
    for path in folder.iterdir():
        if (match := PARTIAL.fullmatch(path.name)) and not Path(f"/proc/{match[1]}").exists():
            with suppress(OSError):
                path.unlink()


def _rows(path: Path) -> list[dict[str, str]]:
    """The worlds of a shard, as its metadata has them.  Raise MjframesError for a file that is damaged."""
    from mcap.exceptions import McapError
    from mcap.reader import make_reader

    try:
        with path.open("rb") as stream:
            return [record.metadata for record in make_reader(stream).iter_metadata() if record.name == WORLD]
    except (OSError, McapError, ValueError) as error:
        raise MjframesError(f"{path}: the shard cannot be read ({error}); remove it, and collect again.") from error


def _write_table(path: Path, rows: Sequence[Mapping[str, str]]) -> None:
    with replacing(path, "the table") as partial_path, partial_path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
