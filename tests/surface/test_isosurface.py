"""Surfaces: closed, oriented, volume-preserving, thin parts kept, seams shared; contact points; weights at points."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from mjframes.base.errors import MjframesError
from mjframes.surface.contact_points import contact_points
from mjframes.surface.decimate import decimate
from mjframes.surface.isosurface import Surface, extract_surface
from mjframes.volume.grid import Grid, voxel_grid
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume
from mjframes.weights.interpolation import voxel_shares

FLESH = Material(1e4, 0.4, 1000)
SPACING = np.array([0.002, 0.002, 0.003])
TILT = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def make_volume(labels: np.ndarray, spacing: np.ndarray | float = SPACING) -> Volume:
    """Off the origin and rotated, so that a wrong transform shows."""
    plain = Volume.from_labels(
        labels, spacing=spacing, materials={int(k): FLESH for k in np.unique(labels) if k}, origin=(0.1, 0.2, 0.3)
    )
    return Volume(plain.labels, plain.spacing, plain.origin, TILT, plain.materials)


def ball(n: int = 24, slices: int = 1) -> np.ndarray:
    """A ball of `slices` materials that meet in one line through its middle."""
    p = np.indices((n, n, n)) - (n - 1) / 2
    angle = np.arctan2(p[1], p[0]) / (2 * np.pi) + 0.5
    label = 1 + np.clip((angle * slices).astype(int), 0, slices - 1)
    return np.where((p**2).sum(axis=0) < (n / 2 - 1) ** 2, label, 0)


def block_with_sheet() -> np.ndarray:
    """A block with a plate and a rod one voxel thick: smoothing alone would delete them."""
    labels = np.zeros((40, 14, 14), int)
    labels[1:11, 2:12, 2:12] = 1
    labels[11:25, 2:12, 6] = 1
    labels[25:38, 6, 6] = 2
    return labels


def edge_use(faces: np.ndarray) -> np.ndarray:
    """How often each directed edge is met in the other direction: all ones for a closed oriented surface."""
    directed = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
    key = directed[:, 0] * (faces.max() + 1) + directed[:, 1]
    back = directed[:, 1] * (faces.max() + 1) + directed[:, 0]
    values, counts = np.unique(key, return_counts=True)
    position = np.clip(np.searchsorted(values, back), 0, len(values) - 1)
    return np.where(values[position] == back, counts[position], 0) * counts[np.searchsorted(values, key)]


@pytest.mark.parametrize("labels", [ball(), ball(slices=3), block_with_sheet(), np.ones((9, 6, 4), int)])
@pytest.mark.parametrize("target", [400, 100_000])
def test_closed_outward_and_of_the_volume_of_the_voxels(labels: np.ndarray, target: int) -> None:
    volume = make_volume(labels)
    surface = extract_surface(volume, target)
    assert (edge_use(surface.faces) == 1).all()
    assert surface.mesh.volume == pytest.approx(np.count_nonzero(labels) * SPACING.prod(), rel=0.002)
    inside = voxel_grid(volume).centers
    assert KDTree(inside).query(surface.vertices)[0].max() < 1.5 * SPACING.max()
    assert np.ptp(surface.vertices, axis=0) == pytest.approx(np.ptp(inside, axis=0) + abs(TILT @ SPACING), abs=0.004)


def test_thin_parts_survive_smoothing() -> None:
    volume = make_volume(block_with_sheet())
    surface = extract_surface(volume)
    centres = voxel_grid(volume).centers
    assert KDTree(surface.vertices).query(centres[centres[:, 1] > 0.2 + 0.03])[0].max() < 0.003
    assert set(np.unique(surface.label)) == {1, 2}


def test_a_short_neck_holds_and_a_single_step_is_smoothed() -> None:
    labels = np.zeros((22, 8, 8), int)
    labels[:10], labels[12:], labels[10:12, 4, 4] = 1, 1, 1
    surface = extract_surface(make_volume(labels))
    size = len(surface.vertices)
    links = csr_array(
        (np.ones(surface.faces.size), (surface.faces.ravel(), np.roll(surface.faces, 1, 1).ravel())), (size, size)
    )
    assert connected_components(links, directed=False)[0] == 1

    labels = np.ones((12, 12, 6), int)
    labels[:, :, 5] = 0
    labels[6, 6, 5] = 1
    top = extract_surface(make_volume(labels)).vertices[:, 2].max()
    assert top - 0.3 < 5.5 * SPACING[2]  # of 6


def test_decimation_is_uniform_and_faithful() -> None:
    volume = make_volume(ball(56), spacing=0.001)  # the net starts with edges of a voxel
    fine, coarse = extract_surface(volume, 100_000), extract_surface(volume, 600)
    assert len(coarse.vertices) == pytest.approx(600, rel=0.05)
    assert len(fine.vertices) > 4000
    sides = coarse.vertices[coarse.faces] - coarse.vertices[np.roll(coarse.faces, 1, axis=1)]
    length = np.linalg.norm(sides, axis=2)
    assert length.max() < 2.2 * np.median(length)
    centre = fine.vertices.mean(axis=0)
    assert np.linalg.norm(coarse.vertices - centre, axis=1).std() < 0.0003
    with pytest.raises(MjframesError, match="target_vertices"):
        extract_surface(volume, 3)


def test_decimation_keeps_the_edges_of_a_box() -> None:
    ball_surface = extract_surface(make_volume(ball(), spacing=0.001))
    x = np.clip((ball_surface.vertices - ball_surface.vertices.mean(axis=0)) * 90, -0.55, 0.55)
    y, faces = decimate(x, ball_surface.faces, len(x) // 4)
    volume = [Surface(p, f, f[:, 0]).mesh.volume for p, f in ((x, ball_surface.faces), (y, faces))]
    assert len(y) < 0.3 * len(x)
    assert volume[1] == pytest.approx(volume[0], rel=0.01)
    on_edges = (np.abs(np.abs(y) - 0.55) < 1e-3).sum(axis=1) >= 2
    assert on_edges.sum() > 60


@pytest.mark.parametrize(("labels", "targets"), [(ball(), (300, 600, 1000)), (block_with_sheet(), (150, 300, 600))])
def test_decimation_turns_no_triangle_over(labels: np.ndarray, targets: tuple[int, ...]) -> None:
    volume = make_volume(labels)
    fine = extract_surface(volume, 100_000)
    for target in targets:
        coarse = extract_surface(volume, target)
        a, b, c = coarse.vertices[coarse.faces].transpose(1, 0, 2)
        normal = np.cross(b - a, c - a)
        # of those nearby: beside a sharp edge the nearest one may be round the corner
        near = KDTree(fine.mesh.triangles_center).query((a + b + c) / 3, k=8)[1]
        assert np.einsum("tc,tkc->tk", normal, fine.mesh.face_normals[near]).max(axis=1).min() > 0


@pytest.mark.parametrize("slices", [2, 3])
def test_seams_are_smooth_and_their_materials_right(slices: int) -> None:
    volume = make_volume(ball(40, slices), spacing=0.001)
    surface = extract_surface(volume, 1500)
    grid = voxel_grid(volume)
    middle = surface.vertices[surface.faces].mean(axis=1)
    near = KDTree(grid.centers).query(middle, k=8)[1]
    same = (grid.label[near] == surface.label[:, None]).any(axis=1)
    assert same.all()
    assert set(np.unique(surface.label)) == set(range(1, slices + 1))
    # the seam of labels 1 and 2 lies in a plane through the middle: its vertices may not zigzag by voxels
    shared = np.intersect1d(surface.faces[surface.label == 1], surface.faces[surface.label == 2])
    local = (surface.vertices[shared] - surface.vertices.mean(axis=0)) @ TILT
    angle = -np.pi + 2 * np.pi / slices
    seam = local[(local[:, :2] @ [np.cos(angle), np.sin(angle)] > 0.004) & (np.abs(local[:, 2]) < 0.017)]
    assert len(seam) > 10
    assert np.abs(seam[:, :2] @ [-np.sin(angle), np.cos(angle)]).std() < 0.00025


def test_contact_points_are_on_the_surface() -> None:
    volume = make_volume(ball(30), spacing=0.002)
    surface = extract_surface(volume)
    points = contact_points(surface, 0.002, volume.axes, count=200)
    assert 200 <= len(points.positions) < 260  # those at the rims of the ball's small flat faces are two
    assert KDTree(surface.vertices).query(points.positions)[0].max() <= 0.1 * 0.002 * np.sqrt(2) * (1 + 1e-9)


def test_contact_points_cover_whatever_their_number_and_take_the_corners_first() -> None:
    volume = make_volume(np.ones((20, 16, 3), int), spacing=0.002)
    surface = extract_surface(volume)
    points = contact_points(surface, 0.002, volume.axes, count=300)
    order = points.positions
    holes = [KDTree(order[:n]).query(surface.vertices)[0].max() for n in (8, 40, 300)]
    assert holes[2] < 0.005
    assert holes[0] > holes[1] > holes[2]
    local = (order[:26] - surface.vertices.mean(axis=0)) @ TILT
    corners = np.abs(local[:, :2]) > [0.015, 0.011]
    assert len({tuple(np.sign(p)) for p in local[corners.all(axis=1)]}) == 8
    sides = np.sign((order - surface.vertices.mean(axis=0))[:, 2])
    assert abs(sides.sum()) < 40  # both sides of the plate alike


def test_contact_points_see_both_sides_of_a_thin_plate() -> None:
    volume = make_volume(np.ones((30, 30, 1), int), spacing=0.002)
    surface = extract_surface(volume)
    points = contact_points(surface, 0.002, volume.axes, count=100)
    for side in (-1, 1):
        here, there = (side * (p[:, 2] - 0.301) > 0 for p in (points.positions, surface.vertices))
        assert KDTree(points.positions[here]).query(surface.vertices[there])[0].max() < 0.0095


def two_frames() -> tuple[Volume, csr_array, np.ndarray]:
    """A bar whose weights are linear in its length, 1 in the first quarter and 0 in the last; a rigid end."""
    labels = np.ones((20, 6, 6), int)
    labels[17:] = 2
    plain = make_volume(labels, spacing=0.002)
    volume = Volume(plain.labels, plain.spacing, plain.origin, TILT, {1: FLESH, 2: Material.rigid(1900)})
    grid = voxel_grid(volume)
    first = np.clip((15 - grid.index[:, 0]) / 10, 0, 1)
    return volume, csr_array(np.column_stack([first, 1 - first])), first


def surface_weights(grid: Grid, weights: csr_array, points: np.ndarray) -> csr_array:
    return csr_array(voxel_shares(grid, weights, points) @ weights)


def test_surface_weights_are_trilinear_within_one_set_of_frames() -> None:
    volume, weights, _ = two_frames()
    grid = voxel_grid(volume)
    rng = np.random.default_rng(1)
    cell = rng.uniform([0, 0, 0], [20, 6, 6], (400, 3))
    points = volume.origin + (cell * volume.spacing) @ TILT.T
    found = surface_weights(grid, weights, points).toarray()
    assert found.sum(axis=1) == pytest.approx(np.ones(400), abs=1e-12)
    inner = (cell[:, 0] > 6.5) & (cell[:, 0] < 14.5)
    assert found[inner, 0] == pytest.approx((15.5 - cell[inner, 0]) / 10, abs=1e-12)
    nearest = weights.toarray()[KDTree(grid.centers).query(points)[1]]
    assert ((found > 0) == (nearest > 0)).all()


def test_surface_weights_of_voxels_and_of_rigid_pieces() -> None:
    volume, weights, _ = two_frames()
    grid = voxel_grid(volume)
    assert abs(surface_weights(grid, weights, grid.centers) - weights).max() < 1e-12
    mixed = weights.toarray()
    mixed[grid.piece >= 0] = [0.3, 0.7]
    mixed[grid.label == 1] = [0.6, 0.4]
    end = grid.centers[grid.piece >= 0] + 0.9 * 0.5 * grid.spacing * [1, -1, 1]
    assert surface_weights(grid, csr_array(mixed), end).toarray() == pytest.approx(np.tile([0.3, 0.7], (len(end), 1)))


def test_surface_weights_outside_take_the_nearest_voxel() -> None:
    volume, weights, first = two_frames()
    grid = voxel_grid(volume)
    found = surface_weights(grid, weights, grid.centers + np.array([0, 0, 0.02])).toarray()
    assert found[:, 0] == pytest.approx(first)


def test_a_single_voxel_has_a_surface_around_it() -> None:
    surface = extract_surface(make_volume(np.ones((1, 1, 1), int), spacing=0.002))
    assert surface.mesh.volume == pytest.approx(0.002**3, rel=1e-9)
    assert np.linalg.norm(surface.mesh.vertex_normals, axis=1).min() > 0.99


ON_ANOTHER = """
import sys
import numpy as np
import mjframes as mf
from mjframes.surface.contact_points import contact_points
from mjframes.surface.isosurface import extract_surface
volume = mf.Volume.load(sys.argv[1])
surface = extract_surface(volume)
points = contact_points(surface, float(np.min(volume.spacing)), volume.axes)
np.save(sys.argv[2], np.concatenate([surface.vertices, surface.vertex_normals, points.positions, points.normals]))
"""


@pytest.mark.slow
def test_contact_points_do_not_depend_on_the_processor(tmp_path: Path) -> None:
    steak = Path(__file__).parents[2] / "models" / "steak.npz"
    vectors = np.show_config(mode="dicts")["SIMD Extensions"].get("found", [])
    if not vectors:
        pytest.skip("NumPy has one way to add here")
    found = []
    for k in range(len(vectors) + 1):  # without the last ones
        path = tmp_path / f"{k}.npy"
        environment = {**os.environ, "NPY_DISABLE_CPU_FEATURES": " ".join(vectors[k:])}
        subprocess.run([sys.executable, "-c", ON_ANOTHER, str(steak), str(path)], env=environment, check=True)
        found.append(np.load(path))
    for other in found[1:]:
        np.testing.assert_array_equal(other, found[0])
