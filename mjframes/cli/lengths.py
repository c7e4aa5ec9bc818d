"""Directions and indenters on the command line: -z; ball:10mm."""

from __future__ import annotations

import argparse

from mjframes.base.constants import UP
from mjframes.base.texts import length, numbers

INDENTERS = ("ball", "cylinder", "punch")


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
    found = numbers(text)
    if len(found) != 3 or not any(found):
        raise argparse.ArgumentTypeError(f"{text!r} is not an axis like -z or three numbers with commas between")
    return found[0], found[1], found[2]
