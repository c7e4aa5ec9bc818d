"""Label images from files: p̄(index) = origin + Σ_a axes[:, a] spacing[a] (index_a + ½ − origin_index), all in metres.

Input of the whole pipeline (the paper, §4: material maps sampled on a voxel grid). Each reader returns the file's
contents as they are, converted to SI and, where they say that they show an anatomy, to RAS coordinates (x to the
right, y to the front, z up); `volume.py` judges and normalises them. Images place the centre of their first
voxel, .npz files its corner: `origin_index` says which.
"""

from __future__ import annotations

import bz2
import json
import math
import re
import warnings
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from mjframes.base.archive import Arrays, read_array, require_beside, require_possible
from mjframes.base.constants import KIND, VOLUME_VERSION
from mjframes.base.errors import MjframesError, Notice, reason
from mjframes.base.packages import optional
from mjframes.volume.material import Material
from mjframes.volume.meshes import MESH_TYPES
from mjframes.volume.metaimage import read_metaimage
from mjframes.volume.outline import Outline, outline_in

WITHDRAWN = ("veins", "vein_spacing")  # of materials in older files: how a skin was drawn
PIECE = 2**10  # [bytes] of compressed data that are looked at together: some megabytes at most
METRES = {"m": 1.0, "meter": 1.0, "metre": 1.0, "cm": 1e-2, "mm": 1e-3, "millimeter": 1e-3, "millimetre": 1e-3}
METRES |= {"um": 1e-6, "µm": 1e-6, "μm": 1e-6, "micron": 1e-6, "micrometer": 1e-6, "micrometre": 1e-6}
METRES |= {"": 1e-3, "unknown": 1e-3, "???": 1e-3}  # scanners write millimetres, whether or not they say so
TO_RAS = {  # by NRRD's field `space`: which coordinates change their sign; others stay as they are
    "las": (-1, 1, 1),
    "left-anterior-superior": (-1, 1, 1),
    "3d-left-handed": (-1, 1, 1),
    "lps": (-1, -1, 1),
    "left-posterior-superior": (-1, -1, 1),
}


class ImageWarning(Notice):
    """An image is incomplete; the warning says what is missing and what was assumed."""


@dataclass(frozen=True, eq=False)
class LabelImage:
    """What a file says of an image.

    labels: array as stored.
    spacing, origin: (3,) [m], None where the file says nothing.
    axes: (3, 3), column a is the unit direction of index axis a, maybe left-handed or sheared.
    origin_index: index position of `origin` in the first voxel, ½ its centre, 0 its corner.
    materials: None where the file has none.
    outline: what the voxels were sampled from, None where the file does not say that.
    """

    labels: NDArray[Any]
    spacing: NDArray[np.float64] | None = None
    axes: NDArray[np.float64] = field(default_factory=lambda: np.eye(3))
    origin: NDArray[np.float64] | None = None
    origin_index: float = 0.0
    materials: Mapping[int, Material] | None = None
    outline: Outline | None = None


def read_image(path: Path) -> LabelImage:
    """Return the label image in a file of one of IMAGE_TYPES.

    Raise MjframesError if the file is missing, of another type, unreadable or truncated, or if the package that reads
    it is not installed.
    """
    reader = next((read for suffix, read in READERS.items() if path.name.lower().endswith(suffix)), None)
    if reader is None and path.suffix.lower() in MESH_TYPES:
        raise MjframesError(
            f"{path}: this is a mesh, not a label image; read it with mf.Volume.from_meshes([(path, material)]), or "
            "give it to mjframes build."
        )
    if reader is None:
        raise MjframesError(
            f"{path}: files of type {path.suffix or 'none'} cannot be read; label images are {', '.join(IMAGE_TYPES)}, "
            f"meshes are {', '.join(MESH_TYPES)}."
        )
    if not path.is_file():
        raise MjframesError(f"{path}: there is no such file; labels must be an array or the path of a label image.")
    try:
        return reader(path)
    except MjframesError:
        raise
    except Exception as error:  # a damaged file can fail anywhere in three foreign readers: zlib, zip, parsers, reshape
        raise MjframesError(f"{path}: the file is damaged, truncated or not of its type ({reason(error)}).") from error


def _read_npz(path: Path) -> LabelImage:
    with path.open("rb") as file:
        if file.read(2) != b"PK":
            raise MjframesError(f"{path}: this is not an .npz archive; write it with Volume.save or numpy.savez.")
    with Arrays(path) as archive:
        if str(archive.get("kind")) == KIND:
            raise MjframesError(f"{path}: this is a soft body, which is built already; read it with SoftBody.load.")
        if "format_version" in archive and (version := int(archive["format_version"])) != VOLUME_VERSION:
            raise MjframesError(
                f"{path}: the volume has format version {version}, this mjframes reads {VOLUME_VERSION}; save it anew."
            )
        labels = archive["labels"] if "labels" in archive else _only_labels(path, archive)
        spacing, origin = (archive.get(name) for name in ("spacing", "origin"))
        axes = archive["axes"].astype(np.float64) if "axes" in archive else np.eye(3)
        materials = _parse_materials(path, str(archive["materials"])) if "materials" in archive else None
        outline = outline_in(archive)
    return LabelImage(labels, spacing, axes, origin, materials=materials, outline=outline)


