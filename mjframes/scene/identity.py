"""Which built body a model's soft body is: a model holds what a step needs, its `SoftBody` knows every voxel."""

from __future__ import annotations

import hashlib
from weakref import WeakValueDictionary

import numpy as np

from mjframes.body.soft_body import SoftBody

_known: WeakValueDictionary[str, SoftBody] = WeakValueDictionary()  # that were attached in this process


def asset_key(body: SoftBody) -> str:
    """Return 16 hexadecimal digits of what `body` is made of; the same before and after it is saved."""
    volume = body.fields.volume
    arrays = [
        body.control.frame,
        body.control.rest,
        body.control.basis,
        *body.stiffness.matrix,
        body.law_constants,
        body.fields.region,
        volume.labels,
        volume.spacing,
        volume.origin,
        volume.axes,
    ]
    digest = hashlib.sha256(body.law.encode())
    for array in arrays:
        wide = np.int64 if np.issubdtype(array.dtype, np.integer) else np.float64  # files have the smallest types
        for slab in array if array.ndim == 3 else [array]:  # at once, a large image would need eight times its memory
            digest.update(np.ascontiguousarray(slab, wide).tobytes())
    return digest.hexdigest()[:16]


def remember(body: SoftBody) -> str:
    """Let `recall` find the body, as long as someone else holds it, and return its key."""
    key = asset_key(body)
    _known[key] = body
    return key


def recall(key: str) -> SoftBody | None:
    """Return the body of this key, where one was attached in this process and still exists."""
    return _known.get(key)
