"""Monomials y₁^a y₂^b y₃^c in three dimensions, those of low degree first."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def exponents(degree: int) -> NDArray[np.int64]:
    """Return the powers (p, 3) of all monomials of degree ≤ `degree`, ascending: 1, 4, 10, 20, 35 of them."""
    return np.array(sorted((e for e in product(range(degree + 1), repeat=3) if sum(e) <= degree), key=sum))


def monomials(y: Array, powers: NDArray[np.int64]) -> Array:
    """Return (p, q) the values at points y (q, 3)."""
    table = np.stack([y**n for n in range(int(powers.max()) + 1)])
    return table[powers[:, 0], :, 0] * table[powers[:, 1], :, 1] * table[powers[:, 2], :, 2]
