"""Files of arrays (.npz) of one kind and version, there whole or not at all, checked when they are read.

A file may come from anyone: it holds numbers and no pickles, and no memory is taken before it is known that its members
are as large as their headers say, and not too large together.
"""

from __future__ import annotations

import math
import os
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from mjframes.base.errors import MjframesError, reason
from mjframes.base.files import replacing
from mjframes.base.memory import available_memory

LARGEST = 2**33  # [bytes] of all arrays of a file: a volume of as many cells as a grid may have, of the widest labels
SUFFIX = ".npy"  # of an archive's members
SHOWN = 20  # letters of a version that no version has
DAMAGED = (  # what damaged files raise, of ZipFile and of NumPy
    zipfile.BadZipFile,
    zlib.error,
    ArithmeticError,
    AttributeError,
    EOFError,
    NotImplementedError,
    RecursionError,
    RuntimeError,
    SyntaxError,
    TypeError,
    ValueError,
)


class Arrays(Mapping[str, NDArray[Any]]):
    """The arrays of an open .npz, each read, with its checksum, when it is asked for.

    Raise ValueError or zipfile.BadZipFile, here or when it is read, for what is damaged, no array, or too large.
    """

    def __init__(self, source: str | os.PathLike[str] | IO[bytes]) -> None:
        self._archive = zipfile.ZipFile(source)
        self._members = {info.filename.removesuffix(SUFFIX): info for info in self._archive.infolist()}
        most = min(LARGEST, available_memory())
        if (size := sum(info.file_size for info in self._archive.infolist())) > most:
            raise ValueError(f"its arrays take {size / 2**30:.3g} GiB, and {most / 2**30:.3g} can be read")

    def __enter__(self) -> Arrays:
        return self

    def __exit__(self, *_: object) -> None:
        self._archive.close()

    def __getitem__(self, name: str) -> NDArray[Any]:
        member = self._members[name]
        if not member.filename.endswith(SUFFIX):
            raise ValueError(f"its member '{name}' is not an array")
        with self._archive.open(member) as file:
            return read_array(file, member.file_size)

    def __iter__(self) -> Iterator[str]:
        return iter(self._members)

    def __len__(self) -> int:
        return len(self._members)


def require_possible(path: str | os.PathLike[str], claimed: int) -> None:
    """Raise MjframesError where a file's header asks for so many bytes of data that no memory is taken for them."""
    if not 0 <= claimed <= LARGEST:
        raise MjframesError(
            f"{path}: its header asks for {claimed:.3g} bytes of data, and {LARGEST:.2g} are the most that is read; "
            "it is damaged, or the image has to be cropped."
        )


def require_beside(path: Path, name: str) -> None:
    """Raise MjframesError where a file names another one that is not in its own folder."""
    if Path(name).name != name:
        raise MjframesError(f"{path}: its header names the data {name!r}; they must be a file in the same folder.")


def read_array(file: IO[bytes], size: int) -> NDArray[Any]:
    """Return the array in a .npy of `size` bytes. Raise ValueError where its header says another size, or objects."""
    version = np.lib.format.read_magic(file)
    if version not in ((1, 0), (2, 0)):
        raise ValueError(f"it is an array of format {version}")
    header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = header(file)
    if dtype.hasobject:
        raise ValueError("it holds Python objects, which are not read")
    if (claimed := math.prod(shape) * dtype.itemsize) != size - file.tell() or min(shape, default=0) < 0:
        raise ValueError(f"its header asks for {claimed} bytes of data and it has {size - file.tell()}")
    file.seek(0)
    return np.lib.format.read_array(file, allow_pickle=False)


def write_archive(
    path: str | os.PathLike[str], what: str, kind: str, version: int, arrays: Mapping[str, NDArray[Any]]
) -> None:
    """Write arrays of a kind.  what: they are, for messages. Raise MjframesError where that cannot be done."""
    with replacing(path, what) as partial, open(partial, "wb") as file:
        found: dict[str, Any] = {"kind": np.array(kind), "version": np.array(version), **arrays}
        np.savez_compressed(file, **found)


def is_archive(path: str | os.PathLike[str], kind: str) -> bool:
    """Return whether a file holds arrays of a kind, of whatever version."""
    try:
        with Arrays(path) as arrays:
            return str(arrays["kind"]) == kind
    except (OSError, KeyError, *DAMAGED):
        return False


def read_archive(path: str | os.PathLike[str], what: str, kind: str, version: int) -> dict[str, NDArray[Any]]:
    """Return all arrays of a file. Raise MjframesError for one that is missing, damaged, of another kind or version."""
    try:
        with Arrays(path) as file:
            arrays = dict(file)  # reading all of them checks the archive's checksums
    except OSError as error:
        raise MjframesError(f"{path}: {what} cannot be read ({error.strerror or error}).") from error
    except DAMAGED as error:
        raise MjframesError(
            f"{path}: the file is truncated or damaged or no {what.removeprefix('the ')} ({reason(error)}); "
            "build it again."
        ) from error
    if str(arrays.get("kind", "")) != kind:
        raise MjframesError(
            f"{path}: this .npz holds no {what.removeprefix('the ')}; give one that mjframes build or SoftBody.save "
            "wrote."
        )
    if str(found := arrays.get("version", 0)) != str(version):
        raise MjframesError(
            f"{path}: {what} has format version {' '.join(str(found).split())[:SHOWN]}, "
            f"this mjframes reads {version}; build it again."
        )
    return arrays
