"""Observations of a soft body that MuJoCo computes itself, and where a model's arrays have them.

    x_f = Σ_k m_k x_k / Σ_k m_k     centre of a frame, over its control points; v_f likewise

Arrays may have any number of leading axes, as those of `mujoco.batch` do: a row gives the same bits alone and among
others. Index letters: k control point; f frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjframes.base.errors import MjframesError
from mjframes.body.soft_body import SoftBody
from mjframes.scene.plugin_text import SEPARATOR
from mjframes.scene.view import Soft

Array = NDArray[np.float64]
Addresses = NDArray[np.int64]

POSITION, VELOCITY, CENTRE, CONTACT = (
    mujoco.mjtSensor.mjSENS_FRAMEPOS,
    mujoco.mjtSensor.mjSENS_FRAMELINVEL,
    mujoco.mjtSensor.mjSENS_SUBTREECOM,
    mujoco.mjtSensor.mjSENS_CONTACT,
)
# of a contact sensor: its values are forces, one net force of all contacts
FORCE = [1 << mujoco.mjtConDataField.mjCONDATA_FORCE.value, 3, 1]


@dataclass(frozen=True, eq=False)
class Readings:
    """Where `sensordata` has what a soft body does.

    position, velocity: (k, 3) addresses of what moves each control point.
    centre, contact: (3,) addresses of the centre of mass and of the net force of contacts.
    frame: (k,) of each control point; share: (k,) of its frame's mass [-].
    """

    position: Addresses
    velocity: Addresses
    centre: Addresses
    contact: Addresses
    frame: NDArray[np.int64]
    share: Array

    def frame_positions(self, sensordata: Array) -> Array:
        """Return the centres (…, f, 3) of the frames, in the world [m]."""
        return self._mean(sensordata[..., self.position])

    def frame_velocities(self, sensordata: Array) -> Array:
        """Return the velocities (…, f, 3) of the frames' centres, in the world [m/s]."""
        return self._mean(sensordata[..., self.velocity])

    def centre_of_mass(self, sensordata: Array) -> Array:
        """Return the centre of mass (…, 3), in the world [m]."""
        return sensordata[..., self.centre]

    def contact_force(self, sensordata: Array) -> Array:
        """Return the net force (…, 3) of contacts on the body, held pieces included, in the world [N]."""
        return -sensordata[..., self.contact]  # MuJoCo has what the body pushes with

    def _mean(self, values: Array) -> Array:
        found = np.zeros((*values.shape[:-2], self.frame[-1] + 1, 3))
        for k, (frame, share) in enumerate(zip(self.frame, self.share, strict=True)):
            found[..., frame, :] += share * values[..., k, :]
        return found


def add_readings(spec: mujoco.MjSpec, name: str) -> None:
    """Give soft body `name` of a spec the sensors that `readings` looks for."""
    for body in spec.body(name).find_all("body"):
        for kind, word in ((POSITION, "position"), (VELOCITY, "velocity")):
            spec.add_sensor(name=f"{body.name}_{word}", type=kind, objtype=mujoco.mjtObj.mjOBJ_XBODY, objname=body.name)
    spec.add_sensor(name=f"{name}{SEPARATOR}centre", type=CENTRE, objtype=mujoco.mjtObj.mjOBJ_BODY, objname=name)
    spec.add_sensor(
        name=f"{name}{SEPARATOR}contact", type=CONTACT, objtype=mujoco.mjtObj.mjOBJ_XBODY, objname=name, intprm=FORCE
    )


def readings(view: Soft, body: SoftBody) -> Readings:
    """Return where the model of a view has the readings of its soft body, `body` as it was built.

    Raise MjframesError for a model without the sensors of `add_readings`.
    """
    model = view.model

    def address(kind: mujoco.mjtSensor, of: int) -> Addresses:
        found = np.flatnonzero((model.sensor_type == kind) & (model.sensor_objid == of))
        if not len(found):
            raise MjframesError(f"the model has no sensors of {view.name!r}; write them with add_readings(spec, name).")
        return model.sensor_adr[found[0]] + np.arange(3)

    mass = body.control.mass
    total = np.bincount(body.control.frame, mass)
    return Readings(
        np.array([address(POSITION, body) for body in view.bodies]),
        np.array([address(VELOCITY, body) for body in view.bodies]),
        address(CENTRE, view.holder),
        address(CONTACT, view.holder),
        body.control.frame.astype(np.int64),
        mass / total[body.control.frame],
    )
