"""How thick the flesh below a place of the surface is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mjframes.surface.contact_points import contact_points
from mjframes.surface.dents import dents
from mjframes.surface.isosurface import extract_surface
from mjframes.volume.grid import voxel_grid
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

FLESH = Material(1e5, 0.4, 1000)


@pytest.mark.parametrize("drawn", [True, False])
def test_a_place_above_all_voxels_has_all_the_flesh_below(drawn: bool) -> None:
    """Every eighth place of a round body was above its voxels, and had the thickness of one voxel: it gave no way."""
    ball = Volume.sphere(0.02, FLESH, spacing=0.002)
    volume = ball if drawn else replace(ball, outline=None)
    places = contact_points(extract_surface(volume), 0.002, np.eye(3))
    found = dents(voxel_grid(volume), places.positions, places.normals, 4).thickness
    assert found.min() > 0.034
    assert found.max() < 0.044


def test_bone_ends_the_flesh_and_something_thin_has_a_voxel() -> None:
    labels = np.ones((12, 12, 8), np.uint8)
    labels[:, :, :4] = 2
    volume = Volume.from_labels(labels, 0.002, {1: FLESH, 2: Material(1e9, 0.3, 1000)})
    top = np.array([[0.012, 0.012, 0.016]])
    found = dents(voxel_grid(volume), top, np.array([[0.0, 0, 1]]), 4).thickness
    assert found[0] == pytest.approx(0.009)  # the first half of a voxel that is bone
    plate = Volume.from_labels(labels[:, :, :1], 0.002, {2: FLESH})
    found = dents(voxel_grid(plate), np.array([[0.012, 0.012, 0.002]]), np.array([[0.0, 0, 1]]), 4).thickness
    assert 0.002 <= found[0] <= 0.003
