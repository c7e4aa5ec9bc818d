"""MetaImage files: axes, byte order, compression, and data whose size the header gets wrong."""

from __future__ import annotations

import gzip
import zlib
from pathlib import Path

import numpy as np
import pytest

from mjframes.base.errors import MjframesError
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

FLESH = Material(2e4, 0.45, 1050)
LABELS = np.arange(24).reshape(2, 3, 4) % 3
HEADER = {
    "ObjectType": "Image",
    "NDims": "3",
    "BinaryData": "True",
    "TransformMatrix": "0.8 0.6 0 -0.6 0.8 0 0 0 1",
    "Offset": "10 20 30",
    "ElementSpacing": "1 2 3",
    "DimSize": "2 3 4",
    "ElementType": "MET_USHORT",
}


def write(path: Path, data: bytes, **keys: str) -> Path:
    header = {**HEADER, **keys}
    file = header.pop("ElementDataFile", "LOCAL")
    text = "".join(f"{key} = {value}\n" for key, value in header.items() if value) + f"ElementDataFile = {file}\n"
    path.write_bytes(text.encode() + (data if file == "LOCAL" else b""))
    if file != "LOCAL":
        (path.parent / file).write_bytes(data)
    return path


def read(path: Path) -> Volume:
    return Volume.load(path, materials={1: FLESH, 2: FLESH})


RAW = LABELS.astype("<u2").tobytes(order="F")


@pytest.mark.parametrize(
    ("data", "keys"),
    [
        (RAW, {}),
        (RAW, {"ElementDataFile": "v.raw"}),
        (b"#" * 7 + RAW, {"ElementDataFile": "v.raw", "HeaderSize": "7"}),
        (b"#" * 7 + RAW, {"ElementDataFile": "v.raw", "HeaderSize": "-1"}),
        (zlib.compress(RAW), {"CompressedData": "True"}),
        (gzip.compress(RAW, mtime=0), {"CompressedData": "True", "CompressedDataSize": str(len(gzip.compress(RAW)))}),
        (LABELS.astype(">u2").tobytes(order="F"), {"BinaryDataByteOrderMSB": "True"}),
        (LABELS.astype("<f4").tobytes(order="F"), {"ElementType": "MET_FLOAT"}),
    ],
)
def test_every_layout_gives_the_same_volume(data: bytes, keys: dict[str, str], tmp_path: Path) -> None:
    volume = read(write(tmp_path / "v.mha", data, **keys))
    np.testing.assert_array_equal(volume.labels, LABELS)
    np.testing.assert_allclose(volume.spacing, [0.001, 0.002, 0.003])
    center = volume.origin + volume.axes @ (volume.spacing * (1.5, 0.5, 0.5))  # as SimpleITK has it, index (1, 0, 0)
    np.testing.assert_allclose(center, [0.0108, 0.0206, 0.03])


@pytest.mark.parametrize(
    ("data", "keys", "message"),
    [
        (RAW[:-1], {}, "asks for 48 bytes of data and v.mha has 47"),
        (RAW + b"#", {}, "asks for 48 bytes of data and v.mha has 49"),
        (zlib.compress(RAW), {"CompressedData": "True", "CompressedDataSize": "9"}, "asks for 9 bytes"),
        (zlib.compress(RAW + b"#"), {"CompressedData": "True"}, "asks for 48 bytes of data and v.mha has 49"),
        (zlib.compress(RAW)[:-9], {"CompressedData": "True"}, "asks for 48 bytes"),
        (RAW, {"CompressedData": "True"}, "damaged"),
        (RAW, {"ElementType": "MET_STRING"}, "ElementType = MET_STRING"),
        (RAW, {"DimSize": "2 3 0"}, "DimSize = 2 3 0"),
        (RAW, {"DimSize": "6 4", "TransformMatrix": "", "Offset": "0 0", "ElementSpacing": "1 1"}, "have shape"),
        (RAW, {"ElementNumberOfChannels": "3"}, "one integer per voxel"),
        (RAW, {"BinaryData": "False"}, "text or several files"),
        (b"", {"ElementDataFile": "LIST"}, "text or several files"),
        (RAW, {"DistanceUnits": "league"}, "'league'"),
    ],
)
def test_what_does_not_fit_is_refused(data: bytes, keys: dict[str, str], message: str, tmp_path: Path) -> None:
    with pytest.raises(MjframesError, match=message) as error:
        read(write(tmp_path / "v.mha", data, **keys))
    assert str(error.value).startswith(str(tmp_path / "v.mha"))


def test_no_header_and_no_data(tmp_path: Path) -> None:
    (tmp_path / "v.mhd").write_bytes(b"\x00\x01\x02")
    with pytest.raises(MjframesError, match="no MetaImage header"):
        read(tmp_path / "v.mhd")
    (tmp_path / "w.mhd").write_bytes(b"DimSize = 1 1 1\nElementType = MET_UCHAR\nElementDataFile = none.raw\n")
    with pytest.raises(MjframesError, match=r"no file none\.raw"):
        read(tmp_path / "w.mhd")
