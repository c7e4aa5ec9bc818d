"""How the body strains: recovered from finite elements that are in equilibrium, not from slopes of weights.

    ε(p̄) = sym Σ_j y_j ḡ_jᵀ + Ψ(p̄) T y / E,   y = Rᵀ x − x̄ of the region's control points, R its rotation

Weights and modes (`modes`) miss little of a displacement, and all that they miss has slopes. So strains are fitted by
themselves, in each region, to those of motions x_s that finite elements have answered:

    LOADED   the body's own weight, and what moves held pieces against each other
    PUSHED   the pushes of `error`
    1        x ~ N(0, K⁺), for what these do not show

where all x_s have one energy but for these factors. So Ψ T y is the regression of E (ε − sym Σ y ḡᵀ) on the region's
own points, of which the MODES that make most of the stress are kept. A free body of one material strains evenly where
its points do, as ḡ shows it: there y counts less its linear part. Held pieces do not strain.
Index letters: v voxel, of r places; j control point; s motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mjframes.base.rigid import motion_basis
from mjframes.base.rows import members_of
from mjframes.base.threads import in_parallel
from mjframes.elasticity.stiffness import Stiffness, shows_rotations
from mjframes.finite_elements.batch import averages
from mjframes.kinematics.control import ControlPoints
from mjframes.volume.grid import Grid
from mjframes.whole_body.modes import inverse_root, relative_motions
from mjframes.whole_body.superelement import Superelement, degrees

Array = NDArray[np.float64]

MODES = 12  # a region
DRAWN = 500  # [voxels] of a region that choose its modes
CHUNK = 4096  # [voxels] at a time
PUSHED, LOADED = 10.0, 100.0  # [-] weights of pushes, and of its own weight and motions of held pieces
STILL = 1e-9  # [-] to the motion of the points, what is rounding
SHOWN = 1e-3  # [-] by which Σ_j x̄_j ḡ_jᵀ may miss the identity
REACH = 0.05  # [-] second moment of the neighbours along an axis, in spacings², below which there are none
PAIRS = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))
SYMMETRIC = ((0, 5, 4), (5, 1, 3), (4, 3, 2))  # where of xx, yy, zz, yz, xz, xy a tensor's entries are


@dataclass(frozen=True, eq=False)
class Strains:
    """How r regions strain with q modes at most.

    mode: (n, 6, q) float16 Ψ at the voxels, of about one at most, as xx, yy, zz, yz, xz, xy in volume coordinates, 0
    for modes that a region has not.
    share: for each region T (q, 3m) [Pa/m], of its control points in their order.
    """

    mode: NDArray[np.floating] = field(metadata={"kept": np.float16})
    share: tuple[Array, ...]


@dataclass(frozen=True, eq=False)
class Motion:
    """Motions of the control points, and what finite elements answer.

    x: (3k, s), scaled to weights.
    moved: (r, 3, c) float32 fields of displacement along the grid's axes, and mix: (c, s), with which they are answers.
    """

    x: Array
    moved: NDArray[np.float32]
    mix: Array


def even_slope(gradient: Array, rest: Array) -> Array:
    """Return ḡ (m, 3) [1/m] as it is for points at rest (m, 3), 0 where it does not show all of a deformation."""
    shown = np.abs((rest - rest.mean(axis=0)).T @ gradient - np.eye(3)).max() < SHOWN
    return shows_rotations(gradient, rest) if shown else np.zeros_like(gradient)


def held_voxels(grid: Grid, cores: Sequence[NDArray[np.integer]]) -> NDArray[np.bool_]:
    """Return (n,) which voxels do not strain: those of held pieces, `cores`."""
    found = np.zeros(len(grid.index), bool)
    for voxels in cores:
        found[voxels] = True
    return found


def motions(
    matrix: Array,
    covariance: Array,
    control: ControlPoints,
    held: int,
    element: Superelement,
    x: Array,
    exact: NDArray[np.float32],
    weights: int,
) -> tuple[Motion, Motion]:
    """Return the motions that the superelement answers, and those under loads.

    matrix: K (3k, 3k), and covariance: K⁺ while the first `held` frames stand still.
    x: (3k, c) under load cases, in which finite elements move the places by `exact` (r, 3, c) along the grid's axes.
    weights: how many of them, the first ones, are own weights.
    """
    value, vector = np.linalg.eigh(covariance)
    kept = value > 1e-12 * value[-1]
    softly = vector[:, kept] * np.sqrt(value[kept])
    pulled = _scaled(matrix, _pulled(matrix, covariance, control, held))
    known = np.hstack([softly, LOADED * pulled[0]])
    loaded, scale = _scaled(matrix, x)
    weight = np.where(np.arange(x.shape[1]) < weights, LOADED, PUSHED)
    return (
        Motion(known, element.moved, element.lifting @ known),
        Motion(weight * loaded, exact, np.diag(weight * scale)),
    )


def _pulled(matrix: Array, covariance: Array, control: ControlPoints, held: int) -> Array:
    """(3k, 6(h − 1)) what moves each held piece but the last, rigidly, with how the frames follow."""
    found = np.zeros((len(matrix), 0))
    for i in range(held - 1):
        points = np.flatnonzero(control.frame == i)
        given = np.zeros((len(matrix), 6))
        given[degrees(points)] = motion_basis(control.rest[points])
        found = np.hstack([found, given - covariance @ (matrix @ given)])
    return found


def _scaled(matrix: Array, x: Array) -> tuple[Array, Array]:
    """Motions (3k, s) scaled to the energy of one of K⁺, none for those without, and the factors."""
    energy = np.einsum("as,as->s", x, matrix @ x)
    scale = np.where(energy > 0, 1 / np.sqrt(np.where(energy > 0, energy, 1)), 0)
    return x * scale, scale


def _slopes_at(
    grid: Grid, still: NDArray[np.bool_], blocks: NDArray[np.integer]
) -> tuple[list[sparse.csr_array], NDArray[np.bool_]]:
    """Return ∂/∂ξ_a (r, r) [1/m] along each index axis, and along which axes (r, 3) no place has a neighbour.

    still: (n,) which voxels are held.  blocks: (n,) the place of each voxel.
    By least squares from the neighbours along an axis, those of the same material if there are any. Beyond a side of
    another one, the stress and not the slope is the same.
    """
    count = int(blocks.max()) + 1
    at = np.asarray(averages(blocks) @ grid.index.astype(np.float64))  # [voxels]
    here, there, along, same = _neighbours(grid, still, blocks)
    first = np.unique(blocks, return_index=True)[1]
    young, firm = grid.young[first], still[first]
    inside = np.zeros((count, 3), bool)
    np.logical_or.at(inside, (here, along), same)
    used = (same | ~inside[here, along]) & ~firm[here]
    here, there, along, same = (some[used] for some in (here, there, along, same))
    ease = np.where(same, 1.0, np.where(firm[there], 2.0, 2 * young[there] / (young[here] + young[there])))
    step = at[there] - at[here]
    square = np.zeros((count, 3, 3))
    np.add.at(square, here, step[:, :, None] * step[:, None, :])
    weight = np.einsum("pab,pb->pa", np.linalg.pinv(square, rcond=REACH, hermitian=True)[here], step)
    weight *= ease[:, None] / grid.spacing
    found = []
    for a in range(3):
        gather = sparse.csr_array((weight[:, a].astype(np.float32), (here, there)), shape=(count, count))
        found.append(sparse.csr_array(gather - sparse.diags_array(np.asarray(gather.sum(axis=1)).ravel())))
    alone = np.ones((count, 3), bool)
    alone[here, along] = False
    return found, alone


def _neighbours(
    grid: Grid, still: NDArray[np.bool_], blocks: NDArray[np.integer]
) -> tuple[NDArray[np.integer], NDArray[np.integer], NDArray[np.integer], NDArray[np.bool_]]:
    """Faces between two places: here and there (p,), the axis, and whether both are of one material, held or not."""
    pairs = []
    for axis, step in enumerate(np.eye(3, dtype=np.int32)):
        for side in (-1, 1):
            other = grid.beside(side * step)
            own = np.flatnonzero((other >= 0) & (blocks != blocks[other]))
            alike = (grid.material[own] == grid.material[other[own]]) & (still[own] == still[other[own]])
            pairs.append((blocks[own], blocks[other[own]], np.full(len(own), axis), alike))
    here, there, along, same = (np.concatenate(parts) for parts in zip(*pairs, strict=True))
    return here, there, along, same


def strains(
    grid: Grid,
    cores: Sequence[NDArray[np.integer]],
    blocks: NDArray[np.integer],
    control: ControlPoints,
    known: Sequence[Motion],
    stiffness: Stiffness,
    region: NDArray[np.int32],
) -> Strains:
    """Return how the voxels strain.

    cores: held pieces.  blocks: (n,) the place of each voxel.  known: motions and their answers.
    region: (n,) of the voxels.
    """
    still, axes = held_voxels(grid, cores), grid.axes.astype(np.float32)
    slopes, alone = _slopes_at(grid, still, blocks)
    first = np.unique(blocks, return_index=True)[1]
    of_first = grid.material[first]
    young, lam, mu = (grid.per_material(name)[of_first].astype(np.float32) for name in ("young", "lam", "mu"))
    x = np.hstack([some.x for some in known])
    strained = np.flatnonzero(~still[first])
    voxels = members_of(region[first][strained], len(stiffness.points))
    free = not len(cores) and np.ptp(young) == np.ptp(lam) == 0

    def stresses(some: NDArray[np.integer], mix: Array, uniform: Array) -> NDArray[np.float32]:
        """E (ε − those that are uniform) (v, 6, q) of mixtures (s, q) of the motions."""
        strain = _freed(_slopes(slopes, some, known, mix), alone[some], lam[some], mu[some])
        turned = np.einsum("ra,vabq,sb->vrsq", axes, strain, axes, optimize=True) - uniform
        return np.stack([turned[:, r, s] for r, s in PAIRS], axis=1) * young[some, None, None]

    def of_region(e: int) -> tuple[NDArray[np.float16], Array]:
        points, some = stiffness.points[e], strained[voxels[e]]
        rest = control.rest[points]
        even = even_slope(stiffness.gradient[e], rest)
        apart = relative_motions(rest, degrees(np.flatnonzero(control.frame[points] < len(cores))))
        y = apart @ x[degrees(points)]
        if free:
            apart = _uneven(rest, even)
        seen = apart @ y
        inverse = inverse_root(seen @ seen.T)
        if not len(some) or not len(inverse) or np.abs(seen).max() < STILL * np.abs(x[degrees(points)]).max():
            return np.zeros((len(some), 6, 0), np.float16), np.zeros((0, y.shape[0]))
        mix = seen.T @ inverse.T  # (s, q) to unit, independent motions of the points
        uniform = np.einsum("jrq,ja->raq", (y @ mix).reshape(len(points), 3, -1), even)
        uniform = (0.5 * (uniform + uniform.transpose(1, 0, 2))).astype(np.float32)
        drawn = stresses(some[:: -(-len(some) // DRAWN)], mix, uniform)
        twice = drawn * np.array([1, 1, 1, 2, 2, 2], np.float32)[:, None]
        vector = np.linalg.eigh(np.tensordot(twice, drawn, ((0, 1), (0, 1))).astype(np.float64))[1][:, ::-1]
        kept = vector[:, :MODES]
        largest = np.maximum(np.abs(drawn @ kept.astype(np.float32)).max(axis=(0, 1)), np.finfo(np.float32).tiny)
        kept = kept / largest
        starts = range(0, len(some), CHUNK)
        parts = [stresses(some[i : i + CHUNK], mix @ kept, uniform @ kept).astype(np.float16) for i in starts]
        return np.concatenate(parts), largest[:, None] ** 2 * (kept.T @ inverse @ apart)

    found = list(in_parallel(of_region, range(len(stiffness.points))))
    most = max((len(share) for _, share in found), default=0)
    mode = np.zeros((len(first), 6, most), np.float16)
    for some, (values, share) in zip(voxels, found, strict=True):
        mode[strained[some], :, : len(share)] = values
    return Strains(mode[blocks], tuple(share for _, share in found))


def _uneven(rest: Array, even: Array) -> Array:
    """(3m, 3m) from displacements of points to those less their common linear motion."""
    arm = rest - rest.mean(axis=0)
    fit = arm @ even.T + 1 / len(rest)
    return np.kron(np.eye(len(rest)) - fit, np.eye(3))


def _slopes(
    matrices: Sequence[sparse.csr_array],
    voxels: NDArray[np.integer],
    known: Sequence[Motion],
    mix: Array,
) -> NDArray[np.float32]:
    """∂u_d/∂ξ_a (v, 3, 3, q) along the index axes, of mixtures (s, q) of the motions' answers."""
    own = [sparse.csr_array(matrix[voxels]) for matrix in matrices]
    near = np.unique(np.concatenate([matrix.indices for matrix in own]))
    field, start = np.zeros((len(near), 3, mix.shape[1]), np.float32), 0
    for motion in known:
        part = motion.mix @ mix[start : start + motion.x.shape[1]]
        field += motion.moved[near] @ part.astype(np.float32)
        start += motion.x.shape[1]
    flat = field.reshape(len(near), -1)
    slopes = [(sparse.csr_array(matrix[:, near]) @ flat).reshape(-1, 3, mix.shape[1]) for matrix in own]
    return np.stack(slopes, axis=2)


def _freed(
    slope: NDArray[np.float32], alone: NDArray[np.bool_], lam: NDArray[np.float32], mu: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Strains (v, 3, 3, q) from slopes, such that nothing pulls along axes (v, 3) along which the material is thin."""
    strain = np.float32(0.5) * (slope + slope.transpose(0, 2, 1, 3))
    strain *= ~(alone[:, :, None] | alone[:, None, :])[:, :, :, None]
    ratio = -lam / (alone.sum(axis=1) * lam + 2 * mu)
    across = ratio[:, None] * np.trace(strain, axis1=1, axis2=2)
    for a in range(3):
        strain[:, a, a] += alone[:, a, None] * across
    return strain
