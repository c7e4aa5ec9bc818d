"""What a dataclass holds, field by field."""

from __future__ import annotations

from dataclasses import fields, is_dataclass

import numpy as np
from scipy import sparse


def leaves(value: object) -> list[np.ndarray]:
    """All arrays and numbers of nested dataclasses and tuples, in order."""
    if is_dataclass(value):
        return [leaf for field in fields(value) for leaf in leaves(getattr(value, field.name))]
    if isinstance(value, (tuple, list)):
        return [leaf for part in value for leaf in leaves(part)]
    if isinstance(value, dict):
        return [leaf for pair in value.items() for leaf in leaves(pair)]
    if isinstance(value, sparse.csr_array):
        return [value.toarray()]
    return [np.asarray(value)]
