"""The number of frames that is taken where none is given."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mjframes as mf
from mjframes.base.errors import MjframesError, Notice
from mjframes.body import build as stages
from mjframes.body.adaptive import COUNTS, KEPT, MOST, default_counts
from mjframes.whole_body.error import BodyError

FLESH = mf.Material(2e4, 0.45, 1000)


def block(*shape: int) -> mf.Volume:
    return mf.Volume.from_labels(np.ones(shape, int), 0.005, {1: FLESH})


def error_of(body: mf.SoftBody) -> float:
    assert body.error is not None
    return body.error.largest


@pytest.fixture
def tried(monkeypatch: pytest.MonkeyPatch, uncached: None) -> list[int]:
    """How many frames the bodies have that are condensed, and −1 for each solution of the finite elements."""
    found: list[int] = []
    whole_body, finite_elements = stages.whole_body, stages.finite_elements

    def condensed(*arguments):
        found.append(len(arguments[3]))
        return whole_body(*arguments)

    def solved(*arguments):
        found.append(-1)
        return finite_elements(*arguments)

    monkeypatch.setattr(stages, "whole_body", condensed)
    monkeypatch.setattr(stages, "finite_elements", solved)
    return found


def test_the_fewest_frames_that_keep_15_per_cent_are_the_default(tried: list[int]) -> None:
    volume = block(20, 10, 12)
    with pytest.warns(Notice, match=r"^frames are not given: \d+ are taken, .* error of at most 15%: 1\d\.\d% under p"):
        body = mf.build(volume)
    frames = len(body.types)
    assert frames > 3
    assert error_of(body) <= KEPT
    assert error_of(mf.build(volume, COUNTS[COUNTS.index(frames) - 1])) > KEPT
    assert error_of(mf.build(volume, frames)) == error_of(body)
    assert tried.count(-1) == 3  # once for each call of build
    assert len(tried) - 2 * 2 <= 4  # and three trials at most


def test_held_pieces_have_frames_of_their_own_beside_the_chosen_ones() -> None:
    volume = block(24, 6, 6)
    mask = np.zeros(volume.labels.shape, bool)
    mask[:2] = True
    with pytest.warns(Notice, match=r"frames are not given: 1 is taken"):
        body = mf.build(volume, supports=mf.Fixed(mask))
    assert (len(body.types), body.held) == (2, 1)


@pytest.mark.slow
def test_what_comes_nearest_is_taken_where_no_number_keeps_it() -> None:
    volume = mf.Volume.load(Path(__file__).parents[2] / "models" / "fingertip.npz")
    with pytest.warns(Notice, match=rf"^frames are not given: of up to {MOST}, \d+ come nearest to an error of 15%: 2"):
        body = mf.build(volume)
    assert KEPT < error_of(body) < error_of(mf.build(volume, 10))


def test_a_number_that_is_given_is_taken_without_a_word(recwarn: pytest.WarningsRecorder) -> None:
    assert len(mf.build(block(8, 4, 4), 2).types) == 2
    assert len(mf.build(block(8, 4, 4), frame_type=("rigid", "affine")).types) == 2
    assert len(mf.build(block(8, 4, 4), method="paper").types) == 3
    assert error_of(mf.build(block(8, 4, 4), error=0.3)) <= 0.3
    assert not [some for some in recwarn if issubclass(some.category, Notice)]


@pytest.mark.parametrize("frame_type", ["point", "rigid", "quadratic"])
def test_numbers_that_cannot_be_are_left_out(frame_type: str) -> None:
    with pytest.warns(Notice, match="frames are not given"):
        assert len(mf.build(block(6, 3, 3), frame_type=frame_type).types) >= 1 + (frame_type != "quadratic")
    with pytest.raises(MjframesError, match="has one voxel of the body across"):
        mf.build(block(6, 3, 1), frame_type="quadratic")


def test_a_body_of_one_voxel_has_one_frame() -> None:
    with pytest.warns(Notice, match="frames are not given: 1 is taken"):
        assert len(mf.build(block(1, 1, 1)).types) == 1
    assert default_counts(0) == [1]
    assert default_counts(10**6)[-1] == MOST


def test_a_rigid_body_has_one_frame_and_no_error(recwarn: pytest.WarningsRecorder) -> None:
    volume = mf.Volume.box(0.04, mf.Material.rigid(density=1000), 0.01)
    body = mf.build(volume)
    (notice,) = [str(some.message) for some in recwarn]
    assert notice.endswith("1 is taken, the fewest found with an error of at most 15%: none, as no push deforms it.")
    assert repr(body).endswith("; error: none, as no push deforms it>")
    assert error_of(body) == error_of(mf.build(volume, error=0.05)) == 0
    assert body.fields.error is not None
    assert not body.fields.error.any()


def test_a_large_error_carries_advice() -> None:
    assert "more frames" in str(BodyError(0.01, 0.31))
    assert "more frames" in str(BodyError(0.31, 0.01))
    assert "more frames" in str(BodyError(0.01, 0.01, 0.31))
    assert "more frames" not in str(BodyError(0.29, 0.3, 0.3))
