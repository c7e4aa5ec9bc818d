"""The patches of a soft body's surface, in the order of the bodies that carry them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mjframes.body.soft_body import SoftBody
from mjframes.scene.carriers import Carrier, carrier_of


@dataclass(frozen=True, eq=False)
class Patch:
    """Contact vertices that the same control points move.

    vertices: (s,) of the soft body.
    points: (p,) that move any of them, with all of their frames: one path of the tree, ancestors first.
    carrier: of the deepest point: below it there is nothing that moves the patch.
    """

    vertices: np.ndarray
    points: np.ndarray
    carrier: int


def ordered_patches(body: SoftBody, carried: Sequence[Carrier], rank: np.ndarray) -> list[Patch]:
    """Return the patches in the order of their carriers.  rank: (c,) of each carrier."""
    frame, weights = body.control.frame, body.contact.weights
    carrier = carrier_of(carried)
    ends = [*(1 + np.flatnonzero(np.diff(body.contact.patch))).tolist(), len(body.contact.patch)]
    patches, first = [], 0
    for end in ends:
        moving = np.zeros(len(body.types), bool)
        moving[frame[weights.indices[weights.indptr[first] : weights.indptr[end]]]] = True
        points = np.flatnonzero(moving[frame])
        patches.append(Patch(np.arange(first, end), points, int(carrier[points[-1]])))
        first = end
    return sorted(patches, key=lambda patch: rank[patch.carrier])
