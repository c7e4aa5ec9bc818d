"""Files of arrays (.npz) of one kind and version, there whole or not at all, checked when they are read."""

from __future__ import annotations

import os
import zipfile
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mjframes.base.errors import MjframesError
from mjframes.base.files import replacing


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
        with zipfile.ZipFile(path) as archive, archive.open("kind.npy") as file:
            return str(np.lib.format.read_array(file, allow_pickle=False)) == kind
    except (OSError, KeyError, zipfile.BadZipFile, zlib.error, ValueError, EOFError):
        return False


def read_archive(path: str | os.PathLike[str], what: str, kind: str, version: int) -> dict[str, NDArray[Any]]:
    """Return all arrays of a file. Raise MjframesError for one that is missing, damaged, of another kind or version."""
    try:
        with np.load(path, allow_pickle=False) as file:
            # reading all of them checks the archive's checksums
            arrays = {name: file[name] for name in file.files}
    except OSError as error:
        raise MjframesError(f"{path}: {what} cannot be read ({error.strerror or error}).") from error
    except (zipfile.BadZipFile, zlib.error, ValueError, EOFError, AttributeError, TypeError) as error:
        raise MjframesError(
            f"{path}: the file is truncated or damaged or no {what.removeprefix('the ')}; build it again."
        ) from error
    if str(arrays.get("kind", "")) != kind:
        raise MjframesError(
            f"{path}: this .npz holds no {what.removeprefix('the ')}; give one that mjframes build or SoftBody.save "
            "wrote."
        )
    if (found := int(arrays.get("version", 0))) != version:
        raise MjframesError(
            f"{path}: {what} has format version {found}, this mjframes reads {version}; build it again."
        )
    return arrays
