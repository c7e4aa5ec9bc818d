"""A soft body as an entity of dm_control's composer: MJCF that PyMJCF attaches, poses, random materials, observables.

    steak = SoftEntity(mf.build("models/steak.npz", frames=3), "steak", stiffness=distributions.Uniform(0.5, 2.0))
    arena.attach(steak)
    arena.mjcf_model.option.noslip_iterations = 0    # that solver does not see the step's elasticity

It floats free by joints of its own: attach it with `arena.attach`, not `add_free_entity`.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np
from dm_control import composer, mjcf
from dm_control.composer import variation
from dm_control.composer.observation import observable
from numpy.typing import ArrayLike, NDArray

from mjframes.base.errors import MjframesError
from mjframes.base.sampling import farthest_points
from mjframes.body.soft_body import SoftBody
from mjframes.elasticity.corotational import closest_rotation
from mjframes.scene.attach import attach
from mjframes.scene.contact import Contact
from mjframes.scene.links import quaternion as quaternion_of
from mjframes.scene.placing import place
from mjframes.scene.readings import Readings, add_readings, readings
from mjframes.scene.scaling import scale
from mjframes.scene.taxels import TaxelGrid, add_taxels
from mjframes.scene.view import Soft, soft

Array = NDArray[np.float64]
Random = np.random.RandomState
Varied = float | variation.Variation

POINTS = 16  # material points that are observed unless others are given: enough to see how a body is bent


class SoftEntity(composer.Entity):
    """A soft body; free, or with pieces that are `Fixed` where it is attached.

    What `initialize_episode` draws is given to the constructor as numbers, as `variation.Variation` or not at all:
    stiffness, a factor of all moduli, or one by material in a mapping, as `mf.scale` takes them; damping, two factors;
    position [m] and quaternion.
    """

    def _build(
        self,
        body: SoftBody | str | os.PathLike[str],
        name: str = "soft",
        *,
        contact: bool | Contact = True,
        points: ArrayLike | None = None,
        stiffness: Varied | Mapping[str, Varied] | None = None,
        damping: tuple[Varied, Varied] | None = None,
        position: Any = None,
        quaternion: Any = None,
        taxels: Mapping[str, TaxelGrid] | None = None,
    ) -> None:
        """Build the MJCF.

        body: a soft body, or its file.  contact: as `mf.attach` has it.
        points: (n, 3) that the observable `material_points` follows, in volume coordinates [m]; 16 that are spread over
        the surface unless given.
        taxels: grids on the surface whose pressures the observable `pressures` has, by the names of their sensors.
        """
        self._body = body if isinstance(body, SoftBody) else SoftBody.load(body)
        self._points = _spread(self._body.skin.vertices) if points is None else np.asarray(points, np.float64)
        self._varied = {"stiffness": stiffness, "damping": damping}
        self._position, self._quaternion = position, quaternion
        self._seen: Soft | None = None
        self._readings: Readings | None = None
        spec = mujoco.MjSpec()
        attach(spec, self._body, name, contact=contact)
        add_readings(spec, name)
        for sensor, grid in (taxels or {}).items():
            add_taxels(spec, self._body, name, grid, "pressure", sensor)
        spec.compile()
        self._mjcf_root = mjcf.from_xml_string(spec.to_xml())
        self._mjcf_root.model = name
        self._holder = self._mjcf_root.find("body", name)
        self._taxels = tuple(self._mjcf_root.find("sensor", sensor) for sensor in taxels or {})

    def _build_observables(self) -> SoftObservables:
        return SoftObservables(self)

    @property
    def mjcf_model(self) -> mjcf.RootElement:
        """Return the MJCF of the soft body."""
        return self._mjcf_root

    @property
    def body(self) -> SoftBody:
        """Return what was built."""
        return self._body

    @property
    def points(self) -> Array:
        """Return the material points (n, 3) that are observed, in volume coordinates [m]."""
        return self._points

    @property
    def taxels(self) -> tuple[mjcf.Element, ...]:
        """Return the sensors of the grids of taxels."""
        return self._taxels

    @property
    def full_name(self) -> str:
        """Return what the soft body is called in the whole model, for `mf.scale` and all else that takes names."""
        return self._holder.full_identifier

    def soft(self, physics: mjcf.Physics) -> Soft:
        """Return the view of it in a physics, see `mjframes.soft`."""
        model, data = physics.model.ptr, physics.data.ptr
        if self._seen is None or self._seen.model is not model or self._seen.data is not data:
            self._seen = soft(model, data, self.full_name, self._body)
            self._readings = readings(self._seen, self._body)
        return self._seen

    def readings(self, physics: mjcf.Physics) -> Readings:
        """Return where the arrays of a physics have what is observed."""
        self.soft(physics)
        assert self._readings is not None
        return self._readings

    def initialize_episode(self, physics: mjcf.Physics, random_state: Random) -> None:
        """Draw material and pose, of those that the constructor was given. Nothing adds up over episodes."""
        drawn = {key: variation.evaluate(some, random_state=random_state) for key, some in self._varied.items()}
        stiffness = drawn["stiffness"]
        single = stiffness if isinstance(stiffness, Mapping) else None
        common = None if isinstance(stiffness, Mapping) else stiffness
        scale(physics.model.ptr, self.full_name, common, materials=single, damping=drawn["damping"])
        if self._position is not None or self._quaternion is not None:
            pose = (variation.evaluate(some, random_state=random_state) for some in (self._position, self._quaternion))
            self.set_pose(physics, *pose)

    def get_pose(self, physics: mjcf.Physics) -> tuple[Array, Array]:
        """Return position (3,) [m] and quaternion (4,) of the volume's axes that fit all control points best."""
        view = self.soft(physics)
        share = view.mass / view.mass.sum()
        at, rest = share @ view.control_positions, share @ view.rest
        turn = closest_rotation((share[:, None] * (view.control_positions - at)).T @ (view.rest - rest))
        return at - turn @ rest, quaternion_of(turn)

    def set_pose(
        self, physics: mjcf.Physics, position: ArrayLike | None = None, quaternion: ArrayLike | None = None
    ) -> None:
        """Put the volume's coordinate system at a position [m], a quaternion in the world, undeformed and at rest.

        What is not given stays. Raise MjframesError for a soft body that is held.
        """
        if position is None or quaternion is None:
            physics.forward()  # kinematics of the pose that stays
            found = self.get_pose(physics)
            position, quaternion = (
                old if new is None else new for old, new in zip(found, (position, quaternion), strict=True)
            )
        place(physics.model.ptr, physics.data.ptr, self.full_name, np.asarray(position), np.asarray(quaternion))

    def get_velocity(self, physics: mjcf.Physics) -> tuple[Array, Array]:
        """Return the mean velocity (3,) [m/s], and the angular one (3,) [rad/s] that has the same angular momentum."""
        view = self.soft(physics)
        share = view.mass / view.mass.sum()
        arms = view.control_positions - share @ view.control_positions
        velocity = share @ view.control_velocities
        momentum = share @ np.cross(arms, view.control_velocities - velocity)
        inertia = np.eye(3) * np.sum(share * (arms**2).sum(1)) - (share[:, None] * arms).T @ arms
        return velocity, np.linalg.solve(inertia, momentum)

    def set_velocity(self, physics: mjcf.Physics, velocity: Any = None, angular_velocity: Any = None) -> None:
        """Raise MjframesError: a soft body starts at rest."""
        raise MjframesError(f"{self.full_name!r} is soft; set qvel of its joints, physics.bind(entity.joints).qvel.")

    @property
    def joints(self) -> list[mjcf.Element]:
        """Return the joints of the bodies that carry control points."""
        return self._mjcf_root.find_all("joint")


