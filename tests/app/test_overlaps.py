"""Soft bodies that start inside each other are told of; what each fills is measured by its surface."""

from __future__ import annotations

import warnings

import mujoco
import numpy as np
import pytest
import trimesh

from mjframes.app.overlaps import overlap
from mjframes.app.run import record
from mjframes.body.build import build
from mjframes.scene.attach import attach
from mjframes.scene.instability import InstabilityWarning
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume


@pytest.mark.parametrize(
    ("along", "collide", "told"), [(0.0, True, "100%"), (0.2, True, "60%"), (0.2, False, ""), (0.45, True, "")]
)
def test_soft_bodies_that_start_in_the_same_place_are_told_of(along: float, collide: bool, told: str) -> None:
    volume = Volume.from_labels(np.ones((20, 4, 4), np.uint8), 0.025, {1: Material(1e5, 0.3, 1000)})
    body = build(volume, frames=2)
    spec = mujoco.MjSpec.from_string("<mujoco><option gravity='0 0 0'/></mujoco>")
    for name, x in (("first", 0.0), ("second", along)):
        attach(spec, body, name, pos=(x, 0, 0))
    for geom in spec.geoms:
        geom.conaffinity = int(collide)
    model = spec.compile()
    sentences = _said(model)
    assert [s for s in sentences if "start inside" in s] == bool(told) * [
        f"the soft bodies 'first' and 'second' start inside each other: {told} of the smaller one is in both. "
        "Contacts cannot push them apart from there; start them farther apart."
    ]


@pytest.mark.slow
def test_surfaces_share_what_both_enclose() -> None:
    box = trimesh.creation.box((2, 2, 2))
    ball = trimesh.creation.icosphere(4, 1.0)
    shell = trimesh.creation.icosphere(4, 2.0) + _inverted(ball)
    surfaces = [mesh.vertices[mesh.faces] for mesh in (box, ball, shell)]
    assert overlap(surfaces[0], surfaces[1], 0.1) == pytest.approx(1, abs=0.03)
    assert overlap(surfaces[0], surfaces[1] + [1, 0, 0], 0.1) == pytest.approx(0.5, abs=0.03)
    assert overlap(surfaces[1], surfaces[2], 0.01) == pytest.approx(0, abs=0.02)  # a ball in a shell's hole


def _inverted(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    turned = mesh.copy()
    turned.invert()
    return turned


def _said(model: mujoco.MjModel) -> list[str]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        record(model, 0.02)
    return [str(warning.message) for warning in caught if warning.category is InstabilityWarning]
