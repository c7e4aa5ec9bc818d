"""What `mjframes build` reads: label images or meshes, and materials from flags or a YAML file.

1: {name: flesh, young: 3e4, poisson: 0.45, density: 1050, rgba: [0.8, 0.3, 0.3]}   # label 1, or the first mesh
2: {name: bone, rigid: true, density: 1900}
fill: {name: fat, young: 1e4, poisson: 0.45, density: 920}   # the rest of the convex hull
"""

from __future__ import annotations

import json
import re
import warnings
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from mjframes.base.errors import MjframesError, Notice, reason
from mjframes.elasticity.law_table import LAWS
from mjframes.volume.images import read_image
from mjframes.volume.label_names import label_names
from mjframes.volume.library import LIBRARY
from mjframes.volume.material import Material
from mjframes.volume.meshes import MESH_TYPES, MeshLike
from mjframes.volume.pieces import chosen_piece
from mjframes.volume.spacing import VOXELS
from mjframes.volume.volume import Volume, occurring
from mjframes.volume.voxelize import LENGTHS

CONSTANTS = {name for law in LAWS.values() for name in law.names}  # of laws for large strains
WITH_MATERIALS = ".npz"  # the type of volumes that were saved with materials
MOST_LABELS = 1000  # of an image that has materials, not intensities


class _Repeated(yaml.YAMLError):
    """A key that a mapping has twice."""


