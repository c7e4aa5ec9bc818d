"""How far a body is from the finite elements on its own voxels: what it may promise before anyone has loaded it.

Both answer the same load cases: the body's own weight along three axes, if it is held, and pushes on PUSHED of the
surface each, spread evenly over it. With u what the finite elements do and û = N K⁺ Wᵀ f what the frames do, where N
adds the modes of `lifting` to W,

    weight = max over directions g of |Σ_a g_a (û_a − u_a)| / |Σ_a g_a u_a|
    pushes = max over pushes of |û − u| outside of FAR radii / |u|

in L2 over the voxels, a free body's without rigid motion; far bends have `far_bends`. For frames that are not built yet
(`expected`) the error of their coordinates stands in, u − Φ G⁻¹ Bᵀ u: that needs weights only, and no further solution.
Index letters: v voxel; a axis; c load case.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mjframes.base.rigid import motion_basis
from mjframes.kinematics.control import ControlPoints, control_weights
from mjframes.volume.grid import Grid
from mjframes.whole_body.pushes import FAR, FreeSurface, balanced, pushes

Array = NDArray[np.float64]

CASES = 16  # so many load cases: as many as the solver takes at once
PUSHED = 0.08  # [-] of the surface that a push covers
LARGE = 0.3  # [-] error beyond which a body needs advice
ADVICE = " (more frames make it smaller, as do --error 0.15 or error=0.15, which find out how many)"


@dataclass(frozen=True)
class BodyError:
    """Relative errors of displacements, against finite elements on the same voxels, in L2 over the voxels.

    weight: under its own weight, in the direction where that is most; None for a body that nothing holds.
    pushes: the largest of some pushes on 8 % of the surface each, away from where it is pushed.
    bends: by how much the body moves too little where such loads bend it far, see `far_bends`; None where that was
        not measured.
    """

    weight: float | None
    pushes: float
    bends: float | None = None

    def __str__(self) -> str:
        """Return it as a part of a sentence, with what helps where it is large."""
        if self.largest == 0:
            return "none, as no push deforms it"
        told = "".join(f"{error:.1%} {where}, " for where, error in self.parts.items())
        return f"{told}against finite elements{ADVICE if self.largest > LARGE else ''}"

    @property
    def parts(self) -> dict[str, float]:
        """Return those that are known, by where they occur."""
        parts = {"under its own weight": self.weight, "under pushes": self.pushes, "in far bends": self.bends}
        return {where: error for where, error in parts.items() if error is not None}

    @property
    def largest(self) -> float:
        """Return the largest of them."""
        return max(self.parts.values())


@dataclass(frozen=True, eq=False)
class LoadCases:
    """Forces under which the error is measured.

    force: (n, 3, c) float32 [N] on the voxels, in volume coordinates; balanced where nothing is held.
    weights: how many cases, the first ones, are own weights.
    far: (c, n) the voxels that count.
    """

    force: NDArray[np.float32]
    weights: int
    far: NDArray[np.bool_]


def load_cases(grid: Grid, cores: Sequence[NDArray[np.integer]], surface: FreeSurface) -> LoadCases:
    """Return CASES load cases of a body of which the voxels `cores` are held.  surface: what is free of it."""
    n = len(grid.index)
    mass = grid.density * grid.cell_volume
    weights = 3 if cores else 0
    force, far = np.zeros((n, 3, CASES), np.float32), np.ones((CASES, n), bool)
    for a in range(weights):
        force[:, a, a] = mass / mass.sum()
    force[:, :, weights:], pushed = pushes(grid, surface, PUSHED, CASES - weights)
    for c, voxels in enumerate(pushed, start=weights):
        middle = grid.centers[voxels].mean(axis=0)
        radius = np.linalg.norm(grid.centers[voxels] - middle, axis=1).max() + grid.spacing.max()
        far[c] = np.linalg.norm(grid.centers - middle, axis=1) > FAR * radius
    far[~far.any(axis=1)] = True  # a body so small that a push is everywhere
    return LoadCases(force if cores else balanced(grid, force), weights, far)


def expected(
    grid: Grid,
    weights: sparse.csr_array,
    control: ControlPoints,
    held: int,
    cases: LoadCases,
    exact: NDArray[np.floating],
) -> BodyError:
    """Return the error of the coordinates of frames with these weights (n, f), whatever their stiffness.

    exact: (n, 3, c) how the finite elements move.
    """
    moving = np.flatnonzero(control.frame >= held)
    functions = sparse.csr_array(control_weights(weights, control, grid.centers)[:, moving])
    e = np.sqrt(grid.young / grid.young.max())
    weighted = sparse.csr_array(functions * e[:, None])
    gram = (weighted.T @ functions).toarray()
    x = np.linalg.lstsq(gram, weighted.T @ exact.reshape(len(e), -1), rcond=1e-10)[0]
    return measured(grid, cases, exact, (functions @ x).reshape(exact.shape))[0]


def coordinates(plain: sparse.csr_array, corrected: sparse.csr_array, covariance: Array, cases: LoadCases) -> Array:
    """Return x (3k, c) of frames with the compliance K⁺ (3k, 3k).

    plain, corrected: (n, k) w_i φ_j, by which they have masses and so weight, and W_j, by which they are pushed.
    """
    n, _, count = cases.force.shape
    load = (corrected.T @ cases.force.reshape(n, -1)).reshape(-1, count)
    weight = cases.force[:, :, : cases.weights].reshape(n, 3 * cases.weights)
    load[:, : cases.weights] = (plain.T @ weight).reshape(len(load), cases.weights)
    return covariance @ load


def measured(grid: Grid, cases: LoadCases, exact: NDArray[np.floating], found: Array) -> tuple[BodyError, Array]:
    """Return the error of displacements `found` (n, 3, c), and where it is.

    That is (n,) its rms over the cases, to that of u.
    """
    difference, size = np.subtract(found, exact, order="C"), exact.astype(np.float64, order="C")
    _leave_deformations(grid, cases, difference, size)
    if (grid.piece >= 0).all():  # rigid throughout: finite elements show what stands in for rigidity
        difference[:], size[:] = 0, 0
    norm = np.linalg.norm(size, axis=(0, 1))
    norm = np.where(norm > 0, norm, np.inf)  # a single voxel or a rigid body does not move
    apart = [np.linalg.norm(difference[far, :, c]) / norm[c] for c, far in enumerate(cases.far)]
    weight = None
    if cases.weights:
        parts = [field[:, :, : cases.weights].reshape(-1, cases.weights) for field in (difference, size)]
        scale = 1 / np.linalg.norm(parts[1], axis=0)
        square, whole = (scale[:, None] * (part.T @ part) * scale for part in parts)
        weight = float(np.sqrt(np.max(np.linalg.eigvals(np.linalg.solve(whole, square)).real)))
    where = np.sqrt(np.mean((difference**2).sum(axis=1) / norm**2, axis=1) * len(difference))
    return BodyError(weight, float(max(apart[cases.weights :]))), where


def reaches(grid: Grid, cases: LoadCases, exact: NDArray[np.floating]) -> Array:
    """Return (c,) how far displacements `exact` (n, 3, c) go at most, to the length of the body [-]."""
    moved = exact.astype(np.float64, order="C")
    _leave_deformations(grid, cases, moved)
    return np.linalg.norm(moved, axis=1).max(axis=0) / (grid.length + float(grid.spacing.max()))


def _leave_deformations(grid: Grid, cases: LoadCases, *displacements: Array) -> None:
    """Take the rigid motions of a free body from its displacements (n, 3, c), in place."""
    if cases.weights:
        return
    motion = motion_basis(grid.centers)
    for field in displacements:
        flat = field.reshape(len(motion), -1)
        flat -= motion @ (motion.T @ flat)
