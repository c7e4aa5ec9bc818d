"""Digests of shards, as `sha256sum` writes and checks them: they tell a finished shard from one that was damaged."""

from __future__ import annotations

import hashlib
import re
import warnings
from collections.abc import Mapping
from pathlib import Path

from mjframes.base.errors import Notice
from mjframes.base.files import replacing

SUMS = "SHA256SUMS"
LINE = re.compile(r"([0-9a-f]{64})  (\S+)")


def read_sums(folder: Path) -> dict[str, str]:
    """Return the digests of the files in a folder, by name, as far as they are known."""
    try:
        lines = (folder / SUMS).read_text(encoding="utf-8").splitlines()
    except (OSError, ValueError):  # none yet, or no text
        return {}
    return {match[2]: match[1] for match in map(LINE.fullmatch, lines) if match}


def write_sums(folder: Path, sums: Mapping[str, str]) -> None:
    """Write digests of files, by name. Raise MjframesError where that cannot be done."""
    with replacing(folder / SUMS, "the digests") as partial:
        lines = [f"{digest}  {name}\n" for name, digest in sorted(sums.items())]
        partial.write_text("".join(lines), encoding="utf-8")


def is_finished(path: Path, sums: Mapping[str, str]) -> bool:
    """Return whether a shard is there, as it was written; warn (Notice) of one that is not as it was."""
    if not path.exists():
        return False
    try:
        with path.open("rb") as stream:
            if hashlib.file_digest(stream, "sha256").hexdigest() == sums.get(path.name):
                return True
    except OSError:  # a disk that is damaged as well
        pass
    warnings.warn(
        f"{path}: it is not as it was written, but damaged or changed; it is computed again.", Notice, stacklevel=2
    )
    return False
