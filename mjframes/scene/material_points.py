"""Points of a soft body's material and their state (the paper, equation (3) and §5.2), in the soft body's own axes.

    x(p̄) = Σ_j W_j x_j + (p̄ − Σ_j W_j x̄_j) + R Φ T y     0 in brackets where frames can turn
    F(p̄) = Σ_j x_j ∇W_jᵀ + (I − Σ_j x̄_j ∇W_jᵀ) + R ∇Φ T y
    S = Σ_j y_j ḡ_jᵀ + Ψ T y / E, y_j = Rᵀ x_j − x̄_j         R of the point's region, Ψ T of whole_body/strains.py
    ψ = λ/2 (tr ε)² + μ ε : ε, σ = R (λ tr ε I + 2 μ ε) Rᵀ   ε = sym S; for the other laws ψ, σ = P Fᵀ / J at R (I + S)

W_j are those that move the surfaces, Φ T what the body moves beyond them (whole_body/modes.py), where that is known.
Stresses have strains of their own: slopes of W_j and Φ are not in equilibrium. Without them S is that of F above.
Slopes are those of the nearest voxel, inside its region and its material.
Index letters: n material point; j control point; r, s rows; a, b columns; q mode. The sensors compute the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from mjframes.base.choices import COROTATIONAL, EVEN
from mjframes.base.errors import MjframesError
from mjframes.body.soft_body import SoftBody
from mjframes.elasticity import laws
from mjframes.elasticity.corotational import CorotationalRegion
from mjframes.elasticity.hyperelastic import HyperelasticRegion
from mjframes.elasticity.shares import factor_of
from mjframes.elasticity.stiffness import shows_rotations
from mjframes.volume.grid import Grid, evened, voxel_grid
from mjframes.weights.interpolation import closest_voxels, voxel_shares
from mjframes.whole_body.modes import mode_slopes
from mjframes.whole_body.strains import SYMMETRIC, even_slope, held_voxels

Array = NDArray[np.float64]
Region = CorotationalRegion | HyperelasticRegion

OUTSIDE = 1.5  # [voxels] from the nearest voxel's centre along an axis: a point farther away is not of the material


@dataclass(frozen=True, eq=False)
class Group:
    """The material points of one region.

    rows: (s,) which ones.
    region: its number.
    points: (m,) its control points.
    rest: x̄_j (m, 3) [m].
    gradient: ∇W_j (s, m, 3) [1/m].
    slack: I − Σ_j x̄_j ∇W_jᵀ (s, 3, 3), 0 where all the region's frames can turn.
    mode: Φ (s, 3, q).
    mode_slope: ∇Φ (s, 3, 3, q) [1/m], derivatives in the third axis.
    share: T (q, 3m).
    even, strain, strain_share: ḡ_j (s, m, 3) [1/m], Ψ/E (s, 3, 3, p) [1/Pa] and its T (p, 3m) [Pa/m].
    """

    rows: NDArray[np.int64]
    region: int
    points: NDArray[np.int64]
    rest: Array
    gradient: Array
    slack: Array
    mode: Array
    mode_slope: Array
    share: Array
    even: Array
    strain: Array
    strain_share: Array

    @property
    def even_slack(self) -> Array:
        """Return I − Σ_j x̄_j ḡ_jᵀ (s, 3, 3)."""
        return np.eye(3) - np.einsum("jr,nja->nra", self.rest, self.even)

    def lifted(self, region: Region, x: Array) -> tuple[Array, Array]:
        """Return R (3, 3) and T y (q,) with the control points at x (k, 3); R is I where nothing turns along."""
        if not isinstance(region, CorotationalRegion):
            return np.eye(3), np.zeros(len(self.share))
        own, rest = _about_mean(x[self.points]), _about_mean(region.rest)
        R = region.rotation(own)
        return R, self.share @ (own @ R - rest).ravel()

    def strained(self, region: CorotationalRegion, x: Array) -> tuple[Array, Array]:
        """Return R (3, 3), and S (s, 3, 3) with F = R (I + S) but for a turn, with the control points at x (k, 3)."""
        own, rest = _about_mean(x[self.points]), _about_mean(region.rest)
        R = region.rotation(own)
        y = own @ R - rest
        return R, np.einsum("jr,nja->nra", y, self.even) + self.strain @ (self.strain_share @ y.ravel())

    def lifted_velocity(self, region: Region, x: Array, v: Array) -> Array:
        """Return d/dt R Φ T y (s, 3) while the control points move by v (k, 3) [m/s]."""
        if not isinstance(region, CorotationalRegion) or not len(self.share):
            return np.zeros((len(self.rows), 3))
        R, spin, z, lifted = self._turning(region, x)
        rate = np.tensordot(spin, v[self.points])
        change = self.share @ ((v[self.points] @ R) - np.cross(rate, z)).ravel()
        return (self.mode @ change + np.cross(rate, lifted)) @ R.T

    def lifted_forces(self, region: Region, x: Array, forces: Array) -> Array:
        """Return (m, 3) [N] on the region's points, with the power of `forces` (s, 3) [N] on R Φ T y."""
        if not isinstance(region, CorotationalRegion) or not len(self.share):
            return np.zeros((len(self.points), 3))
        R, spin, z, lifted = self._turning(region, x)
        own = forces @ R
        on_points = (self.share.T @ np.tensordot(self.mode, own, ((0, 1), (0, 1)))).reshape(-1, 3)
        torque = np.cross(lifted, own).sum(axis=0) - np.cross(z, on_points).sum(axis=0)
        return on_points @ R.T + np.tensordot(torque, spin, 1)

    def _turning(self, region: CorotationalRegion, x: Array) -> tuple[Array, Array, Array, Array]:
        """R (3, 3), how it turns with the points (3, m, 3) [1/m], z = Rᵀ x (m, 3) [m] and Φ T y (s, 3) [m]."""
        own, rest = _about_mean(x[self.points]), _about_mean(region.rest)
        R = region.rotation(own)
        z = own @ R
        return R, region.spin(own, R), z, self.mode @ (self.share @ (z - rest).ravel())


