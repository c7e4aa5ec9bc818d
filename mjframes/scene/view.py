"""Soft bodies of a compiled model, as they are now: read from the model and data, and what is not in them, of
material points and frames, from the `SoftBody`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from mjframes.base.errors import MjframesError
from mjframes.base.packing import triangles
from mjframes.body.soft_body import SoftBody
from mjframes.elasticity.corotational import CorotationalRegion, LawCell
from mjframes.elasticity.hyperelastic import HyperelasticRegion
from mjframes.elasticity.laws import LawParameters, law_of_constants
from mjframes.elasticity.shares import scaled
from mjframes.scene import forces, scaling
from mjframes.scene.identity import asset_key, recall
from mjframes.scene.instability import GROWN, spread, warn
from mjframes.scene.load import require_state
from mjframes.scene.material_points import MaterialPoints, material_points
from mjframes.scene.plugin_text import ATTRIBUTES, decode, decode_slopes, rows_of, soft_name

SHOWN = 0.5  # [-] det F at rest, which is 1 unless a region's points lie in a plane
SAME_MASS = 1e-4  # [-] as in plugin/soft_body.cc: the model's masses have six digits


@dataclass(frozen=True, eq=False)
class Soft:
    """What a soft body of a scene does, as `soft` returns it.

    It is current after `mj_forward` or `mj_step`. The body has k control points, f frames, r regions and p patches.
    Material points (n, 3) are in volume coordinates [m]. They and frames need the `SoftBody`: without it they raise
    MjframesError. If the body is 1.5 times as large as at rest or a region is folded over, reading it warns once
    (InstabilityWarning). You rarely make one yourself.

    Parameters
    ----------
    model, data
        The compiled model and its data.
    name
        Name of the soft body.
    instance
        Number of its plugin instance.
    holder
        MuJoCo body whose axes are the volume's.
    bodies
        MuJoCo body (k,) that each control point rides on.
    configuration
        Attributes of the plugin instance, as text.
    given
        The `SoftBody` that it was built as, or None.
    """

    model: mujoco.MjModel
    data: mujoco.MjData
    name: str
    instance: int
    holder: int
    bodies: np.ndarray
    configuration: dict[str, str]
    given: SoftBody | None = None
    _untold: set[str] = field(default_factory=lambda: {"size", "fold"})
    _of_points: dict[bytes, MaterialPoints] = field(default_factory=dict)
    _of_factors: dict[bytes, list[CorotationalRegion] | list[HyperelasticRegion]] = field(default_factory=dict)

    @property
    def damping(self) -> tuple[float, float]:
        """Return Rayleigh's α [1/s] and β [s], as it was built."""
        return float(self.configuration["alpha"]), float(self.configuration["beta"])

    @cached_property
    def rest(self) -> np.ndarray:
        """Return x̄ (k, 3) in volume coordinates [m]."""
        return decode(self.configuration["point_rest"]).reshape(-1, 3)

    @cached_property
    def regions(self) -> list[CorotationalRegion] | list[HyperelasticRegion]:
        """Return the elastic regions, as stiff as they were built; their control points are numbered as here."""
        if "quadrature_count" not in self.configuration:
            gradients = np.split(decode(self.configuration["region_gradient"]).reshape(-1, 3), self._ends)
            matrices = triangles(decode(self.configuration["region_stiffness"]), 3 * self._sizes)
            cells = self._cells_of(self._laws if "law_constants" in self.configuration else ())
            parts = zip(self._points, gradients, matrices, cells, strict=True)
            stiffens = "region_stiffens" in self.configuration
            return [
                CorotationalRegion(points, self.rest[points], gradient, matrix, own, stiffens)
                for points, gradient, matrix, own in parts
            ]
        laws = self._laws
        count = decode(self.configuration["quadrature_count"]).astype(int)
        ends = np.cumsum(count)[:-1]
        volumes = np.split(decode(self.configuration["quadrature_volume"]), ends)
        materials = np.split(decode(self.configuration["quadrature_material"]), ends)
        sizes = 3 * count * self._sizes
        gradients = np.split(decode(self.configuration["quadrature_gradient"]), np.cumsum(sizes)[:-1])
        return [
            HyperelasticRegion(points, gradient.reshape(-1, len(points), 3), volume, material, laws)
            for points, gradient, volume, material in zip(self._points, gradients, volumes, materials, strict=True)
        ]

    @cached_property
    def mean_gradients(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return the control points (m,) of each region and its mean gradients g (m, 3) [1/m]: F = Σ_j x_j g_jᵀ."""
        return [
            (region.points, np.average(region.gradient, axis=0, weights=region.volume))
            if isinstance(region, HyperelasticRegion)
            else (region.points, region.gradient)
            for region in self.regions
        ]

    def _scaled_regions(self, factors: np.ndarray) -> list[CorotationalRegion] | list[HyperelasticRegion]:
        """With factors (M,) of the materials' moduli."""
        laws = ()
        if "law_constants" in self.configuration:
            follows = self._array("law_factor", len(self._laws)).astype(int)
            laws = tuple(law.scaled(float(factors[i])) for law, i in zip(self._laws, follows, strict=True))
        if "quadrature_count" in self.configuration:
            return [replace(region, laws=laws) for region in self.regions if isinstance(region, HyperelasticRegion)]
        return [
            replace(region, stiffness=scaled(region.stiffness, shares, factors), cells=cells)
            for region, shares, cells in zip(self.regions, self._shares, self._cells_of(laws), strict=True)
            if isinstance(region, CorotationalRegion)
        ]

    @cached_property
    def _shares(self) -> list[np.ndarray]:
        """(M − 1, 3o, 3m) of each region, see elasticity/shares.py."""
        count = int(self.configuration["materials"]) - 1
        own, width = 3 * decode(self.configuration["region_own"]).astype(int), 3 * self._sizes
        ends = np.cumsum(count * own * (2 * width - own + 1) // 2)[:-1]
        parts = np.split(decode(self.configuration["region_share"]), ends)
        return [rows_of(part, count, int(o), int(n)) for part, o, n in zip(parts, own, width, strict=True)]

    @property
    def _elastic(self) -> tuple[float, list[CorotationalRegion] | list[HyperelasticRegion]]:
        """What energies and forces of which regions are to be multiplied by: as the step works with."""
        factors = self._factors
        if (factors == factors[0]).all():
            return float(factors[0]), self.regions
        if factors.tobytes() not in self._of_factors:
            self._of_factors.clear()
            self._of_factors[factors.tobytes()] = self._scaled_regions(factors)
        return 1.0, self._of_factors[factors.tobytes()]

    @property
    def _laws(self) -> tuple[LawParameters, ...]:
        """Of each material."""
        constants = decode(self.configuration["law_constants"]).reshape(-1, 3)
        return tuple(law_of_constants(self.configuration["law"], some) for some in constants.tolist())

    def _cells_of(self, laws: tuple[LawParameters, ...]) -> list[tuple[LawCell, ...]]:
        """Of each region.  laws: of each material."""
        if "cell_count" not in self.configuration:
            return [()] * len(self._sizes)
        count = decode(self.configuration["cell_count"]).astype(int)
        ends = np.cumsum(count)[:-1]
        volumes, materials = (np.split(decode(self.configuration[f"cell_{s}"]), ends) for s in ("volume", "material"))
        slopes = decode_slopes(self.configuration["cell_slope"], count, self._sizes)
        return [
            tuple(LawCell(float(v), laws[int(number)], slope) for v, number, slope in zip(*some, strict=True))
            for some in zip(volumes, materials, slopes, strict=True)
        ]

    @cached_property
    def _sizes(self) -> np.ndarray:
        return decode(self.configuration["region_size"]).astype(int)

    @property
    def _ends(self) -> np.ndarray:
        return np.cumsum(self._sizes)[:-1]

    @cached_property
    def _points(self) -> list[np.ndarray]:
        return np.split(decode(self.configuration["region_point"]).astype(int), self._ends)

    @property
    def mass_difference(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return consistent minus lumped mass: each region's control points (m,) and (m, m) [kg]; none if lumped."""
        scale = self._mass_scale
        if (scale == 1).all():
            return self._built_difference
        return [(points, scale[points] * scale[points, None] * built) for points, built in self._built_difference]

    @cached_property
    def _built_difference(self) -> list[tuple[np.ndarray, np.ndarray]]:
        if "region_mass" not in self.configuration:
            return []
        matrices = triangles(decode(self.configuration["region_mass"]), self._sizes)
        return list(zip(self._points, matrices, strict=True))

    @property
    def _mass_scale(self) -> np.ndarray:
        """(k,) √ of the mass of each point's body, to that it was built with [-]; as in plugin/soft_body.cc."""
        built = np.bincount(self.bodies, self._built_mass)[self.bodies]
        ratio = self.model.body_mass[self.bodies] / built
        changed = (abs(ratio - 1) > SAME_MASS) & (ratio > 0) & np.isfinite(ratio)  # the plugin warns of the others
        return np.sqrt(np.where(changed, ratio, 1))

    @cached_property
    def _built_mass(self) -> np.ndarray:
        return decode(self.configuration["point_mass"])

    @cached_property
    def offset(self) -> np.ndarray:
        """Return the offset (k, 3) of each control point in its body's axes [m]."""
        return self._array("point_offset", 3 * len(self.bodies)).reshape(-1, 3)

    @property
    def mass(self) -> np.ndarray:
        """Return the mass (k,) of each control point [kg]."""
        return self._mass_scale**2 * self._built_mass

    @property
    def control_positions(self) -> np.ndarray:
        """Return x (k, 3) in the world [m]."""
        if self._untold:
            self._look()
        return self._positions

    @property
    def _positions(self) -> np.ndarray:
        return self.data.xpos[self.bodies] + self._arms()

    @property
    def size_ratio(self) -> float:
        """Return the root mean square distance of the mass from its centre, to that at rest [-]."""
        return spread(self._built_mass, self._positions) / self._size

    @cached_property
    def _size(self) -> float:
        return spread(self._built_mass, self.rest)

    @property
    def is_folded(self) -> bool:
        """Return whether det F < 0 for the mean gradient of some region."""
        return bool((np.linalg.det((self._mean_slopes @ self._positions).reshape(-1, 3, 3)) < 0).any())

    @cached_property
    def _mean_slopes(self) -> np.ndarray:
        """(3r, k): what makes Fᵀ of x, of each region whose mean gradient shows all of F."""
        slopes = np.zeros((len(self.mean_gradients), 3, len(self.bodies)))
        for slope, (points, gradient) in zip(slopes, self.mean_gradients, strict=True):
            slope[:, points] = gradient.T
        shows = np.linalg.det(slopes @ self.rest) > SHOWN
        return slopes[shows].reshape(-1, len(self.bodies))

    def quiet(self) -> Soft:
        """Return this view, which from now on warns of nothing: for who looks at sizes and folds, or makes them."""
        self._untold.clear()
        return self

    def _look(self) -> None:
        """Warn of what has not been told yet."""
        if "size" in self._untold and self.size_ratio > GROWN:
            self._untold.discard("size")
            warn(f"{self.name!r} is more than {GROWN:g} times as large as at rest")
        if "fold" in self._untold and self.is_folded:
            self._untold.discard("fold")
            warn(f"{self.name!r} is folded over, inside out, in some region")

    @property
    def control_velocities(self) -> np.ndarray:
        """Return dx/dt (k, 3) in the world [m/s]."""
        velocity, twist = np.zeros((len(self.bodies), 3)), np.zeros(6)
        for j, (body, arm) in enumerate(zip(self.bodies, self._arms(), strict=True)):
            mujoco.mj_objectVelocity(self.model, self.data, mujoco.mjtObj.mjOBJ_XBODY, int(body), twist, 0)
            velocity[j] = twist[3:] + np.cross(twist[:3], arm)
        return velocity

    def _arms(self) -> np.ndarray:
        """From each body's origin to its control point, in the world (k, 3) [m]."""
        return np.einsum("kab,kb->ka", self.data.xmat[self.bodies].reshape(-1, 3, 3), self.offset)

    def _array(self, key: str, size: int) -> np.ndarray:
        """An array that is left out where it is zero."""
        return decode(self.configuration[key]) if key in self.configuration else np.zeros(size)

    @property
    def elastic_energy(self) -> float:
        """Return the elastic energy [J]."""
        return self.elastic_energy_at(self.control_positions)

    def elastic_energy_at(self, x: np.ndarray) -> float:
        """Return the elastic energy with the control points at x (k, 3), turned and moved in any way [J]."""
        factor, regions = self._elastic
        return factor * sum(region.energy(x[region.points]) for region in regions)

    @property
    def kinetic_energy(self) -> float:
        """Return ½ Σ_jk M_jk v_j · v_k of the soft body's own mass [J]."""
        return 0.5 * float(np.sum(self.control_velocities * self.control_momenta))

    @property
    def kinetic_difference(self) -> float:
        """Return how much of the kinetic energy MuJoCo's bodies, which have the point masses alone, do not have [J]."""
        return self.kinetic_energy - 0.5 * float(self.mass @ (self.control_velocities**2).sum(axis=1))

    @property
    def linear_momentum(self) -> np.ndarray:
        """Return the linear momentum of the soft body's own mass (3,), in the world [kg m/s]."""
        return self.control_momenta.sum(axis=0)

    @property
    def angular_momentum(self) -> np.ndarray:
        """Return the angular momentum of the soft body's own mass about the world's origin (3,) [kg m²/s].

        MuJoCo's own, `subtree_angmom`, knows the masses of bodies only, which is not all of a consistent mass matrix.
        """
        return np.cross(self.control_positions, self.control_momenta).sum(axis=0)

    @property
    def control_momenta(self) -> np.ndarray:
        """Return Σ_k M_jk v_k (k, 3) of the control points, in the world [kg m/s]."""
        velocity = self.control_velocities
        momentum = self.mass[:, None] * velocity
        for points, difference in self.mass_difference:
            momentum[points] += difference @ velocity[points]
        return momentum

    @property
    def elastic_forces(self) -> np.ndarray:
        """Return the elastic forces (k, 3) on the control points, in the world [N]."""
        x, forces = self.control_positions, np.zeros((len(self.bodies), 3))
        factor, regions = self._elastic
        for region in regions:
            forces[region.points] += region.response(x[region.points])[0]
        return factor * forces

    def positions(self, points: ArrayLike) -> np.ndarray:
        """Return the positions (n, 3) of material points, in the world [m]."""
        return self.data.xpos[self.holder] + self._at(points).positions(self._elastic[1], self._local) @ self._axes.T

    def velocities(self, points: ArrayLike) -> np.ndarray:
        """Return the velocities (n, 3) of material points, in the world [m/s]."""
        some, twist = self._at(points), np.zeros(6)
        mujoco.mj_objectVelocity(self.model, self.data, mujoco.mjtObj.mjOBJ_XBODY, self.holder, twist, 0)
        arms = self.control_positions - self.data.xpos[self.holder]
        carried = np.asarray(np.cross(twist[:3], arms), np.float64)
        own = (self.control_velocities - twist[3:] - carried) @ self._axes  # as the holder sees it
        seen = some.velocities(self._elastic[1], self._local, own) @ self._axes.T
        away = some.positions(self._elastic[1], self._local) @ self._axes.T
        return twist[3:] + np.cross(twist[:3], away) + seen

    def apply_force(self, points: ArrayLike, forces: ArrayLike) -> None:
        """Add forces (n, 3), in the world [N], on material points (n, 3) to the data's `qfrc_applied`.

        As with MuJoCo's own `mj_applyFT` they act in every step until `qfrc_applied` is set again.
        Raise MjframesError for forces of another shape, and for points that are not of the material.
        """
        some, force = self._at(points), np.asarray(forces, np.float64)
        if force.shape != some.offset.shape:
            raise MjframesError(f"forces have the shape {force.shape}; give one (x, y, z) in newtons for each point.")
        if not np.isfinite(force).all():
            raise MjframesError("forces has numbers that are not finite; give newtons.")
        on_points = some.control_forces(self._elastic[1], self._local, force @ self._axes) @ self._axes.T
        for body, at, push in zip(self.bodies.tolist(), self.control_positions, on_points, strict=True):
            mujoco.mj_applyFT(self.model, self.data, push, np.zeros(3), at, body, self.data.qfrc_applied)
        torque = np.cross(some.offset @ self._axes.T, force).sum(
            axis=0
        )  # of point frames, which do not turn themselves
        at = self.data.xpos[self.holder]
        mujoco.mj_applyFT(self.model, self.data, np.zeros(3), torque, at, self.holder, self.data.qfrc_applied)

    def deformation_gradients(self, points: ArrayLike) -> np.ndarray:
        """Return F (n, 3, 3) at material points: from volume coordinates to the world, the body's rotation included."""
        return self._axes @ self._at(points).deformation_gradients(self._elastic[1], self._local)

    def strains(self, points: ArrayLike) -> np.ndarray:
        """Return Green's strain ½ (Fᵀ F − I) (n, 3, 3) at material points, in the volume's axes.

        Of slopes of positions; stresses have strains of their own, which are smoother.
        """
        F = self.deformation_gradients(points)
        return 0.5 * (F.transpose(0, 2, 1) @ F - np.eye(3))

    def stresses(self, points: ArrayLike) -> np.ndarray:
        """Return Cauchy's stress (n, 3, 3) at material points, in the world's axes [Pa].

        Elastic stress, without damping, recovered from finite elements: sections carry the loads on them, but for the
        layer of voxels beside a held piece or another material, and places where loads act.
        """
        some = self._at(points)
        stress = self._factors[some.factor, None, None] * some.response(self._elastic[1], self._local)[0]
        return self._axes @ stress @ self._axes.T

    def energy_densities(self, points: ArrayLike) -> np.ndarray:
        """Return the strain energy per volume at rest (n,) at material points [J/m³].

        `elastic_energy` has more where a body is folded far: what its regions hold against turning
        (κ of `mjframes.elasticity.corotational`), which is of no point of the material.
        """
        some = self._at(points)
        return self._factors[some.factor] * some.response(self._elastic[1], self._local)[1]

    @property
    def materials(self) -> dict[int, str]:
        """Return the names, by label, of the materials that deform, in the order of the numeric `steak:stiffness`."""
        return scaling.materials(self.model, self.name)

    @property
    def _factors(self) -> np.ndarray:
        """(M,) of the moduli that `regions` have, in this model [-]."""
        return scaling.stiffness(self.model, self.name, int(self.configuration.get("materials", "1")))

    @property
    def frame_forces(self) -> np.ndarray:
        """Return the elastic force on each frame, the sum over its control points (f, 3), in the world [N]."""
        frame, total = self.body.control.frame, np.zeros((len(self.body.types), 3))
        np.add.at(total, frame, self.elastic_forces)
        return total

    @property
    def constraint_forces(self) -> np.ndarray:
        """Return the net force of constraints on each frame and what was put on its bodies (f, 3), in the world [N].

        NaN for held frames: theirs is part of the force on what holds them.
        """
        return self._on_frames(self.data.qfrc_constraint)

    @property
    def contact_forces(self) -> np.ndarray:
        """Return the net force of contacts on each frame, shared by the weights there (f, 3), in the world [N].

        Their sum is the contact force on the body. A held frame has what the moving ones leave of it; several of them
        share that by their weights at the nearest contact vertex.
        """
        rows = forces.rows_of(self.model, self.data, self.patches)
        found = self._on_frames(forces.constraint_force(self.model, self.data, rows))
        held = self.body.held
        if held == 1:
            found[0] = self.patch_forces.sum(axis=0) - found[1:].sum(axis=0)
        elif held > 1:
            found[:held] = self._on_held(list(forces.touches_of(self.model, self.data, self.patches)), held)
        return found

    def _on_held(self, touches: Sequence[forces.Touch], held: int) -> np.ndarray:
        """Of contacts on the first frames (held, 3), in the world [N]."""
        vertices, frame = self.body.contact, self.body.control.frame
        places = vertices.weights @ self.control_positions
        total = np.zeros((held, 3))
        for touch in touches:
            moving = self._on_frames(forces.constraint_force(self.model, self.data, touch.rows))[held:].sum(axis=0)
            nearest = int(np.argmin(((places - touch.position) ** 2).sum(axis=1)))
            share = np.bincount(frame, vertices.weights[[nearest]].toarray()[0])[:held].clip(1e-12)
            total += np.outer(share / share.sum(), touch.force - moving)
        return total

    @property
    def patch_forces(self) -> np.ndarray:
        """Return the net contact force on each patch (p, 3), in the world [N]."""
        return forces.forces_on_geoms(self.model, self.data, self.patches)

    @property
    def patches(self) -> np.ndarray:
        """Return the geoms (p,) of the contact patches."""
        owner = self.model.body_plugin[self.model.geom_bodyid]
        return np.flatnonzero((self.model.geom_plugin >= 0) & (owner == self.instance))

    @cached_property
    def body(self) -> SoftBody:
        """Return what was built.

        Raise MjframesError where it was not given and is not known in this process: it was not attached here, or
        nothing of the program has kept it.
        """
        body = self.given or recall(self.configuration["asset"])
        if body is None:
            raise MjframesError(
                f"the model has no voxels of {self.name!r}, and its SoftBody was not attached in this process, or is "
                f"gone; keep it, and give it: soft(model, data, {self.name!r}, body=…)."
            )
        return body

    @property
    def _axes(self) -> np.ndarray:
        """A (3, 3): from the volume's axes to the world's."""
        return self.data.xmat[self.holder].reshape(3, 3)

    @property
    def _local(self) -> np.ndarray:
        """x (k, 3) in volume coordinates, as seen from the holder [m]."""
        return (self.control_positions - self.data.xpos[self.holder]) @ self._axes

    def _at(self, points: ArrayLike) -> MaterialPoints:
        """What is known of material points; kept for those asked for last, as the voxels are searched for them."""
        key = np.asarray(points, np.float64).tobytes()
        if key not in self._of_points:
            found = material_points(self.body, self.rest, points)
            self._of_points.clear()
            self._of_points[key] = found
        return self._of_points[key]

    def _on_frames(self, generalized: np.ndarray) -> np.ndarray:
        return forces.forces_on_frames(self.model, self.data, self.bodies, self.body.control.frame, generalized)


def soft(model: mujoco.MjModel, data: mujoco.MjData, name: str, body: SoftBody | None = None) -> Soft:
    """Read back what a soft body of a scene does: positions, forces, energies, strains.

    Parameters
    ----------
    model, data
        The compiled model and its data.
    name
        Name of the soft body.
    body
        The `SoftBody` that was attached. Material points and frames need it if it was not attached in this process.

    Returns
    -------
    Soft
        The view. It follows `data`.

    Raises
    ------
    MjframesError
        If the model has no soft body of that name, or it was made of another body, or `data` is not of the model.
    """
    require_state(model, data)
    instance = instance_of(model, name)
    configuration = _configuration(model, instance)
    carriers = np.flatnonzero(model.body_plugin == instance)
    bodies = np.empty(decode(configuration["point_mass"]).size, int)
    bodies[decode(configuration["carrier_point"])] = np.repeat(carriers, decode(configuration["carrier_size"]))
    if body is not None and asset_key(body) != configuration["asset"]:
        raise MjframesError(f"body is not the one that {name!r} was made of; give the SoftBody that was attached.")
    moving = carriers[model.body_jntnum[carriers] > 0]
    return Soft(model, data, name, instance, int(model.body_parentid[moving.min()]), bodies, configuration, body)


def soft_names(model: mujoco.MjModel) -> list[str]:
    """Return the names of the model's soft bodies."""
    return list(_instances(model))


def instance_of(model: mujoco.MjModel, name: str) -> int:
    """Return the plugin instance of soft body `name`. Raise MjframesError where the model has none of that name."""
    instances = _instances(model)
    if name not in instances:
        known = ", ".join(map(repr, instances)) or "none"
        raise MjframesError(f"name is {name!r} but the model's soft bodies are: {known}.")
    return instances[name]


def _instances(model: mujoco.MjModel) -> dict[str, int]:
    """Plugin instances that carry control points, by name."""
    found, place = {}, ATTRIBUTES.index("point_rest")
    for instance in np.unique(model.body_plugin[model.body_plugin >= 0]):
        if _attributes(model, int(instance)).split(b"\0", place + 1)[place]:
            start = model.name_pluginadr[instance]
            found[soft_name(model.names[start:].split(b"\0", 1)[0].decode())] = int(instance)
    return found


def _configuration(model: mujoco.MjModel, instance: int) -> dict[str, str]:
    """The attributes of a plugin instance, by key."""
    values = _attributes(model, instance).split(b"\0")
    return {key: value.decode() for key, value in zip(ATTRIBUTES, values, strict=False) if value}


def _attributes(model: mujoco.MjModel, instance: int) -> bytes:
    """Those of a plugin instance: "value\\0" for each of the plugin's attributes, in their order."""
    start = model.plugin_attradr[instance]
    following = model.plugin_attradr[model.plugin_attradr > start]
    end = following.min() if len(following) else len(model.plugin_attr)
    return bytes(model.plugin_attr[start:end])
