"""Sensors of a soft body, written into a spec: observations that MuJoCo computes itself (plugin/sensor.h)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjframes.base.errors import MjframesError
from mjframes.body.soft_body import SoftBody
from mjframes.scene import plugin
from mjframes.scene.identity import asset_key
from mjframes.scene.material_points import MaterialPoints, material_points
from mjframes.scene.plugin_text import decode, encode, soft_name, weight_attributes

Array = NDArray[np.float64]

SLACK = 1e-9  # [-] of F: below it is rounding


@dataclass(frozen=True)
class Quantity:
    """What a sensor measures.

    what: with its axes, for the documents.  unit: of its values.  values: how many there are, of each point.
    reads: what the plugin reads of material points, None for a quantity of the whole body.  plugin: that computes it.
    """

    what: str
    unit: str
    values: int
    reads: Callable[[MaterialPoints], dict[str, str]] | None = None
    plugin: str = plugin.SENSOR_NAME


def add_sensor(
    spec: mujoco.MjSpec,
    body: SoftBody,
    name: str,
    quantity: str,
    points: ArrayLike | None = None,
    sensor_name: str | None = None,
) -> mujoco.MjsSensor:
    """Add a sensor that measures a soft body to a spec.

    Parameters
    ----------
    spec
        The scene to change.
    body
        The soft body as it was attached.
    name
        Name of the soft body in the spec.
    quantity
        What to measure. Of the whole body: "elastic_energy" and "kinetic_energy" [J], and "contact_force", the sum of
        the contact forces on it, held pieces included, in the world's axes (3,) [N]. At each material point: "position"
        (3,) [m] and "velocity" (3,) [m/s] in the world's axes, "energy_density" [J/m³], Cauchy's "stress" (6,) in the
        world's axes [Pa] and Green's "strain" (6,) in the volume's axes [-], as xx, yy, zz, yz, xz, xy, and
        "deformation_gradient" (9,) from the volume's to the world's axes, row by row [-].
    points
        Material points (n, 3) in volume coordinates [m], for the quantities at points.
    sensor_name
        Name of the sensor. The default is `name_quantity`.

    Returns
    -------
    mujoco.MjsSensor
        MuJoCo's sensor. Its values follow each other point by point.

    Raises
    ------
    MjframesError
        For other quantities, if points are missing or outside the material, if the spec does not have the soft body or
        has another one of that name, and for a sensor name that is taken.
    """
    if quantity not in QUANTITIES:
        raise MjframesError(f"quantity is {quantity!r}; it must be one of {', '.join(map(repr, QUANTITIES))}.")
    measured = QUANTITIES[quantity]
    if (points is None) != (measured.reads is None):
        wanted = "needs points, (n, 3) in metres" if measured.reads else "is of the whole body: give no points"
        raise MjframesError(f"the sensor {quantity!r} {wanted}.")
    soft = soft_attributes(spec, body, name)
    config = {"quantity": quantity}
    if points is not None and measured.reads is not None:
        at = material_points(body, decode(soft["point_rest"]).reshape(-1, 3), points)
        if not len(at.offset):
            raise MjframesError("points has no point; a sensor needs one or more.")
        config |= measured.reads(at)
    return write_sensor(spec, name, sensor_name or f"{name}_{quantity}", measured.plugin, config)


def soft_attributes(spec: mujoco.MjSpec, body: SoftBody, name: str) -> dict[str, str]:
    """Return the attributes of a soft body's plugin instance.

    Raise MjframesError if the spec does not have the soft body, or has another one of that name.
    """
    plugin.load()
    instances = {soft_name(other.name): other for other in spec.plugins if other.plugin_name == plugin.NAME}
    if name not in instances:
        known = ", ".join(map(repr, instances)) or "none"
        raise MjframesError(f"name is {name!r} but the spec's soft bodies are: {known}.")
    soft = dict(instances[name].config)
    if soft["asset"] != asset_key(body):
        raise MjframesError(f"body is not the one that {name!r} was made of; give the SoftBody that was attached.")
    return soft


def write_sensor(spec: mujoco.MjSpec, name: str, own: str, kind: str, config: dict[str, str]) -> mujoco.MjsSensor:
    """Add a sensor of soft body `name`, called `own`, that a plugin computes.  Raise MjframesError for a taken name."""
    if any(own == other.name for other in (*spec.sensors, *spec.plugins)):
        raise MjframesError(f"sensor_name is {own!r}, which the spec has already; give another one.")
    spec.activate_plugin(kind)
    instance = spec.add_plugin(name=own, plugin_name=kind, active=True)
    instance.config = config
    sensor = spec.add_sensor(
        name=own, type=mujoco.mjtSensor.mjSENS_PLUGIN, objtype=mujoco.mjtObj.mjOBJ_BODY, objname=name
    )
    sensor.plugin.active = True
    sensor.plugin.plugin_name = kind
    sensor.plugin.name = own
    return sensor


def _slopes(at: MaterialPoints) -> dict[str, str]:
    """Of material points: what the plugin reads for how positions differ there, point by point."""
    return _samples(at, [(group.gradient, group.slack, group.mode_slope @ group.share) for group in at.groups])


def _strains(at: MaterialPoints) -> dict[str, str]:
    """Of material points: what the plugin reads for the strain that stress and energy are of, point by point."""
    return _samples(at, [(group.even, group.even_slack, group.strain @ group.strain_share) for group in at.groups])


def _samples(at: MaterialPoints, parts: list[tuple[Array, Array, Array]]) -> dict[str, str]:
    """parts: of each group, gradients (s, m, 3), what they lack of I (s, 3, 3), and slopes besides (s, 3, 3, 3m)."""
    count = len(at.offset)
    region, slack = np.empty(count, int), np.empty((count, 3, 3))
    gradient: list[np.ndarray] = [np.zeros(0)] * count
    lift: list[np.ndarray] = [np.zeros(0)] * count
    for group, (even, lacking, slopes) in zip(at.groups, parts, strict=True):
        region[group.rows], slack[group.rows] = group.region, lacking
        for row, some, slope in zip(group.rows, even, slopes, strict=True):
            gradient[row], lift[row] = some.ravel(), slope.ravel()
    config = {
        "region": encode(region),
        "gradient": encode(np.concatenate(gradient)),
        "constants": encode(at.constants),
    }
    if at.factor.any():
        config["factor"] = encode(at.factor)
    if np.abs(slack).max() > SLACK:
        config["slack"] = encode(slack)
    if any(some.any() for some in lift):
        config["lift"] = encode(np.concatenate(lift))
    return config


def place_attributes(at: MaterialPoints) -> dict[str, str]:
    """Of material points: what the plugin reads for where they are, point by point."""
    count = len(at.offset)
    weights = at.weights.sorted_indices()
    region = np.empty(count, int)
    rise: list[np.ndarray] = [np.zeros(0)] * count
    for group in at.groups:
        region[group.rows] = group.region
        for row, some in zip(group.rows, group.mode @ group.share, strict=True):
            rise[row] = some.ravel()
    config = {"region": encode(region)} | weight_attributes(weights)
    if np.abs(at.offset).max() > 0:
        config["offset"] = encode(at.offset)
    if any(some.any() for some in rise):
        config["rise"] = encode(np.concatenate(rise))
    return config


QUANTITIES = {
    "elastic_energy": Quantity("elastic energy", "J", 1),
    "kinetic_energy": Quantity("kinetic energy", "J", 1),
    "contact_force": Quantity(
        "sum of the contact forces on the body, in the world's axes", "N", 3, plugin=plugin.FORCE_SENSOR_NAME
    ),
    "energy_density": Quantity("elastic energy density", "J/m³", 1, _strains),
    "stress": Quantity("Cauchy's stress in the world's axes, as xx, yy, zz, yz, xz, xy", "Pa", 6, _strains),
    "strain": Quantity("Green's strain in the volume's axes, in the same order", "-", 6, _slopes),
    "deformation_gradient": Quantity("from the volume's to the world's axes, row by row", "-", 9, _slopes),
    "position": Quantity("position in the world's axes", "m", 3, place_attributes),
    "velocity": Quantity("velocity in the world's axes", "m/s", 3, place_attributes),
}