def _about_mean(points: Array) -> Array:
    """Far from the origin digits would be lost."""
    return points - points.mean(axis=0)


@dataclass(frozen=True, eq=False)
class MaterialPoints:
    """n points.

    weights: W_j (n, k).
    offset: p̄ − Σ_j W_j x̄_j (n, 3) [m].
    groups: them all, by region.
    law: of the elasticity.
    constants: (n, 3) of it there, Lamé's (λ, μ, 0) [Pa] for the corotational one.
    factor: (n,) which one of `SoftBody.deformable` the material there follows.
    """

    weights: sparse.csr_array
    offset: Array
    groups: tuple[Group, ...]
    law: str
    constants: Array
    factor: NDArray[np.int64]

    def positions(self, regions: Sequence[Region], x: Array) -> Array:
        """Return x(p̄) (n, 3) [m] with the control points at x (k, 3) [m].  regions: those of the soft body."""
        found = self.weights @ x + self.offset
        for group in self.groups:
            R, change = group.lifted(regions[group.region], x)
            found[group.rows] += (group.mode @ change) @ R.T
        return found

    def velocities(self, regions: Sequence[Region], x: Array, v: Array) -> Array:
        """Return dx(p̄)/dt (n, 3) [m/s] with the control points at x (k, 3) [m] and moving by v (k, 3) [m/s]."""
        found = self.weights @ v
        for group in self.groups:
            found[group.rows] += group.lifted_velocity(regions[group.region], x, v)
        return found

    def control_forces(self, regions: Sequence[Region], x: Array, forces: Array) -> Array:
        """Return (k, 3) [N] on control points at x (k, 3) [m], with the power of `forces` (n, 3) [N] on the points."""
        total = self.weights.T @ forces
        for group in self.groups:
            total[group.points] += group.lifted_forces(regions[group.region], x, forces[group.rows])
        return total

    def deformation_gradients(self, regions: Sequence[Region], x: Array) -> Array:
        """Return F (n, 3, 3) with the control points at x (k, 3) [m].  regions: those of the soft body."""
        F = np.empty((len(self.offset), 3, 3))
        for group in self.groups:
            R, change = group.lifted(regions[group.region], x)
            F[group.rows] = np.einsum("jr,nja->nra", x[group.points], group.gradient) + group.slack
            F[group.rows] += R @ (group.mode_slope @ change)
        return F

    def _strained(self, regions: Sequence[Region], x: Array) -> Array:
        """F (n, 3, 3) of which the stress is, where it is recovered."""
        F = self.deformation_gradients(regions, x)
        for group in self.groups:
            region = regions[group.region]
            if isinstance(region, CorotationalRegion):
                R, slope = group.strained(region, x)
                F[group.rows] = R @ (np.eye(3) + slope)
        return F

    def response(self, regions: Sequence[Region], x: Array) -> tuple[Array, Array]:
        """Return Cauchy stress σ (n, 3, 3) [Pa] and strain energy density ψ (n,) [J/m³]; regions: the soft body's."""
        return self._corotational(regions, x) if self.law == COROTATIONAL else self._hyperelastic(regions, x)

    def _corotational(self, regions: Sequence[Region], x: Array) -> tuple[Array, Array]:
        stress, energy = np.empty((len(self.offset), 3, 3)), np.empty(len(self.offset))
        for group in self.groups:
            region, lam, mu = regions[group.region], *self.constants[group.rows, :2].T
            assert isinstance(region, CorotationalRegion)
            R, slope = group.strained(region, x)
            strain = 0.5 * (slope + slope.transpose(0, 2, 1))
            trace = np.trace(strain, axis1=1, axis2=2)
            turned = (lam * trace)[:, None, None] * np.eye(3) + 2 * mu[:, None, None] * strain
            stress[group.rows] = R @ turned @ R.T
            energy[group.rows] = 0.5 * lam * trace**2 + mu * (strain**2).sum(axis=(1, 2))
        return stress, energy

    def _hyperelastic(self, regions: Sequence[Region], x: Array) -> tuple[Array, Array]:
        F = self._strained(regions, x)
        stress, energy = np.empty_like(F), np.empty(len(F))
        kinds, kind = np.unique(self.constants, axis=0, return_inverse=True)
        for number, constants in enumerate(kinds.tolist()):
            rows = np.flatnonzero(kind.ravel() == number)
            law = laws.law_of_constants(self.law, constants)
            stress[rows], energy[rows] = laws.cauchy_stress(law, F[rows]), laws.energy(law, F[rows])
        return stress, energy


