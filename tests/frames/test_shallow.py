"""Frames of bodies whose held piece is near everywhere: how they are placed, weighed and how right such bodies are."""

from __future__ import annotations

import numpy as np
import pytest

import mjframes as mf
from mjframes.frames.placement import place_frames
from mjframes.frames.shallow import shallow_frames
from mjframes.volume.grid import Grid, voxel_grid, without
from mjframes.weights.kernels import Harmonic, Voronoi, Weights
from mjframes.weights.shallow import shallow_weights

SIZE = 0.005
FLESH, BONE = mf.Material(1e5, 0.45, 1000), mf.Material(1e9, 0.3, 1500, is_rigid=True)


def volume_of(labels: np.ndarray) -> mf.Volume:
    return mf.Volume.from_labels(labels.astype(np.uint8), SIZE, {1: FLESH, 2: BONE})


def pad() -> tuple[mf.Volume, np.ndarray]:
    """Wide and low, glued at its base."""
    volume = volume_of(np.ones((16, 16, 4)))
    return volume, volume.side("-z")


def sleeve() -> tuple[mf.Volume, np.ndarray]:
    """Flesh around a bone that is held."""
    y, z = np.indices((12, 12)) - 5.5
    radius = np.broadcast_to(np.hypot(y, z), (30, 12, 12))
    volume = volume_of(np.where(radius < 2.5, 2, 1) * (radius < 6))
    return volume, volume.labels == 2


def core_of(volume: mf.Volume, mask: np.ndarray) -> tuple[Grid, np.ndarray]:
    grid = voxel_grid(volume)
    return grid, np.flatnonzero(mask[tuple(grid.index.T)])


def test_a_grid_without_some_voxels_is_that_of_the_volume_without_them() -> None:
    volume, mask = sleeve()
    grid, core = core_of(volume, mask)
    rest, number = without(grid, core)
    alone = voxel_grid(volume_of(np.where(mask, 0, volume.labels)))
    np.testing.assert_array_equal(rest.index, alone.index)
    np.testing.assert_array_equal(rest.padded, alone.padded)
    np.testing.assert_array_equal(rest.piece, alone.piece)
    np.testing.assert_array_equal(grid.index[number], rest.index)


def test_pieces_that_stay_are_numbered_anew() -> None:
    labels = np.array([2, 1, 2, 1, 2]).reshape(-1, 1, 1)
    rest, _ = without(voxel_grid(volume_of(labels)), np.array([0]))
    assert rest.piece.tolist() == [-1, 0, -1, 1]


@pytest.mark.parametrize("count", [1, 5, 20])
def test_frames_of_a_pad_are_all_over_it(count: int) -> None:
    grid, core = core_of(*pad())
    found = shallow_frames(grid, count, None, 0, core)
    assert found is not None
    assert len(found.placement.seeds) == count + 1
    np.testing.assert_array_equal(found.placement.seeds[0], core)
    np.testing.assert_allclose(
        found.placement.centers[1:, :2].mean(axis=0), grid.centers[:, :2].mean(axis=0), atol=SIZE
    )
    as_others = place_frames(grid, count, cores=[core]).centers[1:, :2].mean(axis=0)
    if count < 10:  # they crowd in a corner
        assert np.linalg.norm(as_others - grid.centers[:, :2].mean(axis=0)) > 4 * SIZE


def test_only_shallow_bodies_are() -> None:
    volume = volume_of(np.ones((24, 4, 4)))
    grid, core = core_of(volume, volume.side("-x"))
    assert shallow_frames(grid, 3, None, 0, core) is None
    assert shallow_frames(grid, 0, None, 0, core) is None
    assert shallow_frames(grid, 3, None, 0, np.arange(len(grid.index))) is None


@pytest.mark.parametrize("kind", [Voronoi(), Voronoi(3), Harmonic()])
@pytest.mark.parametrize("body", [pad, sleeve])
def test_weights_of_shallow_bodies(body, kind: Weights) -> None:
    grid, core = core_of(*body())
    placed = shallow_frames(grid, 6, None, 0, core)
    assert placed is not None
    weights = shallow_weights(kind, grid, placed)
    assert weights.has_sorted_indices
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-12)
    assert weights.data.min() > 0
    for i, seed in enumerate(placed.placement.seeds):
        np.testing.assert_allclose(weights[seed][:, [i]].toarray(), 1, atol=1e-12)
    assert weights[:, 1:].sum() > 0.5 * (len(grid.index) - len(core))  # the held piece has the least of the flesh


def test_a_frame_reaches_as_far_sideways_as_to_the_next_one() -> None:
    volume, mask = pad()
    grid, core = core_of(volume, mask)
    placed = shallow_frames(grid, 1, None, 0, core)
    assert placed is not None
    top = grid.index[:, 2] == 3
    np.testing.assert_allclose(shallow_weights(Voronoi(), grid, placed)[top][:, [1]].toarray(), 1, atol=1e-12)


@pytest.mark.parametrize("body", [pad, sleeve])
@pytest.mark.parametrize("count", [1, 3, 8])
def test_shallow_bodies_carry_their_weight_as_finite_elements_do(body, count: int) -> None:
    """A held piece that is a frame among others leaves 60 to 97 % of it out."""
    volume, mask = body()
    error = mf.build(volume, count, supports=mf.Fixed(mask)).error
    assert error is not None
    assert error.weight is not None
    assert error.weight < 0.2


def test_frames_placed_by_hand_and_the_papers_method() -> None:
    volume, mask = pad()
    middle = volume.origin + SIZE * np.array([8, 8, 2])
    by_hand = mf.build(volume, at=[middle], supports=mf.Fixed(mask))
    assert by_hand.error is not None
    assert by_hand.error.weight is not None
    assert by_hand.error.weight < 0.05
    papers = mf.build(volume, 1, supports=mf.Fixed(mask), method="paper")
    top = voxel_grid(volume).index[:, 2] == 3
    assert papers.fields.weights[top][:, [1]].toarray().min() == 0  # the paper's reach no farther than the base is


def test_flesh_apart_from_all_frames_is_held() -> None:
    """A piece in the middle that is held leaves two halves, of which one has a frame."""
    labels = np.ones((13, 12, 12))
    volume = volume_of(labels)
    mask = np.zeros(labels.shape, bool)
    mask[6] = True
    made = mf.build(volume, 1, supports=mf.Fixed(mask))
    assert np.isfinite(made.fields.weights.data).all()
    np.testing.assert_allclose(made.fields.weights.sum(axis=1), 1, atol=1e-9)
