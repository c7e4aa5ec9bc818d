"""The patches of a soft body's surface as geoms: contact vertices that the same control points move, one box each."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Sequence

import mujoco
import numpy as np

from mjframes.body.soft_body import SoftBody
from mjframes.scene import plugin
from mjframes.scene.carriers import Carrier, printable, too_small
from mjframes.scene.contact import Contact
from mjframes.scene.patches import Patch
from mjframes.scene.plugin_text import SEPARATOR, soft_name

PATCH_GROUP = 4  # geom group of the patches' bounding boxes: not drawn unless asked for
THIN = 1 / 32  # [-] half the width of a patch's mesh where its tips meet, to that of the box around it
LEAST_VOLUME = 1.1e-15  # [m³] MuJoCo takes 1e-15 of a mesh; the rest is for rounding
BOUNDS = 2.0  # [-] a patch may stretch to this multiple of its size at rest before the broad phase loses it

CONTACT = 80  # [bytes] that MuJoCo takes for each contact that a pair of geoms may have, while it looks for them …
PAIR = 96  # [bytes] … and for the pair, at most
KEPT = 500  # [bytes] at least, by which its memory grows with `nconmax`
SPARE = 4 << 20  # [bytes] of its default memory, 13 MB or more, that pairs may take


def add_patches(
    own: mujoco.MjSpec,
    body: SoftBody,
    carried: Sequence[Carrier],
    bodies: Sequence[mujoco.MjsBody],
    patches: Sequence[Patch],
    contact: Contact,
    name: str,
) -> None:
    """Add a geom for each of `patches` to the spec `own`, in which the first letter of `name` is left out.

    bodies: of the `carried`.
    """
    for carrier, reach in _reaches(body, carried, patches).items():
        if 8 * THIN**2 * (BOUNDS * reach) ** 3 < LEAST_VOLUME:
            raise too_small(body, name)
        add_bounds(own, f"{name[1:]}{SEPARATOR}bounds_{carrier}", BOUNDS * reach)
    own.activate_plugin(plugin.PATCH_NAME)
    owners: set[str] = set()
    for number, patch in enumerate(patches):
        on = bodies[patch.carrier]
        instance = on.plugin.name
        stem = soft_name(instance) + SEPARATOR
        geom = on.add_geom(
            name=f"{stem}patch_{number}",
            type=mujoco.mjtGeom.mjGEOM_SDF,
            meshname=f"{stem}bounds_{patch.carrier}",
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


def add_bounds(spec: mujoco.MjSpec, name: str, half: float) -> None:
    """Add a mesh for a geom whose signed distance a plugin knows: only the box around it counts, a cube.

    half: half of the cube's edge [m].

    Where MuJoCo reads such a mesh from XML, it makes an octree of all cells that the mesh crosses, for a cube in 0.3 s.
    So the mesh has thin tips along the axes instead, which takes a twentieth of that.
    """
    tips, faces = np.concatenate([np.eye(3), -np.eye(3)]), []
    inner = THIN * np.array(list(itertools.product((-1, 1), repeat=3)))
    for tip, axis in enumerate([0, 1, 2] * 2):
        sign = 1 if tip < 3 else -1
        ring = [np.roll([sign, a, b], axis) > 0 for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        around = [len(tips) + int(corner @ [4, 2, 1]) for corner in ring[::sign]]
        faces += [[tip, around[k - 1], around[k]] for k in range(4)]
    vertices = printable(half * np.concatenate([tips, inner]).ravel())
    spec.add_mesh(name=name, uservert=vertices, userface=np.ravel(faces), octree_maxdepth=1)


def reserve_memory(spec: mujoco.MjSpec) -> None:
    """Give a scene memory for all pairs of its soft bodies' patches and other geoms, as if all lay in one heap.

    What the scene asks for becomes as much as that, if it is less. What MuJoCo chooses by all else that is in the scene
    grows by it: that is what `nconmax` still does.
    """
    rigid, patches = 0, Counter[str]()
    for geom in spec.geoms:
        if geom.contype or geom.conaffinity:
            if geom.plugin.plugin_name == plugin.PATCH_NAME:
                patches[geom.parent.plugin.name] += 1
            else:
                rigid += 1
    soft = patches.total()
    pairs = soft * rigid + (soft**2 - sum(count**2 for count in patches.values())) // 2
    size = pairs * (CONTACT * spec.option.sdf_initpoints + PAIR)
    if size <= SPARE:
        return
    if spec.memory >= 0:
        spec.memory = max(spec.memory, size + SPARE)
    else:
        spec.nconmax = max(spec.nconmax, size // KEPT)


def _reaches(body: SoftBody, carried: Sequence[Carrier], patches: Sequence[Patch]) -> dict[int, float]:
    """How far from each carrier its patches have vertices or material at rest [m].

    A carrier that slides does not turn with the body: its box has to hold the patches whichever way they are turned.
    """
    field = body.distance_field
    place = np.stack(np.unravel_index(field.node, field.shape), axis=1)
    nodes = field.origin + field.spacing * place @ body.fields.volume.axes.T
    inside = field.distance < 0
    reaches: dict[int, float] = {}
    for patch in patches:
        below = inside & (field.patch == body.contact.patch[patch.vertices[0]])
        points = np.concatenate([body.contact.positions[patch.vertices], nodes[below]])
        far = np.linalg.norm(points - carried[patch.carrier].pose[1], axis=1).max()
        reaches[patch.carrier] = max(reaches.get(patch.carrier, 0.0), float(far))
    return reaches


def use_plugin(element: mujoco.MjsBody | mujoco.MjsGeom, name: str, plugin_name: str = plugin.NAME) -> None:
    """Let an element belong to a plugin instance."""
    element.plugin.active = True
    element.plugin.plugin_name = plugin_name
    element.plugin.name = name
