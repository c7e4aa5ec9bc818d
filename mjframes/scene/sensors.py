"""Sensors of a soft body, written into a spec: observations that MuJoCo computes itself (plugin/sensor.h)."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from mjframes.base.errors import MjframesError
from mjframes.body.soft_body import SoftBody
from mjframes.scene import plugin
from mjframes.scene.identity import asset_key
from mjframes.scene.material_points import MaterialPoints, material_points
from mjframes.scene.plugin_text import decode, encode, soft_name

WHOLE = ("elastic_energy", "kinetic_energy", "contact_force")  # 1, 1 and 3 values
OF_MATERIAL = ("energy_density", "stress", "strain", "deformation_gradient")  # 1, 6, 6 and 9 values a point
PLACES = ("position", "velocity")  # 3 values a point
OF_POINTS = OF_MATERIAL + PLACES
SLACK = 1e-9  # [-] of F: below it is rounding


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
    if quantity not in WHOLE + OF_POINTS:
        raise MjframesError(f"quantity is {quantity!r}; it must be one of {', '.join(map(repr, WHOLE + OF_POINTS))}.")
    if (points is None) != (quantity in WHOLE):
        wanted = "is of the whole body: give no points" if quantity in WHOLE else "needs points, (n, 3) in metres"
        raise MjframesError(f"the sensor {quantity!r} {wanted}.")
    plugin.load()
    instances = {soft_name(other.name): other for other in spec.plugins if other.plugin_name == plugin.NAME}
    if name not in instances:
        known = ", ".join(map(repr, instances)) or "none"
        raise MjframesError(f"name is {name!r} but the spec's soft bodies are: {known}.")
    soft = dict(instances[name].config)
    if soft["asset"] != asset_key(body):
        raise MjframesError(f"body is not the one that {name!r} was made of; give the SoftBody that was attached.")
    own = sensor_name or f"{name}_{quantity}"
    if any(own == other.name for other in (*spec.sensors, *spec.plugins)):
        raise MjframesError(f"sensor_name is {own!r}, which the spec has already; give another one.")
    config = {"quantity": quantity}
    if points is not None:
        at = material_points(body, decode(soft["point_rest"]).reshape(-1, 3), points)
        if not len(at.offset):
            raise MjframesError("points has no point; a sensor needs one or more.")
        config |= _places(at) if quantity in PLACES else _samples(at)
    kind = plugin.FORCE_SENSOR_NAME if quantity == "contact_force" else plugin.SENSOR_NAME
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


def _samples(at: MaterialPoints) -> dict[str, str]:
    """Of material points: what the plugin reads, point by point."""
    count = len(at.offset)
    region, slack = np.empty(count, int), np.empty((count, 3, 3))
    gradient: list[np.ndarray] = [np.zeros(0)] * count
    lift: list[np.ndarray] = [np.zeros(0)] * count
    for group in at.groups:
        region[group.rows], slack[group.rows] = group.region, group.slack
        for row, some, slope in zip(group.rows, group.gradient, group.mode_slope @ group.share, strict=True):
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


def _places(at: MaterialPoints) -> dict[str, str]:
    """Of material points: what the plugin reads for where they are, point by point."""
    count = len(at.offset)
    weights = at.weights.sorted_indices()
    region = np.empty(count, int)
    rise: list[np.ndarray] = [np.zeros(0)] * count
    for group in at.groups:
        region[group.rows] = group.region
        for row, some in zip(group.rows, group.mode @ group.share, strict=True):
            rise[row] = some.ravel()
    config = {
        "region": encode(region),
        "weight_size": encode(np.diff(weights.indptr)),
        "weight_point": encode(weights.indices),
        "weight": encode(weights.data),
    }
    if np.abs(at.offset).max() > 0:
        config["offset"] = encode(at.offset)
    if any(some.any() for some in rise):
        config["rise"] = encode(np.concatenate(rise))
    return config
