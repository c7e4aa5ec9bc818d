"""Held pieces of one body: what lies between them is of a region, too."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from builders.scenes import compiled

import mjframes as mf


@pytest.mark.parametrize("law", ["corotational", "neo_hookean"])
@pytest.mark.parametrize(("layers", "frames"), [((0, 8), 1), ((0, 8), 2), ((0, 4), 3), ((0, 4, 8), 1)])
def test_a_bar_with_several_held_layers_is_built_and_rests(layers: tuple[int, ...], frames: int, law: str) -> None:
    labels = np.ones((24, 3, 3), int)
    volume = mf.Volume.from_labels(labels, 0.01, {1: mf.Material(1e5, 0.3, 1000)})
    held = [np.arange(24)[:, None, None] + 0 * labels == layer for layer in layers]
    made = mf.build(volume, frames, law=law, supports=[mf.Fixed(one) for one in held], damping=(5.0, 0.0))
    model, data = compiled("<mujoco/>", (made, (0, 0, 0), (1, 0, 0, 0)), contact=False)
    mujoco.mj_step(model, data, 2000)
    assert not data.warning.number.any()
    assert np.abs(data.qvel).max() < 1e-3
