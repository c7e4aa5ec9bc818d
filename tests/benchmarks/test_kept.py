"""Solutions that are kept on disk are those of the present code: the cache itself looks at the package alone."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

import numpy as np
import pytest

from benchmarks.accuracy import vibration
from benchmarks.solids import exact, reference
from benchmarks.solids.bodies import beam
from benchmarks.solids.cases import bar
from benchmarks.solids.reference import Reference


class Asked(Exception):
    """Carries what a cache is asked for."""


def ask(stage: str, inputs: Iterable[object], compute: Callable[[], Mapping[str, np.ndarray]]) -> None:
    raise Asked(*inputs)


CASE = bar("cantilever", "cantilever", "weight", across=4)


@pytest.mark.parametrize(
    ("module", "solve"),
    [
        (exact, lambda: exact.exact_solution(beam(0.3))),
        (reference, lambda: reference.refined(CASE)),
        (vibration, lambda: vibration.exact_vibration(CASE, Reference(np.zeros((1, 3)), np.zeros((1, 3)), [], [], []))),
    ],
)
def test_an_edit_of_the_finite_elements_meets_no_older_solution(
    module: object, solve: Callable[[], object], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "cached", ask)
    with pytest.raises(Asked) as asked:
        solve()
    read = {
        path.name for given in asked.value.args if isinstance(given, tuple) for path in given if isinstance(path, Path)
    }
    assert read >= {"bricks.py", "cases.py", Path(str(getattr(module, "__file__", ""))).name}
