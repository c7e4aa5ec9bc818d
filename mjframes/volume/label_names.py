"""The names that a label image gives its labels.

NRRD: 3D Slicer's fields Segment0_LabelValue, Segment0_Name, …. NIfTI: a header extension with XML elements
<Label Key="1">liver</Label>, as TotalSegmentator writes it, or with JSON. Any image: JSON beside it, of its own name
or called dataset.json, as {"1": "liver"}, {"liver": 1} or either under "labels".
"""

from __future__ import annotations

import importlib
import json
import re
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

LABEL = re.compile(r'<Label\b[^>]*\bKey="(\d+)"[^>]*>\s*(?:<!\[CDATA\[)?([^<\]]+)')
SUFFIX = re.compile(r"\.(nii|nii\.gz|nrrd|mha|mhd|mgz|mgh|npy|npz)$", re.IGNORECASE)


def label_names(path: Path) -> dict[int, str]:
    """Return names by label, none where the image has no names. A file that is damaged has none either."""
    name = path.name.lower()
    found: dict[int, str] = {}
    with suppress(Exception):  # names are an addition: what cannot be read is left to the reader of the image
        if name.endswith(".nrrd"):
            found = _of_slicer(importlib.import_module("nrrd").read_header(str(path)))
        elif name.endswith((".nii", ".nii.gz")):
            found = _of_extensions(importlib.import_module("nibabel").load(path))
    for beside in (path.with_name(SUFFIX.sub("", path.name) + ".json"), path.with_name("dataset.json")):
        if not found and beside.is_file():
            with suppress(OSError, ValueError):
                found = _of_json(json.loads(beside.read_text(encoding="utf-8")))
    return {label: text for label, text in sorted(found.items()) if label > 0}


def _of_slicer(header: Mapping[str, Any]) -> dict[int, str]:
    found = {}
    for key, value in header.items():
        if (number := re.fullmatch(r"(Segment\d+)_LabelValue", key)) and f"{number[1]}_Name" in header:
            found[int(value)] = str(header[f"{number[1]}_Name"])
    return found


def _of_extensions(image: Any) -> dict[int, str]:
    for extension in image.header.extensions:
        content = extension.get_content()
        text = content.decode("utf-8", "replace") if isinstance(content, bytes) else str(content)
        if found := {int(label): name.strip() for label, name in LABEL.findall(text)}:
            return found
        with suppress(ValueError):
            return _of_json(json.loads(text.rstrip("\0")))
    return {}


def _of_json(content: object) -> dict[int, str]:
    if isinstance(content, Mapping) and isinstance(content.get("labels"), Mapping):
        content = content["labels"]
    found: dict[int, str] = {}
    for key, value in content.items() if isinstance(content, Mapping) else ():
        if str(key).isdecimal() and isinstance(value, str):
            found[int(key)] = value
        elif isinstance(value, int) and not isinstance(value, bool):
            found[value] = str(key)
    return found