class _Loader(yaml.SafeLoader):
    """YAML whose mappings have each key once: of two entries PyYAML would take the later one without a word."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[object] = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if isinstance(key, Hashable):  # the others are refused by PyYAML
                if key in seen:
                    line = key_node.start_mark.line + 1
                    raise _Repeated(f"{key!r} stands there twice, again in line {line}; leave one of them out.")
                seen.add(key)
        return super().construct_mapping(node, deep)


@dataclass(frozen=True)
class Materials:
    """Materials by label (a mesh's label is its place, from 1 on), and of the rest of the hull, None for nothing.

    default: of all labels that are not named, None where each must be.
    """

    by_label: dict[int, Material] = field(default_factory=dict)
    fill: Material | None = None
    default: Material | None = None


def read_volume(
    files: Sequence[str],
    materials: Materials,
    *,
    spacing: Sequence[float] | None,
    voxels: int | None,
    scale: float | None,
    drop_unknown: bool = False,
    up: str = "z",
    piece: str | None = None,
) -> Volume:
    """Return the volume in one label image, or in one or more meshes, each with the material of its place.

    spacing: (3,) [m].  voxels: about how many to have inside.
    scale: [m] that a unit of the meshes is long, None for their own.
    drop_unknown: an image's labels without a material are outside.  up: axis of the file that points up.
    piece: name of the piece of the one mesh, None for all of it.
    Warn (Notice) of what is chosen where nothing is given.
    Raise MjframesError for what cannot be read or does not go together.
    """
    is_mesh = [Path(file).suffix.lower() in MESH_TYPES for file in files]
    if not any(is_mesh):
        return _read_image(files, materials, spacing, voxels, scale, drop_unknown, up)
    if drop_unknown:
        raise MjframesError(f"{files[0]}: --drop-unknown is for label images; every mesh needs a material.")
    if not all(is_mesh):
        other = files[is_mesh.index(False)]
        raise MjframesError(f"{other}: meshes are given and this is none; give either one label image or meshes.")
    if absent := [file for file in files if not Path(file).is_file()]:
        raise MjframesError(f"{absent[0]}: there is no such file; give the path of a mesh.")
    labels = range(1, len(files) + 1)
    materials = _with_default(materials, list(labels), {})
    if missing := [label for label in labels if label not in materials.by_label]:
        each = ", ".join(f"{files[label - 1]}: mesh {label} has no material" for label in missing)
        flags = " ".join(f"--material {label}=NAME:…" for label in missing)
        raise MjframesError(f"{each}; give one with {flags} or --materials FILE.")
    if unused := sorted(set(materials.by_label) - set(labels)):
        raise MjframesError(
            f"material {unused[0]} has no mesh; there are {len(files)}, numbered from 1 in their order."
        )
    pairs: list[tuple[MeshLike, Material]] = [
        (file if piece is None else chosen_piece(file, piece), materials.by_label[label])
        for file, label in zip(files, labels, strict=True)
    ]
    if spacing is None and voxels is None:
        warnings.warn(
            f"about {VOXELS} voxels are made; choose with --spacing METRES or --voxels N.", Notice, stacklevel=2
        )
    return Volume.from_meshes(pairs, spacing, voxels=voxels, fill=materials.fill, scale=scale, up=up)


def read_materials(path: str) -> Materials:
    """Return the materials in a YAML file.  Raise MjframesError if it is missing or says something else."""
    try:
        entries = yaml.load(Path(path).read_text(encoding="utf-8"), _Loader)
    except (OSError, UnicodeDecodeError) as error:
        raise MjframesError(f"{path}: the materials cannot be read ({getattr(error, 'strerror', error)}).") from error
    except _Repeated as error:
        raise MjframesError(f"{path}: {error}") from error
    except yaml.YAMLError as error:
        raise MjframesError(f"{path}: this is no YAML ({reason(error)}).") from error
    if not isinstance(entries, Mapping) or not entries:
        raise MjframesError(
            f"{path}: it holds no materials; they are lines like 1: {{young: 3e4, poisson: 0.45, density: 1050}}."
        )
    by_label: dict[int, Material] = {}
    fill = default = None
    for label, values in entries.items():
        where = f"{path}: material {label}"
        if label not in ("fill", "default") and (not isinstance(label, int) or isinstance(label, bool) or label < 1):
            raise MjframesError(f"{where} must be called by a label from 1 on, 'fill' or 'default'.")
        if isinstance(values, str) and values in LIBRARY:
            values = {"name": values}
        if not isinstance(values, Mapping):
            raise MjframesError(f"{where} is {values!r}; it must be like {{young: 3e4, poisson: 0.45, density: 1050}}.")
        if label == "fill":
            fill = _material(where, values)
        elif label == "default":
            default = _material(where, values)
        else:
            by_label[label] = _material(where, values)
    return Materials(by_label, fill, default)


def parse_default(texts: Sequence[str]) -> tuple[list[str], Material | None]:
    """Return the texts that are of labels, and the material of "default=flesh:young=3e4,…" among them, or None."""
    own = [text for text in texts if text.partition("=")[0].strip() == "default"]
    if len(own) > 1:
        raise MjframesError(f"--material {own[1]!r} is the second default; give one.")
    rest = [text for text in texts if text not in own]
    return rest, parse_fill(own[0].partition("=")[2], "--material") if own else None


def parse_materials(texts: Sequence[str]) -> dict[int, Material]:
    """Return materials by label, each from what `parse_material` takes.

    Raise MjframesError for a label that comes twice.
    """
    found: dict[int, Material] = {}
    for text in texts:
        label, material = parse_material(text)
        if label in found:
            raise MjframesError(f"--material {text!r} is the second one for label {label}; give each label once.")
        found[label] = material
    return found


def numbered(texts: Sequence[str], pieces: Sequence[str], path: str) -> list[str]:
    """Return texts that start with the name of a piece of a mesh file with its number instead, from 1 on.

    Raise MjframesError for one that starts with neither a piece's name, nor a piece's number, nor "default".
    """
    found = []
    for text in texts:
        named = [n for n, name in enumerate(pieces, 1) if text.startswith((f"{name}=", f"{name}:"))]
        head = re.split("[=:]", text)[0].strip()
        if named:
            text = f"{named[0]}{text[len(pieces[named[0] - 1]) :]}"
        elif head != "default" and not (head.isdecimal() and 1 <= int(head) <= len(pieces)):
            raise MjframesError(
                f"--material {text!r} is of no piece of {path}; its pieces are {', '.join(pieces)}: write a name, a "
                f"number from 1 to {len(pieces)} or default before the material."
            )
        found.append(text)
    return found


def of_piece(materials: Materials, number: int, pieces: Sequence[str], path: str) -> Materials:
    """Return the materials of one mesh, the piece of that number, from those of all pieces by number.

    Raise MjframesError where the piece has none, and for numbers that no piece has.
    """
    if beyond := sorted(set(materials.by_label) - set(range(1, len(pieces) + 1))):
        raise MjframesError(f"material {beyond[0]} has no piece; {path} has {len(pieces)}: {', '.join(pieces)}.")
    name, own = pieces[number - 1], materials.by_label.get(number)
    if own is None and materials.default is None:
        raise MjframesError(
            f"{path}: piece {name!r} has no material; give one with --material {name}=NAME:…, or --material "
            "default=NAME:… for all pieces that have none."
        )
    return replace(materials, by_label={} if own is None else {1: own})


def parse_material(text: str) -> tuple[int, Material]:
    """Return (label, material) of "1=flesh:young=3e4,poisson=0.45,density=1050" or "2=bone:rigid,density=1900".

    The name is optional. One of the library, "1=silicone-00-30", has the values that are not given.
    rgba=0.8/0.3/0.3/1 sets the colour, the opacity may be left out.
    Raise MjframesError for anything else.
    """
    head, _, tail = text.partition(":")
    label, _, name = head.partition("=")
    if not label.strip().isdecimal() or int(label) < 1:
        raise MjframesError(f"--material {text!r} has no label from 1 on; write LABEL=NAME:KEY=VALUE,….")
    return int(label), _parse(f"--material {text!r}", name, tail)


def parse_fill(text: str, option: str = "--fill") -> Material:
    """Return the material of "flesh:young=3e4,poisson=0.45,density=1050".  Raise MjframesError for anything else."""
    name, _, tail = text.partition(":")
    return _parse(f"{option} {text!r}", name, tail)


def _parse(where: str, name: str, tail: str) -> Material:
    values: dict[str, Any] = {"name": name.strip()}
    for entry in filter(None, map(str.strip, tail.split(","))):
        key, equals, value = (part.strip() for part in entry.partition("="))
        if values.get(key):
            raise MjframesError(f"{where} has {key} twice; give it once.")
        values[key] = True if key == "rigid" and not equals else value
    if isinstance(values.get("rgba"), str):
        values["rgba"] = values["rgba"].split("/")
    return _material(where, values)


def _material(where: str, values: Mapping[Any, Any]) -> Material:
    values = _completed(values)
    rigid = values.get("rigid", False)
    wanted = {"density"} if rigid else {"young", "poisson", "density"}
    constants = set() if rigid else set(values) & CONSTANTS
    given = set(values) - {"name", "rgba", "rigid"} - constants
    if given != wanted or not isinstance(rigid, bool):
        raise MjframesError(
            f"{where} has {', '.join(sorted(map(str, given))) or 'no values'}; it needs young [Pa], poisson and "
            "density [kg/m³], or rigid and density, or a name that `mjframes materials` lists; with --law also "
            f"{', '.join(sorted(CONSTANTS))}."
        )
    name = str(values.get("name") or "")
    try:
        numbers = {key: _number(values[key]) for key in wanted}
        of_law = {key: _number(values[key]) for key in sorted(constants)}
        rgba = tuple(map(_number, values.get("rgba", ())))
        if len(rgba) not in (0, 3, 4):
            raise ValueError(rgba)
    except (TypeError, ValueError) as error:
        raise MjframesError(f"{where} has a value that is no number; colours are three or four numbers.") from error
    try:
        if rigid:
            material = Material.rigid(numbers["density"], name=name)
        else:
            material = Material(
                numbers["young"], numbers["poisson"], numbers["density"], name=name, law_constants=of_law
            )
        if not rgba:
            return material
        red, green, blue, alpha = (*rgba, 1.0)[:4]
        return replace(material, rgba=(red, green, blue, alpha))
    except MjframesError as error:
        raise MjframesError(f"{where}: {error}") from error


def _completed(values: Mapping[Any, Any]) -> Mapping[Any, Any]:
    """With the values of the library that are not given, where it has the name."""
    known = LIBRARY.get(str(values.get("name")))
    if known is None or values.get("rigid") or {"young", "poisson", "density"} <= set(values):
        return values
    own = {"rigid": True} if known.young is None else {"young": known.young, "poisson": known.poisson}
    if known.young is None and "young" in values:
        return values
    return {**own, "density": known.density, "rgba": known.rgba, **values}


def _with_own(file: str, materials: Materials) -> Materials:
    """The materials with the file's own for labels that are not named, and the default one for the rest."""
    image = read_image(Path(file))
    labels, own = _labels_of(file, image.labels), dict(image.materials or {})
    if materials.default is not None and own and set(labels) <= {*own, *materials.by_label}:
        raise MjframesError(
            f"{file}: --material default=… is for labels without a material, and there are none: the file has its own; "
            f"name the labels that you mean, as {min(labels)}=NAME:…."
        )
    merged = replace(materials, by_label=own | materials.by_label)
    return _with_default(merged, labels, label_names(Path(file)))


def _with_default(materials: Materials, labels: Sequence[int], names: Mapping[int, str]) -> Materials:
    """The materials with the default one for all labels that have none, called by the label's name."""
    if materials.default is None:
        return materials
    default = materials.default
    rest = {
        label: replace(default, name=names.get(label, default.name))
        for label in labels
        if label not in materials.by_label
    }
    return replace(materials, by_label=materials.by_label | rest)


def template(path: str) -> str:
    """Return YAML with a line for each label of an image, by its name and with its material where the image has one.

    Raise MjframesError for what is no label image.
    """
    image, names = read_image(Path(path)), label_names(Path(path))
    own = image.materials or {}
    lines = ["# young [Pa], poisson [-], density [kg/m³], or rigid: true and density, or a name of the library"]
    for label in _labels_of(path, image.labels):
        name = names.get(label, f"label {label}")
        values = "" if name in LIBRARY else ", young: 1e4, poisson: 0.45, density: 1050"
        if label in own:
            name, values = own[label].name or name, "".join(f", {entry}" for entry in _entries(own[label]))
        lines.append(f"{label}: {{name: {json.dumps(name, ensure_ascii=False)}{values}}}")
    return "\n".join(lines)


def _entries(material: Material) -> list[str]:
    """A material's values as YAML."""
    values: dict[str, object] = {"young": material.young, "poisson": material.poisson}
    if material.is_rigid:
        values = {"rigid": True}
    values |= {"density": material.density, "rgba": material.rgba, **material.law_constants}
    return [f"{key}: {json.dumps(value)}" for key, value in values.items()]


def _labels_of(path: str, labels: NDArray[Any]) -> list[int]:
    found = [int(label) for label in np.unique(labels) if label > 0]
    if len(found) > MOST_LABELS:
        raise MjframesError(f"{path}: it has {len(found)} values; is this a label image? Segment it first.")
    return found


def _number(value: object) -> float:
    """From a number or its text: YAML reads 3e4 as text."""
    if isinstance(value, bool) or not isinstance(value, (int, float, str)):
        raise ValueError(value)
    return float(value)


def _read_image(
    files: Sequence[str],
    materials: Materials,
    spacing: Sequence[float] | None,
    voxels: int | None,
    scale: float | None,
    drop_unknown: bool,
    up: str,
) -> Volume:
    if len(files) > 1:
        raise MjframesError(f"{files[1]}: there is more than one label image; give one, or meshes.")
    if scale is not None:
        raise MjframesError(f"{files[0]}: --unit and --scale are for meshes; set an image's voxel size with --spacing.")
    named = materials.by_label and not drop_unknown and Path(files[0]).suffix.lower() == WITH_MATERIALS
    all_of_it = _with_own(files[0], materials) if named or materials.default is not None else materials
    volume = Volume.load(
        files[0], spacing=spacing, materials=all_of_it.by_label or None, drop_unknown=drop_unknown, crop=True, up=up
    )
    length = float(np.max((np.ptp(np.argwhere(volume.labels), axis=0) + 1) * volume.spacing))
    if not LENGTHS[0] <= length <= LENGTHS[1]:
        warnings.warn(
            f"{files[0]}: the body is {length:.3g} m long; if its voxels have another size, give --spacing METRES.",
            Notice,
            stacklevel=3,
        )
    if unused := sorted(set(materials.by_label) - set(occurring(volume.labels))):
        raise MjframesError(
            f"{files[0]}: material {unused[0]} is given, but no voxel has this label; the labels are "
            f"{', '.join(map(str, occurring(volume.labels)))}."
        )
    if materials.fill is not None:
        volume = volume.filled(materials.fill)
    return volume if voxels is None else volume.resample(voxels)
