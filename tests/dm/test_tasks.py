"""The tasks: names and tags, what they observe and reward, random episodes, and a policy that lifts the steak."""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest

pytest.importorskip("dm_control")

import mujoco
import numpy as np

from benchmarks.speed.tasks import tried
from mjframes import dm
from mjframes.base.errors import MjframesError
from mjframes.dm import lifting

pytestmark = pytest.mark.dm_control


def test_tasks_have_names_and_tags() -> None:
    assert dm.ALL == ("lift_steak_features", "lift_steak_vision", "run_rat_features", "run_bare_rat_features")
    assert dm.TAGS == ("features", "vision")
    assert dm.get_environments_by_tag("vision") == ("lift_steak_vision",)
    with pytest.raises(MjframesError, match="'lift_steak_features', 'lift_steak_vision'"):
        dm.load("lift_steak")
    with pytest.raises(MjframesError, match="'features', 'vision'"):
        dm.get_environments_by_tag("easy")


def test_the_steak_is_the_models() -> None:
    from mjframes.dm import lift

    models = Path(__file__).parents[2] / "models"
    assert Path(lift.__file__).with_name("steak.npz").read_bytes() == (models / "steak.npz").read_bytes()


@pytest.mark.slow
def test_observations_of_the_task_are_gymnasiums() -> None:
    pytest.importorskip("gymnasium")
    from mjframes.envs import LiftSteak

    environment, world = dm.load("lift_steak_features", 0), LiftSteak()
    step = environment.reset()
    world.reset(seed=0)
    world.data.qpos[:] = environment.physics.data.qpos
    world.model.numeric_data[:] = environment.physics.model.ptr.numeric_data
    mujoco.mj_forward(world.model, world.data)
    random = np.random.default_rng(0)
    for _ in range(5):
        action = random.uniform(-1, 1, 9)
        observed, reward, *_ = world.step(action)
        step = environment.step(action * world.model.actuator_ctrlrange[:, 1])
        flat = np.concatenate([np.ravel(value) for value in step.observation.values()])
        assert list(step.observation) == list(lifting.FEATURES)
        np.testing.assert_array_equal(np.clip(flat, -100, 100), observed)
        assert step.reward == reward


def test_pictures_show_the_steak() -> None:
    observation = dm.load("lift_steak_vision", 0).reset().observation
    assert list(observation) == [*lifting.PROPRIOCEPTION, "camera"]
    picture = observation["camera"].astype(int)
    assert picture.shape == (84, 84, 3)
    red = (picture[..., 0] > 2 * picture[..., 1]) & (picture[..., 0] > 2 * picture[..., 2])
    assert red.sum() > 50


@pytest.mark.parametrize(("task", "steps"), [("lift_steak_features", 25), ("run_bare_rat_features", 25)])
def test_random_episodes_neither_warn_nor_fail(task: str, steps: int) -> None:
    found = tried(task, episodes=3, seed=1, most_steps=steps)
    assert (found.steps, found.warnings, found.infinite, found.failed) == (3 * steps, {}, 0, 0)


@pytest.mark.parametrize("task", [pytest.param("lift_steak_features", marks=pytest.mark.slow), "run_bare_rat_features"])
def test_the_seed_decides_how_an_episode_starts(task: str) -> None:
    starts = []
    for seed in (5, 5, 6):
        environment = dm.load(task, seed)
        for _ in range(2):
            environment.reset()
            starts.append(environment.physics.data.qpos.copy())
    np.testing.assert_array_equal(starts[:2], starts[2:4])
    assert not any(np.array_equal(one, other) for one, other in itertools.combinations((*starts[:2], *starts[4:]), 2))


def test_an_episode_ends_after_ten_seconds_and_rewards_the_height() -> None:
    environment = dm.load("lift_steak_features", 2)
    environment.reset()
    physics, task = environment.physics, environment.task
    task.steak.set_pose(physics, (0, 0, 2 * lifting.BLOCK[2] + lifting.THICKNESS + 0.09), (1, 0, 0, 0))
    physics.forward()
    assert task.get_reward(physics) == pytest.approx(0.6, abs=0.01)
    physics.data.time = 9.97
    step = environment.step(np.zeros(9))
    assert step.last()
    assert step.discount == 1
