"""The gradients that tell how regions are turned, where each region is what one frame adds to its parents.

A region has the control points of a frame, the child, after those of its parents (whole_body/families.py). Its rotation
is the one closest to F = Σ_j x_j g_jᵀ (corotational.py); these are the gradients g, linear fits to the points at rest,
X_j:

    g°_j = A_p⁺ (X_j − c_p)                   of frame p alone: A_p = Σ_j (X_j − c_p)(X_j − c_p)ᵀ, c_p = mean of X_j
    ḡ_j  = ½ g°_j                              on the child's points
    ḡ_j  = ½ (κ_p / Σ_q κ_q) g°_j              on parent p's points, κ_p = Σ |K_e| over the block (child, p)

so that the rotation of a bent region is halfway between the child and the parents that it is coupled to. A root has its
own g°. A frame of one point has no g°: where a region has such a frame, ḡ is the fit to all its points, with the same
weights of the frames. That takes three points to fix a rotation; about the line of two, and about one, no K_e answers
to a turn.

Shapes: X, gradients (m, 3), K_e (3m, 3m), frame (m,) the frame of each point. [m], [1/m], [N/m]
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mjframes.elasticity.stiffness import Stiffness
from mjframes.kinematics.control import ControlPoints

Array = NDArray[np.float64]

FLAT = 1e-9  # [-] second moment along an axis, to the largest: the points do not reach along it


def fitted_gradient(rest: Array, weight: Array) -> Array:
    """Return g (m, 3): Σ_j x_j g_jᵀ is the F that fits x_j = F X_j + t by least squares, as far as the points reach."""
    offset = rest - weight @ rest / weight.sum()
    moment = (weight[:, None] * offset).T @ offset
    return weight[:, None] * offset @ np.linalg.pinv(moment, rcond=FLAT, hermitian=True)


def frame_gradients(rest: Array, frame: NDArray[np.int64]) -> Array:
    """Return g° (m, 3) of every frame, 0 for those of one point."""
    own = np.zeros_like(rest)
    for i in np.unique(frame):
        of_frame = frame == i
        if of_frame.sum() > 1:
            own[of_frame] = fitted_gradient(rest[of_frame], np.ones(of_frame.sum()))
    return own


def frame_shares(frame: NDArray[np.int64], stiffness: Array) -> Array:
    """Return (m,) of each point's frame: ½ for the child, the last one, ½ for its parents, by κ; 1 for a root."""
    child = frame == frame[-1]
    if child.all():
        return np.ones(len(frame))
    magnitude = np.abs(stiffness).reshape(len(frame), 3, len(frame), 3).sum(axis=(1, 3))
    coupling = np.bincount(frame, np.where(child, 0, magnitude[child].sum(axis=0)))
    if not coupling.any():  # a child that nothing holds: any shares will do
        coupling[frame[~child]] = 1
    return np.where(child, 0.5, 0.5 * coupling[frame] / coupling.sum())


def region_gradient(rest: Array, frame: NDArray[np.int64], stiffness: Array) -> Array:
    """Return ḡ (m, 3) of a region."""
    shares, size = frame_shares(frame, stiffness), np.bincount(frame)[frame]
    if (size == 1).any():
        return fitted_gradient(rest, shares / size)
    return shares[:, None] * frame_gradients(rest, frame)


def with_rotations(stiffness: Stiffness, control: ControlPoints) -> Stiffness:
    """Return the same with ḡ of every region, for one region a frame."""
    parts = [
        (control.rest[points], control.frame[points], matrix)
        for points, matrix in zip(stiffness.points, stiffness.matrix, strict=True)
    ]
    return replace(
        stiffness,
        gradient=tuple(region_gradient(*part) for part in parts),
    )
