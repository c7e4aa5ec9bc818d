"""Values as one writes them on a command line. Each function raises ArgumentTypeError for any other text."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Callable

from mjframes.base.constants import METRES


def numbers(text: str, separator: str = ",") -> tuple[float, ...]:
    """Return the finite numbers in a text, none if one of them is not."""
    try:
        found = tuple(float(part) for part in text.split(separator))
    except ValueError:
        return ()
    return found if all(map(math.isfinite, found)) else ()


def a_number(holds: Callable[[float], bool], what: str) -> Callable[[str], float]:
    """Return a reader of one number for which `holds` is true. what: as "a positive number"."""

    def read(text: str) -> float:
        found = numbers(text)
        if len(found) != 1 or not holds(found[0]):
            raise argparse.ArgumentTypeError(f"{text!r} is not {what}")
        return found[0]

    return read


factor = a_number(lambda value: value > 0, "a positive number")
share = a_number(lambda value: 0 < value < 1, "a number between 0 and 1")


def count(text: str) -> int:
    """Return a whole number from 1 on."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 1 on")
    return int(text)


def seed(text: str) -> int:
    """Return a whole number from 0 on."""
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 0 on")
    return int(text)


def rates(text: str) -> tuple[float, float]:
    """Return two numbers ≥ 0 of "1,0.001"."""
    found = numbers(text)
    if len(found) != 2 or min(found) < 0:
        raise argparse.ArgumentTypeError(f"{text!r} is not two rates ≥ 0 with a comma between")
    return found[0], found[1]


def place(text: str) -> tuple[float, float, float]:
    """Return three coordinates [m] of "0,0,0.3"."""
    found = numbers(text)
    if len(found) != 3:
        raise argparse.ArgumentTypeError(f"{text!r} is not three coordinates in metres with commas between")
    return found[0], found[1], found[2]


def orientation(text: str) -> tuple[float, float, float, float]:
    """Return a quaternion of "1,0,0,0"."""
    found = numbers(text)
    if len(found) != 4 or not any(found):
        raise argparse.ArgumentTypeError(f"{text!r} is not a quaternion, four numbers, not all 0, with commas between")
    return found[0], found[1], found[2], found[3]


def spacing(text: str) -> tuple[float, ...]:
    """Return three edges [m] of a voxel, of "0.001" or "0.001,0.001,0.002"."""
    found = numbers(text)
    if len(found) not in (1, 3) or min(found) <= 0:
        raise argparse.ArgumentTypeError(f"{text!r} is not one length in metres or three with commas between")
    return found * (3 // len(found))


def bounds(text: str) -> tuple[str, tuple[float, float]]:
    """Return a name and two numbers of "steak.flesh=0.5:2"."""
    name, _, range_ = text.partition("=")
    found = numbers(range_, ":")
    if not name or len(found) != 2:
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=LOW:HIGH with two numbers")
    return name, (found[0], found[1])


def length(text: str) -> float:
    """Return a length ≥ 0 [m] of "2mm", "0.5cm" or "0.002"."""
    parts = re.fullmatch(rf"(.*?) *({'|'.join(METRES)})?", text)
    found = numbers(parts[1]) if parts else ()
    if not parts or len(found) != 1 or found[0] < 0:
        raise argparse.ArgumentTypeError(f"{text!r} is not a length like 2mm or 0.002, which is in metres")
    return found[0] * METRES[parts[2] or "m"]
