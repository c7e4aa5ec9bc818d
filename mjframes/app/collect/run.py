"""Collecting: shard after shard until all are there, then the table. Killed at any time, it goes on where it was."""

from __future__ import annotations

import csv
import hashlib
import math
import re
import sys
import warnings
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.progress import track

from mjframes.app.collect.cluster import on_cluster
from mjframes.app.collect.options import CollectOptions
from mjframes.app.collect.plan import begin, engine
from mjframes.app.collect.shard import shard_bytes, stepping_of
from mjframes.app.log.worlds import WORLD
from mjframes.base.errors import MjframesError, Notice
from mjframes.base.files import replacing
from mjframes.base.options import taking
from mjframes.base.packages import optional
from mjframes.base.threads import processors
from mjframes.scene.load import load_scene
from mjframes.scene.packed import pack

TABLE = "worlds.csv"
SUMS = "SHA256SUMS"  # digests of the shards, as `sha256sum` writes and checks them: they tell of a damaged shard
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


@taking(CollectOptions)
def collect(options: CollectOptions) -> Collection:
    """Step many worlds of a scene and write their states, their sensors and what was drawn for each.

    What is written does not depend on the number of threads, nor on whether the collection was interrupted, to the bit.

    Raises
    ------
    MjframesError
        For arguments out of range, for a folder with another collection, and for files that cannot be written.
    """
    optional("mcap.writer", "a shard", "log")
    _, spec = load_scene(options.scene)
    files = pack(spec)
    stepping_of(options, files)  # what cannot be is told of before there is a folder
    begin(options, files)
    folder = Path(options.out)
    _clear(folder)
    paths = tuple(folder / f"shard-{k:05}.mcap" for k in range(math.ceil(options.worlds / options.shard)))
    sums = _read_sums(folder)
    missing = [number for number, path in enumerate(paths) if not _is_finished(path, sums)]
    hidden = not (options.progress and sys.stderr.isatty())
    console = Console(stderr=True)
    found = _computed(options, files, missing)
    for number, content in track(found, "shards", len(missing), console=console, transient=True, disable=hidden):
        sums[paths[number].name] = hashlib.sha256(content).hexdigest()
        with replacing(folder / SUMS, "the digests") as partial:  # first: a shard that is there has its digest
            partial.write_text("".join(f"{digest}  {name}\n" for name, digest in sorted(sums.items())), "utf-8")
        with replacing(paths[number], "the shard") as partial:
            partial.write_bytes(content)
    rows = [row | {"file": path.name} for path in paths for row in _rows(path)]
    with replacing(folder / TABLE, "the table") as partial, partial.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    return Collection(folder, len(rows), paths, sum(bool(row["ended"]) for row in rows))


def _computed(options: CollectOptions, files: Mapping[str, bytes], missing: list[int]) -> Iterator[tuple[int, bytes]]:
    if options.ray is not None:
        yield from on_cluster(options.ray, options, files, missing, options.threads or 1)
        return
    for number in missing:
        yield number, shard_bytes(options, files, number, options.threads or processors(), engine())


def _clear(folder: Path) -> None:
    """Remove what killed processes left half-written."""
    for path in folder.iterdir():
        if (match := PARTIAL.fullmatch(path.name)) and not Path(f"/proc/{match[1]}").exists():
            with suppress(OSError):
                path.unlink()


def _read_sums(folder: Path) -> dict[str, str]:
    """The digests of the files in a folder, by name, as far as they are known."""
    try:
        text = (folder / SUMS).read_text(encoding="utf-8")
    except (OSError, ValueError):  # none yet, or no text
        return {}
    return {name: digest for digest, name in re.findall(r"^([0-9a-f]{64})  (\S+)$", text, re.MULTILINE)}


def _is_finished(path: Path, sums: Mapping[str, str]) -> bool:
    """Whether a shard is there, as it was written; warn (Notice) of one that is not as it was."""
    if not path.exists():
        return False
    with suppress(OSError), path.open("rb") as stream:  # a disk may be damaged as well
        if hashlib.file_digest(stream, "sha256").hexdigest() == sums.get(path.name):
            return True
    warnings.warn(
        f"{path}: it is not as it was written, but damaged or changed; it is computed again.", Notice, stacklevel=2
    )
    return False


def _rows(path: Path) -> list[dict[str, str]]:
    """The worlds of a shard, as its metadata has them.  Raise MjframesError for a file that is damaged."""
    from mcap.exceptions import McapError
    from mcap.reader import make_reader

    try:
        with path.open("rb") as stream:
            return [record.metadata for record in make_reader(stream).iter_metadata() if record.name == WORLD]
    except (OSError, McapError, ValueError) as error:
        raise MjframesError(f"{path}: the shard cannot be read ({error}); remove it, and collect again.") from error
