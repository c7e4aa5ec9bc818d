"""A finger that a chamber of air bends: tips beside finite elements."""

from __future__ import annotations

import numpy as np
import pytest

from examples import finger


@pytest.mark.parametrize(
    ("frames", "errors"),
    [(5, (-0.02, 0.06, 0.28)), pytest.param(10, (-0.02, 0.01, 0.05), marks=pytest.mark.slow)],
)
def test_the_tip_is_where_finite_elements_have_it(frames: int, errors: tuple[float, ...]) -> None:
    """At 0.1, 5 and 10 kPa, a twentieth of Young's modulus: as walls widen, air bends it nearly twice as far."""
    exact = finger.reference()
    found, data = finger.tips(*finger.finger(frames), list(exact))
    error = found[:, 2] / np.array(list(exact.values())) - 1
    np.testing.assert_allclose(error, errors, atol=0.02)
    assert not data.warning.number.any()
