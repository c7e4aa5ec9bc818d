"""Boxes, spheres and cylinders: their size is what was asked for, they are where they should be, and errors say why."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
import trimesh

import mjframes as mf

RUBBER = mf.Material(1e5, 0.4, 1000, name="rubber")


def content(volume: mf.Volume) -> float:
    """[m³]."""
    return np.count_nonzero(volume.labels) * float(np.prod(volume.spacing))


@pytest.mark.parametrize("given", [{"spacing": 0.007}, {"voxels": 500}, {"spacing": (0.02, 0.003, 0.01)}, {}])
def test_a_box_has_its_size(given: dict[str, Any]) -> None:
    volume = mf.Volume.box((0.1, 0.05, 0.02), RUBBER, **given)
    assert volume.labels.all()
    np.testing.assert_allclose(volume.labels.shape * volume.spacing, (0.1, 0.05, 0.02), rtol=1e-12)
    np.testing.assert_allclose(volume.centers.mean(axis=0), 0, atol=1e-15)
    assert volume.materials == {1: RUBBER}


def test_the_spacing_of_a_box_is_the_nearest_that_fits() -> None:
    assert mf.Volume.box((0.1, 0.05, 0.02), RUBBER, 0.007).labels.shape == (14, 7, 3)
    whole = mf.Volume.box(0.06, RUBBER, 0.01)
    assert whole.labels.shape == (6, 6, 6)
    np.testing.assert_allclose(whole.spacing, 0.01, rtol=1e-12)


@pytest.mark.parametrize("voxels", [1_000, 20_000])
def test_the_number_of_voxels_is_about_what_was_asked_for(voxels: int) -> None:
    for volume in (
        mf.Volume.box((0.1, 0.05, 0.02), RUBBER, voxels=voxels),
        mf.Volume.sphere(0.03, RUBBER, voxels=voxels),
        mf.Volume.cylinder(0.02, 0.05, RUBBER, voxels=voxels),
    ):
        assert np.count_nonzero(volume.labels) == pytest.approx(voxels, rel=0.08)


def test_a_sphere_has_the_content_of_a_ball_and_no_preferred_side() -> None:
    volume = mf.Volume.sphere(0.03, RUBBER)
    assert content(volume) == pytest.approx(4 / 3 * np.pi * 0.03**3, rel=0.005)
    assert (np.linalg.norm(volume.centers, axis=1) < 0.03).all()
    for turned in (volume.labels[::-1], volume.labels[:, ::-1], volume.labels.transpose(1, 2, 0)):
        np.testing.assert_array_equal(turned, volume.labels)
    np.testing.assert_allclose(volume.centers.mean(axis=0), 0, atol=1e-12)


def test_a_cylinder_is_round_about_z_and_as_long_as_asked_for() -> None:
    volume = mf.Volume.cylinder(0.02, 0.05, RUBBER, 0.0019)
    assert content(volume) == pytest.approx(np.pi * 0.02**2 * 0.05, rel=0.01)
    assert volume.labels.shape[2] * volume.spacing[2] == pytest.approx(0.05, rel=1e-12)
    assert volume.spacing[:2].tolist() == [0.0019, 0.0019]
    assert (volume.labels == volume.labels[:, :, :1]).all()
    np.testing.assert_array_equal(volume.labels.transpose(1, 0, 2), volume.labels)


@pytest.mark.parametrize("finer", [3, 10 / 3, 4, 4.7, 5, 6, 8, 10])
def test_usual_spacings_of_balls_and_cylinders_are_taken(finer: float) -> None:
    radius = 0.03
    ball = mf.Volume.sphere(radius, RUBBER, radius / finer)
    assert content(ball) == pytest.approx(4 / 3 * np.pi * radius**3, rel=0.21)
    rod = mf.Volume.cylinder(radius, 0.05, RUBBER, radius / finer)
    assert content(rod) == pytest.approx(np.pi * radius**2 * 0.05, rel=0.21)


@pytest.mark.parametrize("length", [0.002, 0.05, 0.5])
def test_the_number_of_voxels_that_an_error_names_does(length: float) -> None:
    named = set()
    for voxels in range(1, 40):
        try:
            mf.Volume.cylinder(0.03, length, RUBBER, voxels=voxels)
        except mf.MjframesError as error:
            named |= set(map(int, re.findall(r"times the body's volume; take (\d+) or more", str(error))))
    (enough,) = named
    for voxels in range(enough, enough + 20):
        mf.Volume.cylinder(0.03, length, RUBBER, voxels=voxels)


def test_a_sphere_is_sampled_as_a_mesh_is() -> None:
    """Where the grid of the mesh begins at the same place: a whole number of voxels across."""
    own = mf.Volume.sphere(0.03, RUBBER, 0.002)
    fine = trimesh.creation.icosphere(subdivisions=5, radius=0.03)
    meshed = mf.Volume.from_meshes([(fine, RUBBER)], 0.002)
    assert own.labels.shape == meshed.labels.shape
    assert np.mean(own.labels != meshed.labels) < 0.01


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: mf.Volume.box((0.1, 0), RUBBER), r"^size is \(0\.1, 0\); it must be one or three positive lengths"),
        (lambda: mf.Volume.box((0.1, 0.1, -1), RUBBER), "^size is"),
        (lambda: mf.Volume.sphere(-1, RUBBER), "^radius is -1; it must be a positive length in metres"),
        (lambda: mf.Volume.cylinder(1, "2", RUBBER), "^length is '2'; it must be a positive length"),  # type: ignore[arg-type]
        (lambda: mf.Volume.sphere(1, RUBBER, 0.1, voxels=9), r"^spacing is 0\.1 and voxels is 9; give exactly one"),
        (lambda: mf.Volume.sphere(1, RUBBER, voxels=0), "^voxels is 0; it must be a whole number from 1 on"),
        (lambda: mf.Volume.sphere(0.01, RUBBER, 0.019), r"^spacing is 0\.019, which leaves no voxel .*; take less"),
        (lambda: mf.Volume.box((1, 1, 0.01), RUBBER, 0.1), r"^spacing is 0\.1, which leaves no voxel in a body of 1 ×"),
        (lambda: mf.Volume.sphere(1, RUBBER, voxels=2), "^voxels is 2, which leaves no voxel .*; take more"),
        (
            lambda: mf.Volume.sphere(0.01, RUBBER, 0.05),
            r"^spacing is 0\.05, which makes voxels of 30 times the body's volume; take 0\.003 m or less\.$",
        ),
        (lambda: mf.Volume.sphere(0.01, RUBBER, 0.02), r"^spacing is 0\.02, which makes voxels of 1\.9 times"),
        (
            lambda: mf.Volume.cylinder(0.01, 0.1, RUBBER, (0.02, 0.02, 0.1)),
            r"^spacing is .* 1\.3 times .*; take 0\.003 m",
        ),
        (
            lambda: mf.Volume.sphere(1, RUBBER, voxels=3),
            "^voxels is 3, .* 2.7 times the body's volume; take 156 or more",
        ),
        (lambda: mf.Volume.box(1, RUBBER, 1e-4), "^spacing is .* cells of a body"),
        (lambda: mf.Volume.box(1, 3.0), r"^material is 3\.0; it must be a Material"),  # type: ignore[arg-type]
    ],
)
def test_what_cannot_be_is_refused(make: Any, message: str) -> None:
    with pytest.raises(mf.MjframesError, match=message):
        make()
