"""The stiffness that the whole finite-element body shows to its frames: a superelement (in place of the paper's §5.3).

Frame coordinates are moments of the true displacement u. With Φ the control weights, e = V √(E / E_max) of each voxel
and the functionals b_j(u) = Σ_v e_v ∫ Φ_j u / V, the columns of B,

    minimize ½ uᵀ A u  subject to  Bᵀ u = G x,   G = Bᵀ Φ
    →  u = Y μ + U a,   S μ = G x − Bᵀ U a,   K = ∂²/∂x² ½ (μᵀ S μ + aᵀ D a)

where A is the stiffness of the voxels, Y = A⁻¹ B while held pieces stand still, and S = Bᵀ Y. Held pieces move by
a = H x, the rigid motions of their control points; U is how the body follows them, D their energy. A free body has
multipliers that balance, Uᵀ B μ = 0, with U its own rigid motions, and moves by the a that is left of the constraint.
What material m has of K is ∂K/∂log E_m = Nᵀ A_m N, where N x is the u of x and A_m of that material's voxels alone: u
minimizes, so that it does not change to first order. The sum over all materials is K, as A is homogeneous in all E_m.
Nothing locks, whatever the shape of the weights: K is what the finite elements resist with when the moments move. The
exponent ½ of E is a compromise: with 0 the soft core of a sandwich hides what its skins do, 1 is blind to a soft coat.

The points of a rigid frame have the moments of its rigid motions alone. To strain them, which they never are but by
large turns, costs as much as to move them (STRAIN): a frame turned half around is not taken for one at rest.
Index letters: j, k control point; v voxel; a corner of a voxel; m functional.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mjframes.base.errors import MjframesError
from mjframes.base.linear import inverse_root, scaled_eigenvectors
from mjframes.base.rigid import motion_basis, rigid_motions
from mjframes.finite_elements.batch import Progress
from mjframes.finite_elements.element import CORNERS
from mjframes.finite_elements.motions import Motions, motions
from mjframes.finite_elements.respond import Response, respond
from mjframes.finite_elements.solver import BodySolver
from mjframes.kinematics.control import ControlPoints, control_weights
from mjframes.volume.grid import Grid

Array = NDArray[np.float64]

DEPENDENT = 1e-9  # [-] as `base.linear.ZERO`, of functionals, from weights that are dropped below a thousandth
STIFFEST = 1e-12  # [-] least eigenvalue of scaled S: what moves less is rounding, and counts as that stiff
STRAIN = 1.0  # [-] stiffness of straining a rigid frame's points, to the mean of moving them


@dataclass(frozen=True, eq=False)
class Superelement:
    """The body condensed to k control points.

    matrix: (3k, 3k) K [N/m], in volume coordinates.
    moved: (r, 3, c) float32, c fields of displacement at r places, along the grid's axes.
    lifting: (c, 3k); control points displaced by x [m], in volume coordinates, move the places by moved · lifting · x.
    shares: (p, 3k, 3k) of K [N/m], of the groups of materials that were asked for.
    """

    matrix: Array
    moved: NDArray[np.float32]
    lifting: Array
    shares: Array


def superelement(
    grid: Grid,
    weights: sparse.csr_array,
    control: ControlPoints,
    types: Sequence[str],
    held: int,
    solver: BodySolver,
    blocks: NDArray[np.integer],
    progress: Progress,
    groups: Sequence[NDArray[np.bool_]] = (),
) -> Superelement:
    """Return K of all control points, and how the body follows them.

    weights: (n, f) of the frames at the voxels.  types: (f,) of the frames.  held: so many frames, the first ones, are
    the pieces that the solver holds, in its order.  blocks: (n,) the place of each voxel.
    progress, groups: see `respond`.
    """
    functionals, gram = moments(grid, weights, control, solver)
    _refuse_thin(gram, control, types, held)
    moving = np.flatnonzero(control.frame >= held)
    rest = control.rest @ grid.axes
    forces = sparse.csr_array(functionals[:, moving])
    motion = motions(solver, forces, blocks)
    response = respond(solver, forces, blocks, progress, groups=groups, others=motion.fields)
    basis = frame_motions(control, types, rest, held)
    rigid = basis @ basis.T
    mix = _independent(gram[np.ix_(moving, moving)], frame_motions(control, types, rest, held, held)[degrees(moving)])
    target = mix.T @ np.kron(gram[moving], np.eye(3)) @ rigid  # (m, 3k) moments of Φ x
    push = mix.T @ motion.moments
    if held:
        carried = _held_motions(control, held, rest, motion)
        multipliers, stiffness = _minimum(response, mix, target - push @ carried)
        stiffness += carried.T @ motion.energy @ carried
    else:
        carried, multipliers, stiffness = _free_minimum(response, mix, push, target)
    stiffness += _straining(stiffness, rigid)
    following = np.vstack([mix @ multipliers, motion.change @ carried])
    shares = following.T @ response.shares @ following
    shares = np.array([share + _straining(share, rigid) for share in shares]).reshape(shares.shape)
    turned = np.kron(np.eye(len(rest)), grid.axes.T)  # from volume coordinates to the grid's axes
    return Superelement(
        matrix=turned.T @ (stiffness + stiffness.T) / 2 @ turned,
        moved=np.concatenate([response.moved, motion.moved], axis=2),
        lifting=np.vstack([mix @ multipliers, carried]) @ turned,
        shares=turned.T @ shares @ turned,
    )


def degrees(points: NDArray[np.integer]) -> NDArray[np.int64]:
    """Return the degrees of freedom (3m,) of control points (m,)."""
    return (3 * np.asarray(points)[:, None] + np.arange(3)).ravel()


def moments(
    grid: Grid, weights: sparse.csr_array, control: ControlPoints, solver: BodySolver
) -> tuple[sparse.csr_array, Array]:
    """Return the functionals B (N, k) on one component of nodal displacements, and their values G (k, k) on weights.

    A voxel counts with its own extent h: a mean over it of Φ_j times a field that is linear along the axes is the mean
    over its corners of the field times Φ_j a third of the way there. Sheets of one voxel need that.
    """
    e = grid.cell_volume * np.sqrt(grid.young / grid.young.max()) / 8
    k = len(control.frame)
    free = np.flatnonzero(solver.node[:, 0] >= 0)  # weights of frames that move are 0 in held pieces
    nodes = len(solver.mesh.position)
    functionals = sparse.csr_array((nodes, k))
    gram = np.zeros((k, k))
    for a, corner in enumerate(CORNERS):
        step = grid.axes @ ((corner - 0.5) * grid.spacing)
        inner = control_weights(weights, control, grid.centers + step / 3)
        outer = control_weights(weights, control, grid.centers + step)
        inner.data *= np.repeat(e, np.diff(inner.indptr))
        gather = sparse.csr_array((np.ones(len(free)), (solver.node[free, a], free)), shape=(nodes, len(e)))
        functionals = functionals + gather @ inner
        gram += (inner.T @ outer).toarray()
    return sparse.csr_array(functionals), gram


def _refuse_thin(gram: Array, control: ControlPoints, types: Sequence[str], held: int) -> None:
    """Raise MjframesError where a quadratic frame has a motion that no moment of the body sees: nothing resists it."""
    for i, kind in enumerate(types):
        if kind != "quadratic" or i < held:
            continue
        own = gram[np.ix_(control.frame == i, control.frame == i)]
        value, _ = scaled_eigenvectors((own + own.T) / 2)
        if value[0] < DEPENDENT * value[-1]:
            place = ", ".join(f"{c:.3g}" for c in control.rest[control.frame == i].mean(axis=0))
            raise MjframesError(
                f"a quadratic frame, near ({place}) m, has one voxel of the body across, which shows no bend: "
                "give frame_type='affine', or a volume with finer voxels."
            )


def frame_motions(control: ControlPoints, types: Sequence[str], rest: Array, held: int, first: int = 0) -> Array:
    """Return (3k, q) orthonormal: what the points of the frames from `first` on can do: anything, or, where a frame is
    rigid or one of the first `held`, its rigid motions.  rest: (k, 3), along any axes.
    """
    blocks = [np.zeros((3 * np.count_nonzero(control.frame < first), 0))]
    for i in range(first, len(types)):
        points = rest[control.frame == i]
        blocks.append(np.eye(3 * len(points)) if types[i] != "rigid" and i >= held else motion_basis(points))
    return np.asarray(sparse.block_diag(blocks).toarray())


def _independent(gram: Array, basis: Array) -> Array:
    """(3j, m) combinations of the functionals of j points, orthonormal in their Gram matrix, as far as they differ."""
    full = basis.T @ np.kron((gram + gram.T) / 2, np.eye(3)) @ basis
    return basis @ inverse_root(full, DEPENDENT)


def _held_motions(control: ControlPoints, held: int, rest: Array, motion: Motions) -> Array:
    """H (6h, 3k): the rigid motion of each held piece from the displacements of its control points."""
    carried = np.zeros((6 * held, 3 * len(rest)))
    for i in range(held):
        points = np.flatnonzero(control.frame == i)
        field = rigid_motions(rest[points], motion.center[i], motion.scale)
        carried[6 * i : 6 * i + 6, degrees(points)] = np.linalg.pinv(field)
    return carried


def _minimum(response: Response, mix: Array, target: Array) -> tuple[Array, Array]:
    """μ (m, 3k) and the stiffness (3k, 3k) of reaching the moments `target` (m, 3k)."""
    inverse = _inverse(mix.T @ response.compliance @ mix)
    multipliers = inverse @ target
    return multipliers, target.T @ multipliers


def _free_minimum(response: Response, mix: Array, push: Array, target: Array) -> tuple[Array, Array, Array]:
    """a (6, 3k), μ (m, 3k) and the stiffness (3k, 3k) of a free body. push: (m, 6) moments of its own motions."""
    balanced = np.linalg.svd(push, full_matrices=True)[0][:, np.linalg.matrix_rank(push) :]
    compliance = mix.T @ response.compliance @ mix
    inverse = balanced @ _inverse(balanced.T @ compliance @ balanced) @ balanced.T
    multipliers = inverse @ target
    motion = np.linalg.lstsq(push, target - compliance @ multipliers, rcond=None)[0]
    return np.asarray(motion, np.float64), multipliers, target.T @ multipliers


def _inverse(compliance: Array) -> Array:
    """Of a symmetric positive definite matrix, as far as rounding lets it be one."""
    value, vector = scaled_eigenvectors(compliance)
    return (vector / np.maximum(value, STIFFEST * value[-1])) @ vector.T


def _straining(stiffness: Array, rigid: Array) -> Array:
    """The stiffness against what rigid frames cannot do."""
    strain = np.eye(len(rigid)) - rigid
    own = np.diagonal(rigid) * np.diagonal(stiffness)
    return STRAIN * np.mean(own) * strain if strain.any() else strain