class SoftObservables(composer.Observables):
    """What may be observed of a soft body; disabled until enabled, as all observables are."""

    _entity: SoftEntity

    @composer.observable
    def frame_positions(self) -> observable.Observable:
        """The centres (f, 3) of the frames, in the world [m]."""
        return observable.Generic(lambda physics: self._entity.readings(physics).frame_positions(_sensed(physics)))

    @composer.observable
    def frame_velocities(self) -> observable.Observable:
        """Their velocities (f, 3) [m/s]."""
        return observable.Generic(lambda physics: self._entity.readings(physics).frame_velocities(_sensed(physics)))

    @composer.observable
    def material_points(self) -> observable.Observable:
        """The positions (n, 3) of the entity's material points, in the world [m]."""
        return observable.Generic(lambda physics: self._entity.soft(physics).positions(self._entity.points))

    @composer.observable
    def contact_force(self) -> observable.Observable:
        """The net force (3,) of contacts on it, held pieces included, in the world [N]."""
        return observable.Generic(lambda physics: self._entity.readings(physics).contact_force(_sensed(physics)))

    @composer.observable
    def pressures(self) -> observable.Observable:
        """The pressures (n,) on the taxels of all grids, one after the other [Pa]."""
        return observable.Generic(
            lambda physics: np.concatenate(
                [np.zeros(0), *(physics.bind(sensor).sensordata for sensor in self._entity.taxels)]
            )
        )


def _sensed(physics: mjcf.Physics) -> Array:
    return physics.data.sensordata


def _spread(vertices: Array) -> Array:
    """(POINTS, 3) of the vertices, each as far as can be from those before it."""
    first = int(np.argmax(np.linalg.norm(vertices - vertices.mean(axis=0), axis=1)))
    return vertices[farthest_points(vertices, [first], POINTS)].astype(np.float64)
