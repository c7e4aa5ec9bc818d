"""Many worlds of one soft body: each is the single run of its own stiffness, and what is measured of them is there."""

from __future__ import annotations

from functools import cache

import mujoco
import numpy as np
import pytest
from builders.scenes import FLOOR, beam, compiled

from benchmarks.speed import worlds
from benchmarks.speed.step_scenes import BARE, OURS


@cache
def scene() -> tuple[mujoco.MjModel, np.ndarray]:
    """A beam that lies on the floor."""
    model, _ = compiled(FLOOR, (beam(beta=0.001), (0, 0, 0.005), (1, 0, 0, 0)))
    return model, worlds.lying(model)


@pytest.mark.parametrize("threads", [1, 2])
def test_each_world_is_the_single_run_of_its_stiffness(threads: int) -> None:
    model, start = scene()
    assert worlds.differences(model, start, 64, threads, 20) == 0


class _Reversed(worlds.Batch):
    """Of which each world gets the stiffness of another."""

    def expand(self, name: str) -> np.ndarray:
        return super().expand(name)[::-1]


def test_worlds_of_another_stiffness_differ(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(worlds, "Batch", _Reversed)
    assert worlds.differences(*scene(), 64, 1, 20) == 64


@pytest.mark.slow
def test_memory_beyond_mujocos_own_is_bounded() -> None:
    model, _ = scene()
    rigid = mujoco.MjModel.from_xml_string(FLOOR)
    found = worlds.measure_memory({OURS: model, BARE: rigid})
    assert set(found) == {(name, way) for name in (OURS, BARE) for way in ("mjData", "world of a batch")}
    assert found[OURS, "world of a batch"] - found[BARE, "world of a batch"] < 30_000
    assert found[OURS, "mjData"] > 0
