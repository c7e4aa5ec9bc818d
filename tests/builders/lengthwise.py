"""A block of one material, and points of it."""

from __future__ import annotations

from functools import cache

import numpy as np

import mjframes as mf
from mjframes.elasticity.law_table import ALL_LAWS
from mjframes.volume.grid import voxel_grid

LAWS = list(ALL_LAWS)
MATERIAL = mf.Material(young=5e4, poisson=0.3, density=1000)


@cache
def block(law: str = "corotational", **options: object) -> mf.SoftBody:
    """0.12 × 0.04 × 0.04 m of one material, three frames, nothing relaxed."""
    volume = mf.Volume.from_labels(np.ones((12, 4, 4), int), 0.01, {1: MATERIAL})
    return mf.build(volume, 3, method=mf.Paper(4), law=law, **options)  # pyright: ignore[reportArgumentType]


def centers(body: mf.SoftBody) -> np.ndarray:
    return voxel_grid(body.fields.volume).centers
