"""Muscles: a field of fibres over voxels, whose stretch is the length of a tendon.

    M = ∫ |F f| dV ≈ Σ_s V_s |p_b − p_a| / h,   E = σ M        f: unit direction at rest; σ: active stress [Pa]

A force on M is minus σ: the fibres pull with a first Piola stress σ (F f / |F f|) fᵀ. With slopes d_j = f · ∇W_j,
F f is Σ_j d_j x_j. Voxels whose slopes are alike share a sample, whose d_j are their mean: where F f is the same in all
of a sample nothing is lost. Its two points have the weights W_j ± h/2 d_j, so that p_b − p_a is h F f.
Index letters: v voxel; s sample; j control point.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse
from scipy.cluster.vq import kmeans2

from mjframes.base.errors import MjframesError
from mjframes.base.numbers import is_whole
from mjframes.body.soft_body import SoftBody
from mjframes.scene.material_points import material_points
from mjframes.volume.grid import Grid

SAMPLES = 100
ROUNDS = 20  # of k-means
SKETCH = 24  # numbers that stand for a voxel's slopes when they are compared


@dataclass(frozen=True, eq=False)
class Muscle:
    """A field of muscle fibres in a soft body: ∫ |F f| dV over its voxels [m³] is the length of a tendon.

    A motor's force on the tendon is minus the active stress [Pa] with which the fibres pull. `attach` adds the tendon.

    Parameters
    ----------
    voxels
        A label of the volume, or a mask (nx, ny, nz) of its voxels. All of them must be in the body.
    direction
        That of the fibres at rest, in the volume's axes: one vector (3,), or one for each voxel of the volume
        (nx, ny, nz, 3). Their lengths do not matter; those of other voxels are not read.
    samples
        At how many places at most the stretch is measured.

    Raises
    ------
    MjframesError
        If an argument is not as described.
    """

    voxels: int | ArrayLike
    direction: ArrayLike
    samples: int = SAMPLES

    def __post_init__(self) -> None:
        if not is_whole(self.samples) or self.samples < 1:
            raise MjframesError(f"samples is {self.samples!r}; give an integer > 0.")


@dataclass(frozen=True, eq=False)
class Segments:
    """s samples of a muscle, each as two points, one after the other.

    weights: W_j (2s, k).
    offset: (2s, 3) p̄ − Σ_j W_j x̄_j [m].
    volume: V_s (s,) [m³].
    """

    weights: sparse.csr_array
    offset: NDArray[np.float64]
    volume: NDArray[np.float64]


def fibres(grid: Grid, own: str, muscle: Muscle) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return a muscle's voxels (n,) and their f (n, 3).

    own: name of the tendon, for errors.
    """
    lookup, shape = grid.lookup, grid.lookup.shape
    given = np.asarray(muscle.voxels)
    if is_whole(muscle.voxels):
        voxels = np.flatnonzero(grid.label == muscle.voxels)
        if not len(voxels):
            known = ", ".join(map(str, grid.labels))
            raise MjframesError(f"voxels of {own!r} is the label {muscle.voxels}; the body's labels are {known}.")
    elif given.shape != shape or given.dtype != bool:
        raise MjframesError(
            f"voxels of {own!r} has the shape {given.shape} and type {given.dtype}; give a label, or a boolean mask of "
            f"the volume's {shape} voxels."
        )
    else:
        voxels = lookup[given]
        if not len(voxels) or voxels.min() < 0:
            outside = f"{np.count_nonzero(voxels < 0)} voxels outside the body" if len(voxels) else "no voxel"
            raise MjframesError(f"voxels of {own!r} has {outside}; give voxels of the body.")
    try:
        direction = np.asarray(muscle.direction, float)
    except (TypeError, ValueError):
        direction = np.empty(0)
    if direction.shape == (*shape, 3):
        direction = direction[tuple(grid.index[voxels].T)]
    elif direction.shape != (3,):
        raise MjframesError(
            f"direction of {own!r} has the shape {np.shape(muscle.direction)}; give a vector (3,), or one for each "
            f"voxel of the volume, {(*shape, 3)}."
        )
    direction = np.broadcast_to(direction, (len(voxels), 3))
    size = np.linalg.norm(direction, axis=1)
    if not (np.isfinite(size) & (size > 0)).all():
        raise MjframesError(
            f"direction of {own!r} has no length in some of its voxels; give finite vectors that are not zero."
        )
    return voxels.astype(np.int64), direction / size[:, None]


def segments(
    body: SoftBody,
    rest: NDArray[np.float64],
    grid: Grid,
    voxels: NDArray[np.int64],
    along: NDArray[np.float64],
    most: int,
) -> Segments:
    """Return at most `most` samples of voxels (n,) with directions f (n, 3).

    rest: (k, 3) of the control points [m].
    """
    points = material_points(body, rest, grid.points(voxels))
    slope, slack = np.zeros((len(voxels), len(rest))), np.empty((len(voxels), 3))
    for group in points.groups:
        f = along[group.rows]
        slope[np.ix_(group.rows, group.points)] = np.einsum("nja,na->nj", group.gradient, f)
        slack[group.rows] = np.einsum("nra,na->nr", group.slack, f)
    sample = _alike(slope, most)
    count = np.bincount(sample)
    mean = sparse.csr_array((1 / count[sample], (sample, np.arange(len(sample)))))
    change = 0.5 * grid.spacing.min() * sparse.csr_array(mean @ slope)
    shift = 0.5 * grid.spacing.min() * (mean @ slack)
    weights, offset = sparse.csr_array(mean @ points.weights), mean @ points.offset
    order = np.arange(2 * len(count)).reshape(2, -1).T.ravel()  # from all a and all b to pairs
    ends = sparse.csr_array(sparse.vstack([weights - change, weights + change]))[order]
    volume = np.asarray(count * grid.cell_volume, np.float64)
    return Segments(ends, np.concatenate([offset - shift, offset + shift])[order], volume)


def _alike(slope: NDArray[np.float64], most: int) -> NDArray[np.int64]:
    """The sample (n,) of voxels with slopes d_j (n, k), by k-means of random projections, which keep distances."""
    n, k = slope.shape
    seen = slope @ np.random.default_rng(0).normal(size=(k, min(k, SKETCH)))
    first = seen[np.unique(np.linspace(0, n - 1, min(n, most)).astype(int))]
    with warnings.catch_warnings(action="ignore", category=UserWarning):  # of samples that no voxel is left in
        _, sample = kmeans2(seen, first, iter=ROUNDS, minit="matrix")
    return np.unique(sample, return_inverse=True)[1].astype(np.int64)
