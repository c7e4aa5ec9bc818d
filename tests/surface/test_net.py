"""The surface net: flat sides are flat and sharp, slopes and round bodies smooth, and it closes whatever the voxels."""

from __future__ import annotations

import numpy as np
import pytest

from mjframes.surface.isosurface import Surface, extract_surface
from mjframes.surface.net import Net, surface_net
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume


def net_of(labels: np.ndarray) -> Net:
    """In voxels; the corner of the first one at 0."""
    net = surface_net(np.pad(labels > 0, 2))
    return Net(net.vertices - 1.5, net.faces, net.fixed)


def volume_of(labels: np.ndarray) -> Surface:
    return extract_surface(Volume.from_labels(labels.astype(int), 1.0, {1: Material(1e4, 0.3, 1000)}))


def turned_box(angle: float) -> np.ndarray:
    x, y, z = np.indices((44, 44, 26)) - np.array([21.5, 21.5, 12.5])[:, None, None, None]
    c, s = np.cos(angle), np.sin(angle)
    return (np.abs(c * x + s * y) < 12) & (np.abs(c * y - s * x) < 10) & (np.abs(z) < 9)


def cylinder(radius: float, height: int) -> np.ndarray:
    x, y, _ = np.indices((40, 40, height)) - 19.5
    return np.hypot(x, y) < radius


@pytest.mark.parametrize("shape", [(4, 4, 12), (6, 6, 6), (9, 5, 3), (20, 16, 1)])
def test_a_block_is_exact_to_its_corners(shape: tuple[int, int, int]) -> None:
    surface = volume_of(np.ones(shape))
    x = surface.vertices
    assert np.abs(x - np.clip(np.round(x), 0, shape)).max(axis=1).min() < 1e-9
    wide = [a for a in range(3) if min(np.delete(shape, a)) >= 3]  # sides that are three voxels wide or more
    for axis in wide:
        for end in (0, shape[axis]):
            assert (np.abs(x[:, axis] - end) < 1e-9).sum() >= 9
    if len(wide) == 3:
        assert surface.mesh.volume == pytest.approx(np.prod(shape), rel=1e-9)
        corners = np.array(np.meshgrid(*[(0, n) for n in shape])).reshape(3, -1).T
        assert np.linalg.norm(corners[:, None] - x, axis=2).min(axis=1).max() < 1e-9


def test_the_base_of_a_cylinder_is_flat_and_its_side_round() -> None:
    net = net_of(cylinder(15.3, 20))
    x = net.vertices - [20, 20, 10]
    radius = np.hypot(x[:, 0], x[:, 1])
    ends = net.fixed[:, 2] & (radius > 14)
    assert np.abs(np.abs(x[net.fixed[:, 2], 2]) - 10).max() < 1e-9
    rim = ends & (radius > 14.6)
    assert radius[rim].std() < 0.15  # steps of the voxels: 0.3
    side = ~net.fixed.any(axis=1) & (np.abs(x[:, 2]) < 7)
    assert radius[side].std() < 0.12


def test_a_side_across_the_voxels_is_smooth_and_a_ball_has_no_facets() -> None:
    angle = 0.3
    x = volume_of(turned_box(angle)).vertices - np.array([22, 22, 13])
    across = x[:, :2] @ [np.cos(angle), np.sin(angle)]
    middle = (across > 10) & (np.abs(x[:, :2] @ [-np.sin(angle), np.cos(angle)]) < 7) & (np.abs(x[:, 2]) < 6)
    assert middle.sum() > 50
    assert across[middle].std() < 0.1
    assert across[middle].mean() == pytest.approx(12, abs=0.15)

    n = np.indices((44,) * 3) - 21.5
    ball = volume_of((n**2).sum(axis=0) < 20**2)
    radius = np.linalg.norm(ball.vertices - 22, axis=1)
    assert np.abs(radius - 20).max() < 0.25
    assert radius.std() < 0.08  # an isosurface of the smoothed voxels has 0.080


def test_a_lone_voxel_on_a_flat_side_is_no_reason_for_a_spike_and_a_wide_ledge_is_kept() -> None:
    labels = np.zeros((16, 16, 10), int)
    labels[:, :, :8] = 1
    labels[8, 8, 8] = 1
    assert volume_of(labels).vertices[:, 2].max() < 8.5
    labels[:, 8:, 8:] = 1  # of two voxels
    x = volume_of(labels).vertices
    middle = (x[:, 0] > 4) & (x[:, 0] < 12) & (x[:, 1] < 15)
    low, high = (middle & (np.abs(x[:, 2] - z) < 1e-9) for z in (8, 10))
    assert x[low, 1].max() == pytest.approx(8, abs=0.05)
    assert x[high, 1].min() == pytest.approx(8, abs=0.05)


@pytest.mark.parametrize("share", [0.3, 0.5, 0.7])
def test_it_is_closed_and_turned_outwards_whatever_the_voxels(share: float) -> None:
    net = net_of(np.random.default_rng(0).random((12, 11, 10)) < share)
    directed = np.concatenate([net.faces, net.faces[:, [1, 2, 0]], net.faces[:, [2, 0, 1]]])[:, :2]
    key, count = np.unique(directed, axis=0, return_counts=True)
    assert (count == 1).all()
    assert {tuple(edge) for edge in key} == {tuple(edge[::-1]) for edge in key}
