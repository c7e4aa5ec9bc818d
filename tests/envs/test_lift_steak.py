"""The steak in Gymnasium: its checker is content, and many worlds are to the bit what each of them is alone."""

from __future__ import annotations

from typing import Any, cast

import pytest

pytest.importorskip("gymnasium")
pytest.importorskip("dm_control")

import gymnasium
import numpy as np
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

from examples import lift
from mjframes.base.errors import MjframesError
from mjframes.envs import LiftSteak, LiftSteakVector

pytestmark = pytest.mark.dm_control
NAME, TOUCH = "mjframes.envs:LiftSteak-v0", "mjframes.envs:LiftSteakTouch-v0"
STEPS, LIMIT = 12, 8  # with an end and a new start on the way


def many(mode: str, **kwargs: Any) -> gymnasium.vector.VectorEnv:
    return gymnasium.make_vec(NAME, num_envs=3, vectorization_mode=mode, max_episode_steps=LIMIT, **kwargs)


def transitions(worlds: gymnasium.vector.VectorEnv, seed: Any) -> list[np.ndarray]:
    found = [worlds.reset(seed=seed)[0]]
    random = np.random.default_rng(0)
    for _ in range(STEPS):
        found += worlds.step(random.uniform(-1, 1, worlds.action_space.shape))[:4]
    return [np.array(each) for each in found]


@pytest.mark.filterwarnings("error")
def test_gymnasiums_checker_is_content() -> None:
    check_env(gymnasium.make(NAME).unwrapped)


def test_many_worlds_are_each_alone_to_the_bit() -> None:
    alone = transitions(many("sync"), seed=5)
    for threads in (1, 2):
        together = many("vector_entry_point", threads=threads)
        for found, expected in zip(transitions(together, seed=5), alone, strict=True):
            np.testing.assert_array_equal(found, expected)
    ends = [found for found in alone if found.dtype == bool]
    assert sum(end.sum() for end in ends) == 3  # truncated once each
    assert any(np.ptp(found, axis=0).any() for found in alone)


@pytest.mark.filterwarnings("error")
def test_touch_is_observed_alike_alone_and_among_others() -> None:
    check_env(gymnasium.make(TOUCH).unwrapped)
    sizes = [np.prod(gymnasium.make(name).observation_space.shape or (0,)) for name in (NAME, TOUCH)]
    assert sizes[1] - sizes[0] == 2 * 8 * 12
    alone, together = (
        transitions(gymnasium.make_vec(TOUCH, num_envs=2, vectorization_mode=mode), seed=3)
        for mode in ("sync", "vector_entry_point")
    )
    for found, expected in zip(together, alone, strict=True):
        np.testing.assert_array_equal(found, expected)


def test_a_hand_that_closes_is_felt_above_and_below() -> None:
    """The policy of the example, until the fingers have closed."""
    task = LiftSteak(touch=True)
    observed, _ = task.reset(seed=0)
    assert not observed[-192:].any()
    at, limit = task._at, task.model.actuator_ctrlrange[:, 1]
    target = lift.grip(at, task.data)
    for _ in range(95):
        observed, *_ = task.step(lift.action(task.model, task.data, at.pinch, target) / limit)
    above, below = observed[-192:].reshape(2, 8, 12)
    assert above.max() > 1 < below.max()  # [kPa]
    pressed = 1e3 * 0.007**2 * np.array([above.sum(), below.sum()])
    assert 8 < pressed.min() < pressed.max() < 20  # [N]: the hand turns by then, so they are not the same


def test_an_ended_world_starts_again_in_the_next_step() -> None:
    worlds = many("vector_entry_point")
    assert worlds.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    found = transitions(worlds, seed=[1, 2, 3])
    truncated, observed, rewards = found[4::4], found[1::4], found[2::4]
    assert [end.all() for end in truncated] == [step == LIMIT - 1 for step in range(STEPS)]
    assert not rewards[LIMIT].any()
    hand = slice(24, 27)  # fingers
    np.testing.assert_allclose(observed[LIMIT][:, hand], 0.15)
    assert (observed[LIMIT] != found[0]).any()  # another episode of the same seed


def test_a_seed_says_what_a_world_does() -> None:
    worlds = LiftSteakVector(2, threads=1)
    first, again, other = (worlds.reset(seed=seed)[0] for seed in (7, [7, 8], 9))
    np.testing.assert_array_equal(first, again)
    assert (first != other).any(axis=1).all()
    zeros = [worlds.reset(seed=cast(Any, seed))[0] for seed in (0, np.int64(0), np.array([0, 1]))]
    np.testing.assert_array_equal(zeros[1:], zeros[:1] * 2)
    factors = worlds.batch.expand("numeric_data")[:, 0]
    assert len(np.unique(factors)) == 2
    assert ((factors > 0.5) & (factors < 2)).all()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [({"num_envs": 0}, "num_envs"), ({"threads": -1}, "threads"), ({"render_mode": "human"}, "render_mode")],
)
def test_bad_arguments_are_named(arguments: dict[str, object], words: str) -> None:
    with pytest.raises(MjframesError, match=words):
        LiftSteakVector(**arguments)  # type: ignore[arg-type]


@pytest.mark.parametrize("seed", [0.5, "two", [1, 2, 3], [1, None, "x"], True])
def test_bad_seeds_are_named(seed: object) -> None:
    with pytest.raises(MjframesError, match=r"^seed"):
        LiftSteakVector(2, threads=1).reset(seed=seed)  # type: ignore[arg-type]


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_actions_that_are_not_finite_are_refused_and_change_nothing(bad: float) -> None:
    alone, together = LiftSteak(), LiftSteakVector(2, threads=1)
    alone.reset(seed=0)
    together.reset(seed=0)
    state = alone.data.qpos.copy()
    actions = np.zeros(together.action_space.shape or ())
    actions[1, 2] = bad
    words = rf"is \[0\.0, 0\.0, {bad}, .*\]; it must be of finite numbers, from -1 to 1\.$"
    with pytest.raises(MjframesError, match=f"^action {words}"):
        alone.step(actions[1])
    with pytest.raises(MjframesError, match=f"^action of world 1 {words}"):
        together.step(actions)
    np.testing.assert_array_equal(alone.data.qpos, state)
    np.testing.assert_array_equal(together.batch.qpos[0], state)
    together._ended[1] = True  # it starts again and ignores its action
    assert np.isfinite(together.step(actions)[0]).all()


def test_one_world_is_drawn_or_not() -> None:
    with pytest.raises(MjframesError, match="render_mode"):
        LiftSteak(render_mode="human")
