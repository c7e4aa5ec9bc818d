"""Points of a soft body's material and their state (the paper, equation (3) and §5.2), in the soft body's own axes.

    x(p̄) = Σ_j W_j x_j + (p̄ − Σ_j W_j x̄_j)             0 in brackets where frames can turn
    F(p̄) = Σ_j x_j ∇W_jᵀ + (I − Σ_j x̄_j ∇W_jᵀ)
    ε = sym(Σ_j y_j ∇W_jᵀ), y_j = Rᵀ x_j − x̄_j           corotational strain, R of the point's region
    ψ = λ/2 (tr ε)² + μ ε : ε, σ = R (λ tr ε I + 2 μ ε) Rᵀ   or, for the other laws, ψ(F), σ = P Fᵀ / J

W_j are those that move the surfaces; ∇w_i is that of the nearest voxel, inside its region. Where a region is relaxed,
its material has adapted within it to be softer than this: what relaxation takes is not added back, and ψ is an upper
bound of its mean.
Index letters: n material point; j control point; r, s rows; a, b columns. The plugin's sensors compute the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from mjframes import laws
from mjframes.body import COROTATIONAL, SoftBody
from mjframes.errors import MjframesError
from mjframes.fields import EVEN
from mjframes.grid import Grid, evened, voxel_grid
from mjframes.hyperelastic import HyperelasticRegion
from mjframes.mechanics import CorotationalRegion
from mjframes.stiffness import shows_rotations
from mjframes.surfaces import closest_voxels, voxel_shares

Array = NDArray[np.float64]
Region = CorotationalRegion | HyperelasticRegion

OUTSIDE = 1.5  # [voxels] from the nearest voxel's centre along an axis: a point farther away is not of the material


@dataclass(frozen=True, eq=False)
class Group:
    """The material points of one region.

    rows: (s,) which ones.  region: its number.  points: (m,) its control points.  gradient: ∇W_j (s, m, 3) [1/m].
    slack: I − Σ_j x̄_j ∇W_jᵀ (s, 3, 3), 0 where all the region's frames can turn.
    """

    rows: NDArray[np.int64]
    region: int
    points: NDArray[np.int64]
    gradient: Array
    slack: Array


@dataclass(frozen=True, eq=False)
class MaterialPoints:
    """n points.  weights: W_j (n, k).  offset: p̄ − Σ_j W_j x̄_j (n, 3) [m].  groups: them all, by region.

    law: of the elasticity.  constants: (n, 3) of it there, Lamé's (λ, μ, 0) [Pa] for the corotational one.
    """

    weights: sparse.csr_array
    offset: Array
    groups: tuple[Group, ...]
    law: str
    constants: Array

    def deformation_gradients(self, x: Array) -> Array:
        """F (n, 3, 3) with the control points at x (k, 3) [m]."""
        F = np.empty((len(self.offset), 3, 3))
        for group in self.groups:
            F[group.rows] = np.einsum("jr,nja->nra", x[group.points], group.gradient) + group.slack
        return F

    def response(self, regions: Sequence[Region], x: Array) -> tuple[Array, Array]:
        """Cauchy stress σ (n, 3, 3) [Pa] and strain energy density ψ (n,) [J/m³]; regions: those of the soft body."""
        return self._corotational(regions, x) if self.law == COROTATIONAL else self._hyperelastic(x)

    def _corotational(self, regions: Sequence[Region], x: Array) -> tuple[Array, Array]:
        stress, energy = np.empty((len(self.offset), 3, 3)), np.empty(len(self.offset))
        for group in self.groups:
            region, lam, mu = regions[group.region], *self.constants[group.rows, :2].T
            assert isinstance(region, CorotationalRegion)
            own = x[group.points] - x[group.points].mean(axis=0)  # far from the origin digits would be lost
            R = region.rotation(own)
            y = own @ R - (region.rest - region.rest.mean(axis=0))
            slope = np.einsum("jr,nja->nra", y, group.gradient)
            strain = 0.5 * (slope + slope.transpose(0, 2, 1))
            trace = np.trace(strain, axis1=1, axis2=2)
            turned = (lam * trace)[:, None, None] * np.eye(3) + 2 * mu[:, None, None] * strain
            stress[group.rows] = R @ turned @ R.T
            energy[group.rows] = 0.5 * lam * trace**2 + mu * (strain**2).sum(axis=(1, 2))
        return stress, energy

    def _hyperelastic(self, x: Array) -> tuple[Array, Array]:
        F = self.deformation_gradients(x)
        stress, energy = np.empty_like(F), np.empty(len(F))
        kinds, kind = np.unique(self.constants, axis=0, return_inverse=True)
        for number, constants in enumerate(kinds.tolist()):
            rows = np.flatnonzero(kind.ravel() == number)
            law = laws.law_of_constants(self.law, constants)
            stress[rows], energy[rows] = laws.cauchy_stress(law, F[rows]), laws.energy(law, F[rows])
        return stress, energy


def material_points(body: SoftBody, rest: Array, points: ArrayLike) -> MaterialPoints:
    """The material at points (n, 3) in volume coordinates [m].

    rest: (k, 3) x̄_j as the model has them, of which six digits are left; gradients are put right for them.
    Raises MjframesError for points that are not (n, 3) numbers and for those outside the volume.
    """
    at = np.asarray(points, np.float64)
    if at.ndim != 2 or at.shape[1] != 3 or not np.isfinite(at).all():
        raise MjframesError(f"points have the shape {at.shape}; give (n, 3) finite volume coordinates in metres.")
    grid = voxel_grid(body.fields.volume)
    nearest = closest_voxels(grid, at)
    away = np.abs((at - grid.points(nearest)) @ grid.axes / grid.spacing).max(axis=1, initial=0)
    if (away > OUTSIDE).any():
        n = int(np.argmax(away))
        raise MjframesError(
            f"points[{n}] is {tuple(at[n].tolist())}, {away[n] - 0.5:.1f} voxels outside the volume; "
            "give points of the material, in volume coordinates in metres."
        )
    weights = body.shapes.at(grid, at, nearest)
    if body.law == COROTATIONAL:
        table = np.stack([grid.per_material("lam"), grid.per_material("mu"), np.zeros(len(grid.table))], axis=1)
    else:
        table = body.law_constants
    region = body.fields.region[nearest]
    metric = evened(grid) if body.fields.metric == EVEN else grid
    shares = sparse.csr_array(voxel_shares(grid, body.fields.weights, at, nearest) @ body.fields.weights)
    groups = tuple(
        _group(body, metric, rest, int(e), rows, at[rows], nearest[rows], shares[rows])
        for e in np.unique(region)
        for rows in [np.flatnonzero(region == e)]
    )
    return MaterialPoints(weights, at - weights @ rest, groups, body.law, table[grid.material[nearest]])


def _group(
    body: SoftBody,
    grid: Grid,
    rest: Array,
    region: int,
    rows: NDArray[np.int64],
    at: Array,
    nearest: NDArray[np.int64],
    shares: sparse.csr_array,
) -> Group:
    points = body.stiffness.points[region]
    frames = body.control.frame[points]
    frames = frames[np.sort(np.unique(frames, return_index=True)[1])]
    gradient = body.shapes.slopes(grid, nearest, frames, shares[:, frames].toarray(), at, body.fields.region)[1]
    if not any(body.types[i] == "point" for i in frames):
        gradient = shows_rotations(gradient, rest[points])
    return Group(rows, region, points, gradient, np.eye(3) - np.einsum("jr,nja->nra", rest[points], gradient))
