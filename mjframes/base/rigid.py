"""Rigid motions of points, linearized: u(p̄) = t + ω × (p̄ − c)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def rigid_motions(points: NDArray[np.number], center: Array, scale: float) -> Array:
    """Return (3s, 6) for points (s, 3): three translations, and rotations about `center` (3,) by 1 / scale."""
    motion = np.zeros((len(points), 3, 6))
    motion[:, range(3), range(3)] = 1
    for axis in range(3):
        motion[:, :, 3 + axis] = np.cross(np.eye(3)[axis], (points - center) / scale)
    return motion.reshape(-1, 6)


def motion_basis(points: NDArray[np.number]) -> Array:
    """Return (3s, 6) orthonormal for points (s, 3): their rigid motions."""
    return np.linalg.qr(rigid_motions(points, points.mean(axis=0), size_of(points)))[0]


def size_of(points: NDArray[np.number]) -> float:
    """Return the diagonal of the box around points (s, 3) [m], 1 for a single one."""
    return float(np.linalg.norm(np.ptp(points, axis=0))) or 1.0
