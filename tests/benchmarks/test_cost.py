"""Elasticity's share of a step of the steak, 3 frames, in contact with a box and the floor.

Compared is the same step without elasticity's part, so that both have the same contacts, found in the same skin.
"""

from __future__ import annotations

import pytest

from benchmarks.solids.cases import STEAK
from benchmarks.speed import bench
from mjframes.volume.volume import Volume


@pytest.mark.parametrize(("law", "bound"), [("corotational", 2), ("neo_hookean", 4)])
@pytest.mark.slow
def test_elasticity_is_cheap_beside_contacts(law: str, bound: float) -> None:
    cost = bench.measure_cost(Volume.load(STEAK), bench.Size(3), law, rounds=5)
    if law != "corotational":
        assert cost.points >= 1
    assert 1 < cost.over_no_elasticity < bound
