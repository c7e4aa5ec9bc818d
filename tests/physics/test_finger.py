"""A finger that a chamber of air bends: tips beside finite elements."""

from __future__ import annotations

import numpy as np
import pytest

from examples import finger


@pytest.mark.parametrize(("frames", "bounds"), [(5, (0.03, 0.07, 0.3)), (10, (0.03, 0.02, 0.07))])
def test_the_tip_is_where_finite_elements_have_it(frames: int, bounds: tuple[float, ...]) -> None:
    """At 0.1, 5 and 10 kPa, a twentieth of Young's modulus: as walls widen, air bends it nearly twice as far."""
    exact = finger.reference()
    found, data = finger.tips(*finger.finger(frames), list(exact))
    error = found[:, 2] / np.array(list(exact.values())) - 1
    assert (np.abs(error) < bounds).all()
    assert not data.warning.number.any()
