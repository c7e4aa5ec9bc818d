"""Bars of the laws for large strains."""

from __future__ import annotations

from functools import cache

import numpy as np

import mjframes as mf
from mjframes.body.soft_body import SoftBody


@cache
def bar(law: str, method: str) -> SoftBody:
    labels = np.ones((24, 6, 6), int)
    material = mf.Material(young=1e5, poisson=0.4, density=1000)
    volume = mf.Volume.from_labels(labels, 0.01, {1: material})
    return mf.build(volume, 3, method=mf.Paper(4) if method == "paper" else method, law=law)
