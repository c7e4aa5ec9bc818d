"""A soft block for contact between soft bodies."""

from __future__ import annotations

from functools import cache

import numpy as np

from mjframes.body.build import build
from mjframes.body.soft_body import SoftBody
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume


@cache
def block(
    shape: tuple[int, int, int], spacing: float, density: float, beta: float = 0.0, young: float = 1e5
) -> SoftBody:
    labels = np.ones(shape, int)
    volume = Volume.from_labels(labels, spacing, {1: Material(young, 0.3, density)})
    return build(volume, 3, damping=(0.0, beta))
