"""Lengths on the command line: 2mm, 0.5cm, or metres without a unit."""

from __future__ import annotations

import argparse
import math
import re

from mjframes.base.constants import METRES


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
