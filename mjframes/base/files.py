"""Files: output that is there whole or not at all, and where what can be made again is kept."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from mjframes.base.errors import MjframesError


@contextmanager
def replacing(path: str | os.PathLike[str], what: str) -> Iterator[Path]:
    """Yield a temporary path beside `path`, with its ending, that takes its place when the block succeeds, else goes.

    It stays only where the process is killed: what is written bit by bit, as a log, can then be read there.
    Make missing parent directories, which go too when the block fails.  Raise MjframesError, `what` ("the log")
    cannot be written, for what the system refuses, before the block runs where that is known.
    """
    path = Path(path)
    partial = path.with_name(f".{path.stem}.{os.getpid()}.partial{path.suffix}")
    missing = [folder for folder in path.parents if not folder.exists()]  # the innermost first
    written = False
    try:
        if path.is_dir():
            raise IsADirectoryError(None, "it is a directory")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            partial.touch()
            yield partial
            os.replace(partial, path)
            written = True
        finally:
            if not written:
                with suppress(OSError):  # what cannot be removed, or holds what others wrote, stays
                    partial.unlink(missing_ok=True)
                    for folder in missing:
                        folder.rmdir()
    except OSError as error:
        raise MjframesError(f"{path}: {what} cannot be written there ({error.strerror or error}).") from error


def cache_directory() -> Path:
    """Return where compiled libraries are kept: $XDG_CACHE_HOME (or ~/.cache)/mjframes/<processor architecture>."""
    root = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(root) / "mjframes" / platform.machine()
