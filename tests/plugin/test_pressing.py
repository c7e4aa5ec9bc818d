"""What presses where: never a pull, always the whole load, and the gap is closed where something bears."""

from __future__ import annotations

import ctypes
from pathlib import Path

import mujoco
import numpy as np
import pytest
from builders.harness import harness, pointer
from numpy.typing import NDArray

LOAD = 2.0  # [N]

Array = NDArray[np.float64]


def press(C: Array, gap: Array) -> Array:
    for library in Path(mujoco.__file__).parent.glob("libmujoco.so*"):
        ctypes.CDLL(str(library), mode=ctypes.RTLD_GLOBAL)  # what multiplies
    force = np.full(len(gap), np.nan)
    harness("pressing").press(pointer(C), pointer(gap), len(gap), ctypes.c_double(LOAD), pointer(force))
    return force


def surface(rng: np.random.Generator, tilts: bool) -> tuple[Array, Array]:
    """Places of an elastic plane, and how far a shape is from them; tilts: one that is held to its moment, too."""
    place = rng.uniform(-1, 1, (rng.integers(1, 40), 2))
    C = 1 / (np.linalg.norm(place[:, None] - place, axis=2) + 0.2)
    C += 30 * tilts * place @ place.T
    return C, rng.uniform(0, 3) * ((place - rng.uniform(-1, 1, 2)) ** 2).sum(axis=1) + rng.normal(size=len(place)) / 10


@pytest.mark.parametrize("tilts", [False, True])
def test_no_place_pulls_and_all_bear_the_load(tilts: bool) -> None:
    rng = np.random.default_rng(0)
    for _ in range(3000):
        force = press(*surface(rng, tilts))
        assert (force >= 0).all()
        assert force.sum() == pytest.approx(LOAD, rel=1e-12)


def test_where_something_bears_the_gap_is_closed() -> None:
    rng, off = np.random.default_rng(1), []
    for _ in range(3000):
        C, gap = surface(rng, False)
        force = press(C, gap)
        residual = C @ force + gap
        approach = residual[force > 0].mean()
        closed, opened = residual[force > 0] - approach, np.minimum(residual - approach, 0)
        off.append(max(abs(closed).max(), abs(opened).max()))
    assert np.max(off) < 1e-3  # [m], of gaps of a metre
