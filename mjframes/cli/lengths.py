"""Lengths, directions and indenters on the command line: 2mm, 0.5cm or metres without a unit; -z; ball:10mm."""

from __future__ import annotations

import argparse
import math
import re

from mjframes.base.constants import METRES, UP

INDENTERS = ("ball", "cylinder", "punch")


def length(text: str) -> float:
    """Return a length ≥ 0 [m] from "2mm", "0.5cm" or "0.002". Raise ArgumentTypeError for anything else."""
    parts = re.fullmatch(rf"(.*?) *({'|'.join(METRES)})?", text)
    try:
        found = float(parts[1]) * METRES[parts[2] or "m"] if parts else math.nan
    except ValueError:
        found = math.nan
    if not (math.isfinite(found) and found >= 0):
        raise argparse.ArgumentTypeError(f"{text!r} is not a length like 2mm or 0.002, which is in metres")
    return found


def indenter(text: str) -> tuple[str, float]:
    """Return kind and size [m] of "ball:10mm". Raise ArgumentTypeError for anything else."""
    kind, _, size = text.partition(":")
    try:
        found = length(size)
    except argparse.ArgumentTypeError:
        found = 0.0
    if kind not in INDENTERS or found <= 0:
        raise argparse.ArgumentTypeError(f"{text!r} is not ball:RADIUS, cylinder:RADIUS or punch:WIDTH, as ball:10mm")
    return kind, found


def direction(text: str) -> tuple[float, float, float]:
    """Return "-z" or "0,0,-1" as three numbers, not all 0. Raise ArgumentTypeError for anything else."""
    if text in UP:
        x, y, z = ((-1.0 if text[0] == "-" else 1.0) * (axis == text[-1]) for axis in "xyz")
        return x, y, z
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        x = y = z = math.nan
    if not all(map(math.isfinite, (x, y, z))) or not any((x, y, z)):
        raise argparse.ArgumentTypeError(f"{text!r} is not an axis like -z or three numbers with commas between")
    return x, y, z