def _only_labels(path: Path, archive: Mapping[str, NDArray[Any]]) -> NDArray[Any]:
    arrays = [a for a in map(np.asarray, archive.values()) if a.ndim == 3 and a.dtype.kind in "biu"]
    if len(arrays) != 1:
        raise MjframesError(
            f"{path}: the archive has no array 'labels' and {len(arrays)} three-dimensional integer arrays; "
            "name the one to read 'labels'."
        )
    return arrays[0]


def write_materials(materials: Mapping[int, Material]) -> str:
    """Return the materials as JSON, for an .npz file."""
    return json.dumps({str(label): vars(material) for label, material in sorted(materials.items())})


def _parse_materials(path: Path, text: str) -> dict[int, Material]:
    try:
        entries: dict[str, dict[str, Any]] = json.loads(text)
        for entry in entries.values():
            for name in WITHDRAWN:
                entry.pop(name, None)
            if "rgba" in entry:
                entry["rgba"] = tuple(entry["rgba"])
        return {int(label): Material(**entry) for label, entry in entries.items()}
    except MjframesError as error:
        raise MjframesError(f"{path}: {error}") from error
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise MjframesError(f"{path}: 'materials' is not what Volume.save writes; leave it out of the file.") from error


def _read_npy(path: Path) -> LabelImage:
    with path.open("rb") as file:
        return LabelImage(read_array(file, path.stat().st_size))


def _read_metaimage(path: Path) -> LabelImage:
    image = read_metaimage(path)
    if image.labels.ndim != 3 or image.spacing is None:
        return LabelImage(image.labels)
    scale = _scale(path, [image.unit] * 3) * ((-1, -1, 1) if image.is_anatomy else (1, 1, 1))
    center = None if image.center is None else scale * image.center
    return _from_steps(path, image.labels, scale[:, None] * image.axes * image.spacing, center)


def _read_nrrd(path: Path) -> LabelImage:
    nrrd = _import("nrrd", path)
    with path.open("rb") as file:
        header = nrrd.read_header(file)
        _require_nrrd_size(path, file, header)
        labels = nrrd.read_data(header, file, str(path))
    if labels.ndim != 3:
        return LabelImage(labels)  # refused later, like every array that is not 3-D
    scale = _scale(path, header.get("space units", header.get("units", [""] * 3)))
    scale = scale * TO_RAS.get(str(header.get("space", "")).lower(), (1, 1, 1))
    if "space directions" in header:
        steps = np.asarray(header["space directions"], np.float64).T
    else:
        steps = np.diag(np.asarray(header.get("spacings", [np.nan] * 3), np.float64))
        if np.isnan(steps).any():
            return LabelImage(labels)
    origin = header.get("space origin")
    return _from_steps(path, labels, scale[:, None] * steps, None if origin is None else scale * np.asarray(origin))


def _require_nrrd_size(path: Path, file: IO[bytes], header: Mapping[str, Any]) -> None:
    """Raise MjframesError where the data would be larger than the header says, or are in another folder."""
    claimed = math.prod(map(int, header["sizes"])) * _nrrd_itemsize(str(header["type"]))
    require_possible(path, claimed)
    for key in ("datafile", "data file"):
        if key in header:
            require_beside(path, str(header[key]))
    start, unpack = file.tell(), None
    if str(header.get("encoding")) in ("gzip", "gz"):
        unpack = zlib.decompressobj(zlib.MAX_WBITS | 16)
    elif str(header.get("encoding")) in ("bzip2", "bz2"):
        unpack = bz2.BZ2Decompressor()
    size, most = 0, claimed + max(0, int(header.get("byteskip", header.get("byte skip", 0))))
    while unpack is not None and size <= most and (some := file.read(PIECE)):
        size += len(unpack.decompress(some))
    if size > most:
        raise MjframesError(f"{path}: its data are larger than the sizes {list(header['sizes'])} of its header.")
    file.seek(start)


def _nrrd_itemsize(kind: str) -> int:
    """Return how many bytes a number of that type takes, or more."""
    if bits := re.search(r"8|16|32|64", kind):
        return int(bits[0]) // 8
    return 8 if "long" in kind else {"char": 1, "uchar": 1, "short": 2, "ushort": 2}.get(kind.split()[-1], 8)


