"""The error in far bends: whose it is, and whose not."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import mjframes as mf
from mjframes.body.adaptive import KEPT


def bends(size: tuple[float, float, float], spacing: float, frames: int, scale: float = 1, **choices) -> float:
    """Of a body that is held at its end, `scale` times as large and as stiff."""
    material = mf.Material(1e5 * scale, 0.3, 1000)
    volume = mf.Volume.box(tuple(scale * some for some in size), material, spacing=scale * spacing)
    body = mf.build(volume, frames, supports=[mf.Fixed(volume.side("-x", scale * spacing))], **choices)
    assert body.error is not None
    assert body.error.bends is not None
    return body.error.bends


FLAP = (0.2, 0.08, 0.01), 0.005
BLOCK = (0.06, 0.06, 0.06), 0.01


def test_it_is_large_for_thin_bodies_of_few_frames() -> None:
    few, more = bends(*FLAP, 1), bends(*FLAP, 8)
    assert few > 0.4
    assert more < 0.1
    assert bends(*BLOCK, 1) < 0.01


def test_it_does_not_depend_on_units() -> None:
    assert bends(*FLAP, 2, scale=3) == pytest.approx(bends(*FLAP, 2), rel=1e-3)


@pytest.mark.parametrize("choices", [{"law": "neo_hookean"}, {"frame_type": "rigid"}], ids=["law", "rigid"])
def test_what_knows_turns_has_none(choices: dict[str, Any]) -> None:
    assert bends(*FLAP, 1, **choices) < 0.01


def test_a_free_body_has_it_too() -> None:
    volume = mf.Volume.box(FLAP[0], mf.Material(1e5, 0.3, 1000), spacing=FLAP[1])
    errors = [mf.build(volume, frames).error for frames in (2, 10)]
    few, many = (some.bends for some in errors if some is not None and some.bends is not None)
    assert few > KEPT > many


def test_a_body_of_an_earlier_version_does_not_know_it(tmp_path) -> None:
    volume = mf.Volume.box(BLOCK[0], mf.Material(1e5, 0.3, 1000), spacing=BLOCK[1])
    body = mf.build(volume, 1)
    body.save(tmp_path / "now.npz")
    arrays = dict(np.load(tmp_path / "now.npz"))
    del arrays["error.bends"]
    np.savez(tmp_path / "then.npz", **arrays)
    old = mf.SoftBody.load(tmp_path / "then.npz").error
    assert old is not None
    assert old.bends is None
    assert "far bends" not in str(old)
