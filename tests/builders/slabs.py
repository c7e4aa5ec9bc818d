"""A soft slab for contact, held at its bottom."""

from __future__ import annotations

from functools import cache

import numpy as np

from mjframes.body.build import build
from mjframes.body.soft_body import SoftBody
from mjframes.frames.supports import Fixed
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume


@cache
def slab(young: float = 2e4) -> SoftBody:
    """0.2 m square, 0.05 m thick, its lowest layer fixed."""
    labels, bottom = np.ones((20, 20, 5), int), np.zeros((20, 20, 5), bool)
    bottom[:, :, 0] = True
    volume = Volume.from_labels(labels, 0.01, {1: Material(young, 0.3, 1000)})
    return build(volume, 5, supports=[Fixed(bottom)])
