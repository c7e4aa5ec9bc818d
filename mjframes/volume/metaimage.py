"""MetaImage files, .mha and .mhd: p̄(index) = Offset + Σ_a TransformMatrix[a] ElementSpacing[a] index_a.

Integer indices are voxel centres. A text header of `Key = Value` lines, ended by ElementDataFile, and the voxels
behind it (LOCAL) or in another file. Read here and not by SimpleITK: that takes 260 MB to install and returns a
silently truncated image where the header gives a wrong data size; this reader wants every byte accounted for.
"""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mjframes.base.archive import require_beside, require_possible
from mjframes.base.errors import MjframesError

TYPES = {"CHAR": "i1", "UCHAR": "u1", "SHORT": "i2", "USHORT": "u2", "INT": "i4", "UINT": "u4", "LONG": "i4"}
TYPES |= {"ULONG": "u4", "LONG_LONG": "i8", "ULONG_LONG": "u8", "FLOAT": "f4", "DOUBLE": "f8"}
LONGEST_LINE = 4096  # [bytes] of a header; a longer one is not text


@dataclass(frozen=True, eq=False)
class MetaImage:
    """What a MetaImage file says.

    labels: as stored, first index fastest in the file.
    axes: (3, 3), column a is the direction of index axis a.
    spacing, center: (3,) of a voxel and of the first one's middle, in `unit`, None where the header says nothing.
    is_anatomy: whether it has an anatomical orientation; ITK then writes left, posterior, superior coordinates.
    """

    labels: NDArray[Any]
    axes: NDArray[np.float64]
    spacing: NDArray[np.float64] | None
    center: NDArray[np.float64] | None
    unit: str
    is_anatomy: bool


def read_metaimage(path: Path) -> MetaImage:
    """Return the image in a .mha or .mhd file.  Raise MjframesError if its header and its data do not fit."""
    header, local = _header(path)

    def numbers(*keys: str) -> NDArray[np.float64] | None:
        text = next((header[key] for key in keys if key in header), None)
        return None if text is None else np.array([float(number) for number in text.split()])

    shape = tuple(int(n) for n in header.get("dimsize", "").split())
    kind = header.get("elementtype", "").removeprefix("MET_")
    if not shape or min(shape) < 1 or kind not in TYPES or header.get("elementnumberofchannels", "1") != "1":
        raise MjframesError(
            f"{path}: its header has DimSize = {header.get('dimsize')}, ElementType = {header.get('elementtype')}; "
            "a label image has positive sizes and one integer per voxel."
        )
    is_big = _flag(header, "binarydatabyteordermsb") or _flag(header, "elementbyteordermsb")
    dtype = np.dtype(TYPES[kind]).newbyteorder(">" if is_big else "<")
    require_possible(path, size := math.prod(shape) * dtype.itemsize)
    data = _data(path, header, local, size)
    matrix = numbers("transformmatrix", "rotation", "orientation")
    return MetaImage(
        labels=np.frombuffer(data, dtype).reshape(shape, order="F"),
        axes=np.eye(3) if matrix is None else matrix.reshape(len(shape), -1).T,
        spacing=numbers("elementspacing", "elementsize"),
        center=numbers("offset", "position", "origin"),
        unit=header.get("distanceunits", ""),
        is_anatomy="?" not in header.get("anatomicalorientation", "???"),
    )


def _header(path: Path) -> tuple[dict[str, str], bytes]:
    """Keys in lower case with their values, and the bytes after the header."""
    header: dict[str, str] = {}
    with path.open("rb") as file:
        while "elementdatafile" not in header:
            line = file.readline(LONGEST_LINE)
            key, equals, value = line.decode("latin-1").partition("=")
            if not equals:
                raise MjframesError(f"{path}: this is no MetaImage header; it needs lines 'Key = Value'.")
            header[key.strip().lower()] = value.strip()
        return header, file.read()


def _data(path: Path, header: dict[str, str], local: bytes, size: int) -> bytes:
    """The voxels' bytes, exactly as many as the header says."""
    name = header["elementdatafile"]
    if name == "LIST" or "%" in name or " " in name.strip() or not _flag(header, "binarydata", default=True):
        raise MjframesError(f"{path}: its data are text or several files; save it as one binary .mha.")
    if name.upper() == "LOCAL":
        file, data = path.name, local
    else:
        require_beside(path, name)
        file, source = name, path.parent / name
        if not source.is_file():
            raise MjframesError(f"{path}: there is no file {name} beside it, which its header names as the data.")
        data = source.read_bytes()
    skipped = int(header.get("headersize", "0"))
    if skipped:  # -1: the data end the file
        data = data[skipped:] if skipped > 0 else data[max(0, len(data) - size) :]
    if not _flag(header, "compresseddata"):
        found, expected = len(data), size
    else:
        found, expected = len(data), int(header.get("compresseddatasize", len(data)))
        if found == expected:
            stream = zlib.decompressobj(zlib.MAX_WBITS | 32)  # zlib's or gzip's header
            data = stream.decompress(data, size + 1)
            found, expected = len(data), size
    if found != expected:
        raise MjframesError(
            f"{path}: its header asks for {expected} bytes of data and {file} has {found}; save the image anew."
        )
    return data


def _flag(header: dict[str, str], key: str, default: bool = False) -> bool:
    return header.get(key, str(default)).lower() in ("true", "1")
