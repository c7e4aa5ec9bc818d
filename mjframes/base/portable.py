"""Functions of C, value by value: they have the same digits on every processor.

NumPy's own differ in the last digit where a processor has AVX-512. Of vertices that are equally far, another one then
touches.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray


def each(function: Callable[[float], float], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the function, one of `math`, of each of the values (n,)."""
    return np.array([function(value) for value in values.tolist()])
