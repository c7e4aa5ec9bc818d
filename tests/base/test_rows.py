from __future__ import annotations

import numpy as np
from scipy import sparse

from mjframes.base.rows import distinct_rows


def test_rows_are_numbered_in_the_order_of_appearance() -> None:
    dense = np.random.default_rng(0).random((5000, 4)) < 0.5
    rows = sparse.csr_array(dense)
    label, first = distinct_rows(rows.indptr, rows.indices)
    assert len(first) == 16
    assert np.array_equal(label[first], np.arange(16))
    assert np.all(np.diff(first) > 0)
    assert np.array_equal(dense[first][label], dense)


def test_nothing_has_no_rows() -> None:
    label, first = distinct_rows(np.zeros(1, np.int64), np.zeros(0, np.int32))
    assert not len(label)
    assert not len(first)
