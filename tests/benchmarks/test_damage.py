"""Damaged bodies and logs end in a sentence, and what ends otherwise is told."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence

import numpy as np
import pytest

from benchmarks.stability import damage
from benchmarks.stability.apart import Report

pytest.importorskip("mcap")


@pytest.mark.parametrize(("program", "seeds"), [(damage.of_body, range(8)), (damage.of_log, (3, 8, 12, 17, 21, 27))])
def test_damaged_files_end_in_a_sentence(program: Callable[[int], Report], seeds: Sequence[int]) -> None:
    total = sum(map(program, seeds), Report())
    assert total.failures == ()
    assert total.done == len(seeds)
    assert total.said["taken"] < sum(total.said.values())


def test_files_are_those_of_their_seeds() -> None:
    good = damage._body(0)
    same = [damage.damaged_body(np.random.default_rng(seed), good) for seed in (1, 1, 2)]
    assert same[0] == same[1] != same[2]


def end(words: list[str]) -> int:
    raise KeyError(words[0])


def complain(words: list[str]) -> int:
    print("Traceback", words[0], file=sys.stderr)
    return 2


@pytest.mark.parametrize(
    ("command", "told"), [(end, "raises KeyError"), (complain, "Traceback"), (lambda _: 1, "ends with 1")]
)
def test_what_is_no_sentence_is_told(monkeypatch: pytest.MonkeyPatch, command: object, told: str) -> None:
    monkeypatch.setattr(damage, "command", command)
    (failure,) = damage.of_log(4).failures
    assert failure.startswith("log 4: replay ")
    assert told in failure
