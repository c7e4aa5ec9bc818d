"""Stages that cost more to compute than to load, kept on disk under a hash of everything they depend on.

    surface = Surface(**cached("surface", (labels, spacing), lambda: vars(extract_surface(...))))

An entry's name is the SHA-256 of the stage's inputs, of this package's sources and of the versions of the libraries
that compute: an entry is right for ever, and none is ever updated. Entries live in $XDG_CACHE_HOME (or ~/.cache)
/mjframes/stages; the least recently used go when they exceed LIMIT together. MJFRAMES_CACHE=0 switches the cache off.
It never fails: what cannot be read is computed, what cannot be written is not kept.
"""

from __future__ import annotations

import hashlib
import os
import struct
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import fields, is_dataclass
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from mjframes.base.files import cache_directory

SWITCH = "MJFRAMES_CACHE"  # environment variable: 0 switches the cache off
LIMIT = 2**30  # [bytes] of all entries: some hundred volumes of ten million cells
WORTHWHILE = 0.05  # [s] stages that take less are not kept: the file system costs a few milliseconds
ABANDONED = 3600.0  # [s] after which a file that is still being written belongs to a process that has died
LIBRARIES = ("libigl", "numba", "numpy", "scikit-image", "scipy", "trimesh")
SUFFIX, PARTIAL = ".npz", ".partial"


def cached(
    stage: str, inputs: Iterable[object], compute: Callable[[], Mapping[str, np.ndarray]]
) -> dict[str, np.ndarray]:
    """Return the arrays that `compute` returns, loaded where they are known from earlier.

    stage: names the computation.  inputs: all that the result depends on: None, bool, int, float, str, bytes, arrays,
    paths (the contents of the file count, not its name), dataclasses, and tuples, lists and dicts of these.
    compute: a function of these inputs alone; its arrays hold numbers, no objects, and none is called "file".
    Raise TypeError for inputs of other types, and what `compute` raises.
    """
    if os.environ.get(SWITCH) == "0":
        return dict(compute())
    try:
        path = stage_directory() / f"{stage}-{digest((_program(), *inputs))}{SUFFIX}"
    except OSError:  # a file that cannot be read: the stage knows how to say that
        return dict(compute())
    if (known := _read(path)) is not None:
        return known
    start = time.perf_counter()
    arrays = dict(compute())
    if time.perf_counter() - start > WORTHWHILE:
        with suppress(OSError):
            _write(path, arrays)
            _evict(path.parent)
    return arrays


def stage_directory() -> Path:
    """Return the directory of the entries."""
    return cache_directory().parent / "stages"


def digest(value: object) -> str:
    """Return SHA-256 of a value of the types that `cached` takes; another type or shape alone changes it."""
    state = hashlib.sha256()
    _update(state, value)
    return state.hexdigest()


def _update(state: Any, value: object) -> None:
    """Feeds type, length and content to the hash, so that no two values feed it the same bytes."""
    match value:
        case None | bool() | int() | str():
            _feed(state, type(value).__name__, repr(value).encode())
        case float():
            _feed(state, "float", struct.pack("<d", value))
        case bytes():
            _feed(state, "bytes", value)
        case np.ndarray() | np.generic():
            array = np.ascontiguousarray(value)
            if array.dtype.hasobject:
                raise TypeError("an array of objects has no content to hash.")
            _feed(state, f"array{array.dtype.str}{np.shape(value)}", array.reshape(-1).view(np.uint8).data)
        case os.PathLike():
            with open(value, "rb") as file:
                _feed(state, "file", hashlib.file_digest(file, "sha256").digest())
        case tuple() | list():
            _feed(state, "sequence", str(len(value)).encode())
            for item in value:
                _update(state, item)
        case dict():
            _feed(state, "dict", b"")
            _update(state, sorted((digest(key), digest(item)) for key, item in value.items()))
        case _ if is_dataclass(value) and not isinstance(value, type):
            _update(state, (type(value).__name__, *(getattr(value, field.name) for field in fields(value))))
        case _:
            raise TypeError(f"{type(value).__name__} is not a type that can be hashed by content.")


def _feed(state: Any, kind: str, content: bytes | memoryview) -> None:
    state.update(f"{kind}:{len(content)}:".encode())
    state.update(content)


@cache
def _program() -> str:
    """Digest of what computes: libraries, and the sources of this package: no edit of them meets older entries."""
    root = Path(__file__).parents[1]
    sources = {str(path.relative_to(root)): path for path in root.rglob("*.py")}
    return digest((sources, {name: _version(name) for name in LIBRARIES}))


def _version(library: str) -> str | None:
    try:
        return metadata.version(library)
    except metadata.PackageNotFoundError:
        return None


def _read(path: Path) -> dict[str, np.ndarray] | None:
    """The arrays of an entry; None where there is none or where it is damaged (zip files carry checksums)."""
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        os.utime(path)  # used now
    except Exception:  # a damaged file can raise anything, and the stage can always be computed
        return None
    return arrays


def _write(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """The entry, whole or not at all; of processes that write the same one, any may win."""
    entry: dict[str, Any] = dict(arrays)  # Any: an array may have the name of an option
    path.parent.mkdir(parents=True, exist_ok=True)
    descriptor, partial = tempfile.mkstemp(PARTIAL, path.stem, path.parent)
    try:
        with open(descriptor, "wb") as file:
            np.savez_compressed(file, **entry)
        os.replace(partial, path)
    finally:
        Path(partial).unlink(missing_ok=True)


def _evict(directory: Path) -> None:
    """Removes the least recently used entries beyond the limit, and what died while it was written."""
    entries = []
    for path in directory.iterdir():
        with suppress(OSError):  # another process may have removed it
            status = path.stat()
            if path.suffix == SUFFIX:
                entries.append((status.st_mtime, status.st_size, path))
            elif path.suffix == PARTIAL and time.time() - status.st_mtime > ABANDONED:
                path.unlink()
    total = 0
    for _, size, path in sorted(entries, reverse=True):
        total += size
        if total > LIMIT:
            path.unlink(missing_ok=True)
