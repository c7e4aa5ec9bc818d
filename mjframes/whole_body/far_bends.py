"""How much too stiff a body is where it bends far: what its regions make of turns, to second order.

A load case moves the control points by d. Where it moves them a times as far, a region with ω = axial Σ_j d_j ḡ_jᵀ sees

    y = a y¹ + a² y²,   y¹_j = d_j − ω × X_j,   y²_j = −ω × d_j + ½ ω × (ω × X_j)

Its frames p turn against it, N_p = Σ_{j∈p} y¹_j g°_jᵀ, and so seem to be shorter. Green's strain has that back:

    ŷ²_j = y²_j + ½ N_pᵀ N_p (X_j − c_p)

What the other coordinates cannot take back costs energy of fourth order, that of ŷ² rightly so:

    W = a² W₂ + a⁴ W₄,   W₄ = min over δ of ½ Σ (y² + δ)ᵀ K_i (y² + δ)

So the load moves the body s a as far, s + 2 ρ s³ = 1, ρ = a² W₄/W₂. Each load is one that moves the body by MOVED of
its length, own weight as far as it does on earth if that is more, SAGGED at most; or one that strains it by STRAINED if
that is less. What the cells of a hyperelastic law miss is not counted.
Index letters: j control point; p frame; c load case.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mjframes.elasticity.rotations import frame_gradients
from mjframes.elasticity.stiffness import Stiffness
from mjframes.kinematics.control import ControlPoints

Array = NDArray[np.float64]

MOVED = 0.15  # [-] of the body's length: a bar that is held at one end has turned by 13° at the other
SAGGED = 0.5  # [-] of it: beyond, a bar hangs, and the terms that are left out here count
GRAVITY = 9.81  # [m/s²]
STRAINED = 0.05  # [-] root mean square over the energy
STEPS = 30  # of Newton's method, which needs 5 for ρ up to 100


def far_bends(
    control: ControlPoints,
    stiffness: Stiffness,
    linear: Sequence[Array],
    covariance: Array,
    moved: Array,
    reach: Array,
    bent: Array,
    firmness: float,
) -> float:
    """Return by how much less than it should a body moves under loads that bend it far, in the worst case [-].

    stiffness: K_i and ḡ of the regions.  covariance: K⁺ (3k, 3k).
    linear: (3m, 3m) of each region, what of K_i is not in the cells of a hyperelastic law, which know turns.
    moved: (k, 3, c) how the control points answer to some loads, to first order [m].
    reach, bent: (c,) how much of its own length the body moves there, and is to move, see `bends` [-].
    firmness: Σ E V [J], to which a strain's energy is compared.
    """
    shape = moved.shape
    gathered = np.zeros((2, 3 * shape[0], shape[2]))
    second, fourth = np.zeros(shape[2]), np.zeros((2, shape[2]))
    regions = zip(stiffness.points, stiffness.gradient, stiffness.matrix, linear, strict=True)
    for points, gradient, matrix, part in regions:
        rows = (3 * points[:, None] + np.arange(3)).ravel()
        first, *both = _seen(control.rest[points], control.frame[points], gradient, moved[points])
        second += _energy(matrix, first)
        for n, y in enumerate(both):
            fourth[n] += _energy(part, y)
            gathered[n][rows] += part @ y.reshape(len(rows), -1)
    fourth -= 0.5 * np.einsum("nic,ij,njc->nc", gathered, covariance, gathered, optimize=True)
    fourth = np.maximum(fourth, 0)
    loaded = second > 0
    second, (seen, right) = second[loaded], fourth[:, loaded]
    allowed = 0.5 * firmness * STRAINED**2  # = a² W₂ + a⁴ W₄
    square = np.minimum(
        (bent[loaded] / reach[loaded]) ** 2, 2 * allowed / (second + np.sqrt(second**2 + 4 * right * allowed))
    )
    return float(np.max(1 - _reached(square * seen / second) / _reached(square * right / second), initial=0))


def bends(reach: Array, weights: int, mass: float) -> Array:
    """Return (c,) how much of its own length a body of this mass [kg] is to move under loads [-].

    reach: (c,) how much it does under 1 N of each.  weights: how many of them, the first ones, are own weights.
    """
    bent = np.full(len(reach), MOVED)
    bent[:weights] = np.clip(reach[:weights] * mass * GRAVITY, MOVED, SAGGED)
    return bent


def _seen(rest: Array, frame: NDArray[np.int64], gradient: Array, moved: Array) -> tuple[Array, Array, Array]:
    """y¹, y² and ŷ² (m, 3, c) of a region."""
    X, d = rest - rest.mean(axis=0), moved - moved.mean(axis=0)
    F = np.einsum("jrc,ja->rac", d, gradient)
    omega = 0.5 * np.array([F[2, 1] - F[1, 2], F[0, 2] - F[2, 0], F[1, 0] - F[0, 1]])

    def turned(some: Array) -> Array:
        return np.cross(omega[None], some, axis=1)

    turn = turned(X[:, :, None])
    first, second = d - turn, 0.5 * turned(turn) - turned(d)
    right = second.copy()
    own = frame_gradients(rest, frame)
    for p in np.unique(frame):
        of_frame = frame == p
        N = np.einsum("jrc,ja->rac", first[of_frame], own[of_frame])
        arm = rest[of_frame] - rest[of_frame].mean(axis=0)
        right[of_frame] += 0.5 * np.einsum("rac,rbc,jb->jac", N, N, arm)
    return first, second, right


def _energy(matrix: Array, y: Array) -> Array:
    """½ yᵀ K y of each case."""
    flat = y.reshape(len(matrix), -1)
    return 0.5 * np.einsum("ic,ic->c", flat, matrix @ flat)


def _reached(ratio: Array) -> Array:
    """s with s + 2 ρ s³ = 1."""
    s = np.ones_like(ratio)
    for _ in range(STEPS):
        s -= (s + 2 * ratio * s**3 - 1) / (1 + 6 * ratio * s**2)
    return s
