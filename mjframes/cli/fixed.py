"""What `mjframes build --fixed` takes: which voxels stand still in the body that the soft body is attached to.

-z, -z:4mm                    a slab at a side of the volume, one voxel deep unless told
box:x0,y0,z0,x1,y1,z1         in volume coordinates [m]
near:2mm                      what is so close to the geoms of --parent
label:2                       all of a label
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mjframes.base.constants import UP
from mjframes.base.errors import MjframesError
from mjframes.base.texts import length

if TYPE_CHECKING:
    from mjframes.volume.volume import Volume

FORMS = "a side like -z or -z:4mm, box:x0,y0,z0,x1,y1,z1 [m], near:2mm or label:2"


@dataclass(frozen=True)
class Chosen:
    """kind: "side", "box", "near" or "label".  side: of the first.  numbers: what stands behind the kind, in metres."""

    kind: str
    side: str = ""
    numbers: tuple[float, ...] = ()


def chosen(text: str) -> Chosen:
    """Return what one --fixed asks for. Raise ArgumentTypeError for anything else."""
    head, colon, tail = text.partition(":")
    try:
        if head in UP:
            return Chosen("side", head, (length(tail),) if colon else ())
        if head == "box":
            corners = tuple(float(part) for part in tail.split(","))
            if len(corners) == 6 and all(map(math.isfinite, corners)):
                return Chosen("box", numbers=corners)
        elif head == "near":
            return Chosen("near", numbers=(length(tail),))
        elif head == "label" and tail.isdecimal():
            return Chosen("label", numbers=(int(tail),))
    except (ValueError, argparse.ArgumentTypeError):
        pass
    raise argparse.ArgumentTypeError(f"{text!r} is not {FORMS}")


def fixed_mask(
    wanted: Sequence[Chosen],
    volume: Volume,
    into: str | None,
    parent: str,
    pos: Sequence[float],
    quat: Sequence[float],
) -> NDArray[np.bool_]:
    """Return a mask (nx, ny, nz) of all voxels that --fixed asks for.

    into, parent, pos, quat: the scene and the place in it that `near` measures from.
    Raise MjframesError for what holds no voxel.
    """
    mask = np.zeros(volume.labels.shape, bool)
    for one in wanted:
        try:
            mask |= _mask(one, volume, into, parent, pos, quat)
        except MjframesError as error:
            raise MjframesError(f"--fixed: {error}") from error
    return mask


def _mask(
    one: Chosen, volume: Volume, into: str | None, parent: str, pos: Sequence[float], quat: Sequence[float]
) -> NDArray[np.bool_]:
    if one.kind == "side":
        return volume.side(one.side, one.numbers[0] if one.numbers else None)
    if one.kind == "box":
        return volume.in_box(one.numbers[:3], one.numbers[3:])
    if one.kind == "label":
        return volume.with_label(int(one.numbers[0]))
    from mjframes.scene.load import load_scene
    from mjframes.scene.near import near

    assert into is not None
    return near(load_scene(into)[1], parent, volume, one.numbers[0], pos=pos, quat=quat)
