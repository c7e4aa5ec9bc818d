"""Grids of cases, of which `make test` runs a few and `make test-all` all."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import pytest


def tiered(cases: Iterable[Any], is_slow: Callable[[Any], bool]) -> list[Any]:
    """Each case for `parametrize`, a tuple of several arguments, slow where that is said."""
    return [
        pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=[pytest.mark.slow] if is_slow(case) else [])
        for case in cases
    ]


def thinned(cases: Iterable[tuple[Any, ...]], step: int) -> list[Any]:
    """Each case for `parametrize`, slow but for every `step`-th from the first on.

    Of a product of axes every value stays where `step` has no factor in common with their lengths.
    """
    return [pytest.param(*case, marks=[pytest.mark.slow] if n % step else []) for n, case in enumerate(cases)]
