"""Stages that cost more to compute than to load, kept on disk under a hash of everything they depend on.

    surface = Surface(**cached("surface", (labels, spacing), lambda: vars(extract_surface(...))))

An entry's name is the SHA-256 of the stage's inputs, of the sources that compute it and of the versions of the
libraries that compute: an entry is right for ever, and none is ever updated. The sources are the module that asks, and
what it imports of this package, at the top or anywhere else. So call `cached` in the module that computes, not in one
that puts stages together. Entries live in $XDG_CACHE_HOME (or ~/.cache)
/mjframes/stages; the least recently used go when they exceed LIMIT together. MJFRAMES_CACHE=0 switches the cache off.
It never fails: what cannot be read is computed, what cannot be written is not kept.
"""

from __future__ import annotations

import hashlib
import os
import re
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
PACKAGE = __name__.partition(".")[0]
DOTTED = re.compile(rf"\b{PACKAGE}(?:\.\w+)+")
FROM = re.compile(rf"\bfrom\s+({PACKAGE}(?:\.\w+)*)\s+import\s+(\([^)]*\)|[^\n]*)")
WHOLE = re.compile(rf"^\s*(?:import\s+{PACKAGE}(?!\.)|from\s+\.)", re.MULTILINE)
PARENT = re.compile(r"\.\w+$")


def cached(
    stage: str, inputs: Iterable[object], compute: Callable[[], Mapping[str, np.ndarray]]
) -> dict[str, np.ndarray]:
    """Return the arrays that `compute` returns, loaded where they are known from earlier.

    stage: names the computation.  inputs: all that the result depends on: None, bool, int, float, str, bytes, arrays,
    paths (the contents of the file count, not its name), dataclasses, and tuples, lists and dicts of these.
    compute: a function of these inputs alone, whose module imports all that it calls; its arrays hold numbers, no
    objects, and none is called "file".
    Raise TypeError for inputs of other types, and what `compute` raises.
    """
    if os.environ.get(SWITCH) == "0":
        return dict(compute())
    try:
        path = stage_directory() / f"{stage}-{digest((_program(compute.__module__), *inputs))}{SUFFIX}"
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
def _program(module: str) -> str:
    """Digest of what computes: libraries, and what a module imports of this package: no edit meets older entries."""
    return digest((sources_of(module), {name: _version(name) for name in LIBRARIES}))


def sources_of(module: str) -> dict[str, Path]:
    """Return the sources of this package that a module imports, its own too, by the names of the modules.

    Whatever its text names counts, so that none is missed. All of them where it imports the package as a whole, whose
    names may be anything, or is of another package.
    """
    known = _modules()
    found: dict[str, Path] = {}
    waiting = [module]
    while waiting:
        name = waiting.pop()
        if name not in known or name == PACKAGE:
            return known
        if name not in found:
            found[name] = known[name]
            waiting += _named(known[name].read_text(encoding="utf-8"), known)
            waiting += [PARENT.sub("", name)] if name.count(".") > 1 else []
    return found


def _modules() -> dict[str, Path]:
    """The sources of this package by the names of the modules."""
    root = Path(__file__).parents[1]
    names = {path: ".".join(path.relative_to(root.parent).with_suffix("").parts) for path in root.rglob("*.py")}
    return {name.removesuffix(".__init__"): path for path, name in names.items()}


def _named(text: str, known: Mapping[str, Path]) -> set[str]:
    """The modules that a text names: with dots, or in lists of what is imported from a folder."""
    dotted = set(DOTTED.findall(text))
    for folder, names in FROM.findall(text):
        dotted |= {folder, *(f"{folder}.{name}" for name in re.findall(r"\w+", names))}
    if WHOLE.search(text):
        dotted.add(PACKAGE)
    prefixes = {name.rsplit(".", cut)[0] for name in dotted for cut in range(3)} - {PACKAGE}
    return (prefixes & known.keys()) | (dotted & {PACKAGE})


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
            np.savez(file, **entry)
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
