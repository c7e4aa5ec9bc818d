"""Random episodes of a bar that a chamber, a cable and a muscle move at once: nothing warns, all stays finite."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from builders.hollow import CENTRE, LOW, SHAPE, actuated, hollow_body

import mjframes as mf

MOST = np.array([5e3, -0.5, -1e4])  # [Pa] of air, minus [N] of the cable, minus [Pa] of the muscle


def below() -> np.ndarray:
    mask = np.zeros(SHAPE, bool)
    mask[:, :, :2] = True
    return mask


@pytest.mark.parametrize(
    ("frames", "episodes"),
    [(3, 1), pytest.param(5, 10, marks=pytest.mark.slow), pytest.param(10, 10, marks=pytest.mark.slow)],
)
def test_random_episodes_end_without_a_warning(frames: int, episodes: int) -> None:
    """Each ends with a second of rest, when little moves."""
    tendons = {"air": mf.Chamber(CENTRE), "cable": mf.Fibre(LOW), "muscle": mf.Muscle(below(), (1, 0.2, 0))}
    model = actuated(hollow_body(frames), tendons).compile()
    data = mujoco.MjData(model)
    for seed in range(episodes):
        rng = np.random.default_rng(seed)
        mujoco.mj_resetData(model, data)
        moved = 0.0
        for _ in range(20):
            data.ctrl[:] = MOST * rng.uniform(size=3) * rng.integers(0, 2, size=3)
            mujoco.mj_step(model, data, nstep=50)
            moved = max(moved, float(np.abs(data.qpos).max()))
            assert np.isfinite(data.qpos).all()
        assert moved > 1e-3
        data.ctrl[:] = 0
        mujoco.mj_step(model, data, nstep=1000)
        assert np.abs(data.qvel).max() < 0.05
        assert not data.warning.number.any()
