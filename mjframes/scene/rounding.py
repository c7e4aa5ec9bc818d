"""Weights in whole units: Σ_j u_ij = u_i for Σ_j W_ij = 1, |u_ij − u_i W_ij| ≤ 1."""

from __future__ import annotations

import numpy as np
from scipy import sparse


def in_units(weights: sparse.csr_array, units: int | np.ndarray) -> sparse.csr_array:
    """Return rows (n, k) that sum to 1 as whole numbers that sum to `units`, of all rows or each (n,).

    They are differences of a row's rounded running sum. Entries that become 0 stay.
    """
    first, last = weights.indptr[:-1], weights.indptr[1:] - 1
    running = np.cumsum(weights.data)
    running -= np.repeat((running - weights.data)[first], np.diff(weights.indptr))
    running[last] = 1
    whole = np.round(running * np.repeat(np.broadcast_to(units, len(first)), np.diff(weights.indptr)))
    whole[1:] -= np.where(np.isin(np.arange(1, len(whole)), first), 0, whole[:-1])
    return sparse.csr_array((whole.astype(np.int64), weights.indices, weights.indptr), weights.shape)
