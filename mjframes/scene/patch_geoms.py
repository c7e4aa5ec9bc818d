"""The patches of a soft body's surface as geoms: contact spheres that the same control points move, one box each."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import mujoco
import numpy as np

from mjframes.body.soft_body import SoftBody
from mjframes.scene import plugin
from mjframes.scene.carriers import printable
from mjframes.scene.contact import Contact
from mjframes.scene.patches import Patch
from mjframes.scene.plugin_text import SEPARATOR, soft_name

PATCH_GROUP = 4  # geom group of the patches' bounding boxes: not drawn unless asked for
BOUNDS = 2.0  # [-] a patch may stretch to this multiple of its body's size before the broad phase loses it


def add_patches(
    own: mujoco.MjSpec,
    body: SoftBody,
    bodies: Sequence[mujoco.MjsBody],
    patches: Sequence[Patch],
    contact: Contact,
    name: str,
) -> None:
    """Add a geom for each of `patches` to the spec `own`, in which the first letter of `name` is left out."""
    half = printable(BOUNDS * np.linalg.norm(np.ptp(body.control.rest, axis=0)))[0]
    corners = half * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    # its distance is not used
    own.add_mesh(name=f"{name[1:]}{SEPARATOR}bounds", uservert=corners.ravel(), octree_maxdepth=1)
    own.activate_plugin(plugin.PATCH_NAME)
    owners: set[str] = set()
    for number, patch in enumerate(patches):
        on = bodies[patch.carrier]
        instance = on.plugin.name
        stem = soft_name(instance) + SEPARATOR
        geom = on.add_geom(
            name=f"{stem}patch_{number}",
            type=mujoco.mjtGeom.mjGEOM_SDF,
            meshname=f"{stem}bounds",
            group=PATCH_GROUP,
            mass=0,
            rgba=[0.5, 0.5, 0.5, 0.1],
        )
        contact.write(geom)
        # of its own: MuJoCo does not tell an SDF plugin which geom it asks about
        own.add_plugin(name=f"{name[1:]}{SEPARATOR}patch_{number}", plugin_name=plugin.PATCH_NAME, active=True)
        use_plugin(geom, geom.name, plugin.PATCH_NAME)
        owners.add(on.name)
    if contact.contype & contact.conaffinity:  # a soft body does not meet itself: MuJoCo need not ask
        inner = sorted(owner for owner in owners if owner.startswith(name[1:] + SEPARATOR))
        for first, second in itertools.combinations(inner, 2):
            own.add_exclude(bodyname1=first, bodyname2=second)


def use_plugin(element: mujoco.MjsBody | mujoco.MjsGeom, name: str, plugin_name: str = plugin.NAME) -> None:
    """Let an element belong to a plugin instance."""
    element.plugin.active = True
    element.plugin.plugin_name = plugin_name
    element.plugin.name = name