def _read_nifti(path: Path) -> LabelImage:
    image = _import("nibabel", path).load(path)
    header = image.header
    unit = header.get_xyzt_units()[0]
    if unit == "unknown":
        warnings.warn(
            f"{path}: its header has no unit of length; voxels of {header.get_zooms()[0]:g} are taken as millimetres; "
            "give spacing= or --spacing where they are not.",
            ImageWarning,
            stacklevel=2,
        )
    scale = _scale(path, [unit] * 3)
    labels = _nifti_labels(path, image)
    if labels.ndim > 3 and max(labels.shape[3:]) == 1:
        labels = labels.reshape(labels.shape[:3])
    if labels.ndim != 3:
        return LabelImage(labels)
    if header["sform_code"] > 0 or header["qform_code"] > 0:
        return _from_steps(path, labels, scale[:, None] * image.affine[:3, :3], scale * image.affine[:3, 3])
    # nibabel would make up a mirrored, centred affine here; the standard only gives voxel sizes ("method 1")
    return _from_steps(path, labels, np.diag(scale * header.get_zooms()[:3]), None)


def _read_mgz(path: Path) -> LabelImage:
    """FreeSurfer's, which are in millimetres."""
    image = _import("nibabel", path).load(path)
    labels = np.asanyarray(image.dataobj)
    if labels.ndim != 3:
        return LabelImage(labels)
    return _from_steps(path, labels, 1e-3 * image.affine[:3, :3], 1e-3 * image.affine[:3, 3])


def _nifti_labels(path: Path, image: Any) -> NDArray[Any]:
    """The voxels as nibabel has them, those of integers slice by slice: an image that is mostly outside takes little.

    Slices of zeros are not written, and so are no memory; nibabel would hold all of the file twice.
    """
    stored = image.dataobj
    size = math.prod(stored.shape) * stored.dtype.itemsize
    require_possible(path, size)
    if path.suffix.lower() == ".nii" and size > path.stat().st_size:
        raise MjframesError(f"{path}: its header asks for {size} bytes of data, and the file ends before.")
    is_plain = stored.dtype.kind in "iu" and (stored.slope, stored.inter) == (1, 0) and len(stored.shape) == 3
    if not is_plain:
        return np.asanyarray(stored)
    openers = _import("nibabel.openers", path)
    nx, ny, nz = stored.shape
    labels = np.zeros(stored.shape, np.uint8, order="F")
    with openers.ImageOpener(stored.file_like) as file:
        file.seek(stored.offset)
        for c in range(nz):
            data = file.read(nx * ny * stored.dtype.itemsize)
            values = np.frombuffer(data, stored.dtype).reshape((nx, ny), order="F")
            low, high = int(values.min()), int(values.max())
            if low < 0:
                return np.asanyarray(stored)
            if high > np.iinfo(labels.dtype).max:
                labels = labels.astype(np.min_scalar_type(high))
            if high > 0:
                labels[..., c] = values
    return labels


def _from_steps(
    path: Path, labels: NDArray[Any], steps: NDArray[np.float64], center: NDArray[np.float64] | None
) -> LabelImage:
    """steps (3, 3) [m]: column a is one voxel along index axis a.  center (3,) [m] of the first voxel."""
    spacing = np.linalg.norm(steps, axis=0) if steps.shape == (3, 3) else np.full(3, np.nan)
    if not (np.isfinite(spacing).all() and (spacing > 0).all()):
        raise MjframesError(
            f"{path}: the voxel steps in its header are {steps.T.tolist()} [m]; they must be three non-zero vectors."
        )
    if center is None:
        return LabelImage(labels, spacing, steps / spacing)
    return LabelImage(labels, spacing, steps / spacing, np.asarray(center, np.float64), origin_index=0.5)


def _scale(path: Path, units: list[str]) -> NDArray[np.float64]:
    names = [str(unit).strip().strip('"').lower() for unit in units]
    if unknown := [name for name in names if name not in METRES]:
        raise MjframesError(f"{path}: its length unit is {unknown[0]!r}; it must be m, cm, mm or µm.")
    return np.array([METRES[name] for name in names])


def _import(name: str, path: Path) -> Any:
    return optional(name, f"{path}: reading it", "images", {"nrrd": "pynrrd"}.get(name, ""))


READERS: dict[str, Callable[[Path], LabelImage]] = {
    ".npz": _read_npz,
    ".npy": _read_npy,
    ".nrrd": _read_nrrd,
    ".nii": _read_nifti,
    ".nii.gz": _read_nifti,
    ".mha": _read_metaimage,
    ".mhd": _read_metaimage,
    ".mgz": _read_mgz,
    ".mgh": _read_mgz,
}
IMAGE_TYPES = tuple(READERS)