def material_points(body: SoftBody, rest: Array, points: ArrayLike) -> MaterialPoints:
    """Return the material at points (n, 3) in volume coordinates [m].

    rest: (k, 3) x̄_j as the model has them, of which six digits are left; gradients are put right for them.
    Raise MjframesError for points that are not (n, 3) numbers and for those outside the volume.
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
    around = voxel_shares(grid, body.fields.weights, at, nearest)
    groups = tuple(
        _group(body, grid, rest, int(e), rows, at[rows], nearest[rows], sparse.csr_array(around[rows]))
        for e in np.unique(region)
        for rows in [np.flatnonzero(region == e)]
    )
    material = grid.material[nearest]
    factor = factor_of(grid.table)[material]
    return MaterialPoints(weights, at - weights @ rest, groups, body.law, table[material], factor)


def _group(
    body: SoftBody,
    grid: Grid,
    rest: Array,
    region: int,
    rows: NDArray[np.int64],
    at: Array,
    nearest: NDArray[np.int64],
    around: sparse.csr_array,
) -> Group:
    """around: (s, n) the voxels' shares in the points."""
    points = body.stiffness.points[region]
    frames = body.control.frame[points]
    frames = frames[np.sort(np.unique(frames, return_index=True)[1])]
    fields, metric, within = body.fields, grid, body.fields.region
    if fields.metric == EVEN:
        metric, within = evened(grid), within * np.int32(len(grid.table)) + grid.material
    share = sparse.csr_array(around @ fields.weights)[:, frames].toarray()
    gradient = body.shapes.slopes(metric, nearest, frames, share, at, within)[1]
    if not any(body.types[i] == "point" for i in frames):
        gradient = shows_rotations(gradient, rest[points])
    slack = np.eye(3) - np.einsum("jr,nja->nra", rest[points], gradient)
    if fields.lifting is None:
        mode, slope, share = np.zeros((len(rows), 3, 0)), np.zeros((len(rows), 3, 3, 0)), np.zeros((0, 3 * len(points)))
    else:
        share = fields.lifting.share[region]
        modes = fields.lifting.mode[:, :, : len(share)]
        mode = (around @ modes.reshape(len(modes), -1)).reshape(len(rows), 3, len(share))
        slope = mode_slopes(grid, modes, nearest, fields.region, within)
    recovered = _recovered(body, grid, region, rest[points], nearest) if fields.strains else (gradient, slope, share)
    return Group(rows, region, points, rest[points], gradient, slack, mode, slope, share, *recovered)


def _recovered(
    body: SoftBody, grid: Grid, region: int, rest: Array, nearest: NDArray[np.int64]
) -> tuple[Array, Array, Array]:
    """ḡ, Ψ/E and T of points next to voxels (s,) of a region with control points at rest (m, 3)."""
    fields = body.fields
    assert fields.strains is not None
    share = fields.strains.share[region]
    young = grid.per_material("young")
    if body.law != COROTATIONAL:
        young = np.array([laws.law_of_constants(body.law, some).hooke[0] for some in body.law_constants.tolist()])
    mode = fields.strains.mode[nearest, :, : len(share)] / young[grid.material[nearest], None, None]
    strain = mode[:, np.array(SYMMETRIC)]
    strains = ~held_voxels(grid, fields.seeds[: len(body.links)])[nearest]
    even = even_slope(body.stiffness.gradient[region], rest)
    return strains[:, None, None] * even, strain, share
