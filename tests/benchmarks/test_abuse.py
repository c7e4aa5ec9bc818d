"""Random edits of scenes do no harm, and what would is told."""

from __future__ import annotations

import os
from collections.abc import Iterator

import mujoco
import numpy as np
import pytest

from benchmarks.stability import abuse
from benchmarks.stability.apart import Report
from benchmarks.stability.edits import EDITS, World


@pytest.fixture
def heard() -> Iterator[None]:
    yield
    mujoco.set_mju_user_warning(None)


@pytest.mark.slow
def test_random_edits_do_no_harm() -> None:
    report = abuse.abused(150, seed=0)
    assert report.failures == ()
    assert report.done > 100


def die(seed: int) -> Report:
    os._exit(seed + 1)


@pytest.mark.slow
def test_a_process_that_dies_is_told(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(abuse, "program", die)
    assert abuse.main(["30", "--seed", "7"]) == 1
    output = capsys.readouterr().out
    assert output.startswith("50 edits of scenes with the seeds 7 to 8: 2 failures.\n")
    assert "- seed 8: the process died.\n" in output


def lose(world: World, rng: np.random.Generator) -> None:
    del rng
    world.data.qpos[:] = np.nan


@pytest.mark.usefixtures("heard")
@pytest.mark.parametrize(("edit", "words"), [(lose, "not finite, without a warning"), (die, "TypeError")])
def test_what_an_edit_breaks_is_told(monkeypatch: pytest.MonkeyPatch, edit: object, words: str) -> None:
    for name in EDITS:
        monkeypatch.setitem(EDITS, name, edit)
    (failure,) = abuse.program(3).failures
    assert failure.startswith("seed 3: ")
    assert words in failure


@pytest.mark.usefixtures("heard")
def test_a_program_is_the_same_each_time() -> None:
    assert abuse.program(5) == abuse.program(5)


def test_some_scenes_have_flexes_of_each_kind() -> None:
    models = [abuse.scene(np.random.default_rng(seed)).compile() for seed in range(20)]
    assert {tuple(model.flex_dim) for model in models} == {(), (1,), (2,), (3,)}


@pytest.mark.slow
@pytest.mark.usefixtures("heard")
@pytest.mark.parametrize("edit", ["render", "cloth"])
def test_pictures_and_flexes_are_among_the_edits(monkeypatch: pytest.MonkeyPatch, edit: str) -> None:
    chosen = {"step": EDITS["step"], edit: EDITS[edit]}
    monkeypatch.setattr(abuse, "EDITS", chosen)
    report = abuse.program(11)
    assert report.done == abuse.LENGTH
    assert report.failures == ()
