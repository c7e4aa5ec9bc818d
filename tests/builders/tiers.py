"""Grids of cases, of which `make test` runs a few and `make test-all` all."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def thinned(cases: Iterable[tuple[Any, ...]], step: int) -> list[Any]:
    """Each case for `parametrize`, slow but for every `step`-th from the first on.

    Of a product of axes every value stays where `step` has no factor in common with their lengths.
    """
    return [pytest.param(*case, marks=[pytest.mark.slow] if n % step else []) for n, case in enumerate(cases)]
