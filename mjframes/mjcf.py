"""A soft body as MJCF: a holder, in it nested bodies, one plugin instance, patch geoms, one skin a material.

Each body carries control points (`carriers`). Those of moving frames are nested in the holder along the elimination
tree, with qpos = 0 at rest; those of held frames hang on the bodies that hold them.
"""

from __future__ import annotations

import itertools
import re
import warnings
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy import sparse

from mjframes import links, plugin
from mjframes.body import SoftBody
from mjframes.carriers import Carrier, carriers, printable, printable_quaternion
from mjframes.configuration import SEPARATOR, configuration, instance_name, patch_points, soft_name
from mjframes.contact import Contact
from mjframes.errors import MjframesError
from mjframes.identity import remember
from mjframes.links import Pose
from mjframes.material import is_number
from mjframes.supports import PARENT

PATCH_GROUP = 4  # geom group of the patches' bounding boxes: not drawn unless asked for
BOUNDS = 2.0  # [-] a patch may stretch to this multiple of its body's size before the broad phase loses it
SKIN_WEIGHT = 1e-4  # [-] smaller skin weights are left out: below single precision of a pixel


class BranchWarning(UserWarning):
    """A soft body couples branches of the kinematic tree that MuJoCo's inertia matrix does not."""


def attach(
    parent: mujoco.MjsBody,
    body: SoftBody,
    name: str,
    pos: Sequence[float] = (0.0, 0.0, 0.0),
    quat: Sequence[float] = (1.0, 0.0, 0.0, 0.0),
    contact: bool | Contact = True,
    spec: mujoco.MjSpec | None = None,
) -> None:
    """Put a soft body into a spec, below the body `parent` of it.

    pos [m], quat: where the volume's coordinate system goes, in `parent`. Where that moves and nothing of the body is
    held, it only starts there and floats free of it: it goes below the world.  name: of the body that holds it all;
    what belongs to it is called name:something, so that no two soft bodies share a name.  contact: whether it collides
    with the scene's geoms and other soft bodies, or how; never with what holds it.
    spec: the one that `parent` belongs to, where the body has pieces attached to other bodies. Their poses at the
    reference configuration are those in which the soft body rests; its frames then hang on the one of these bodies
    below most of the others. Warns (BranchWarning) where such bodies are on several branches of the tree.
    Raises MjframesError for a name that cannot be used, bodies that are not there, and where the plugin cannot be
    loaded.
    """
    _check_arguments(parent, body, contact, spec)
    if not isinstance(name, str) or not re.fullmatch(r"[A-Za-z0-9_.-]+", name):
        raise MjframesError(f"name is {name!r}; use one or more letters, digits, '_', '-' or '.'.")
    if np.shape(pos) != (3,) or np.shape(quat) != (4,) or not all(map(is_number, (*pos, *quat))) or not np.any(quat):
        raise MjframesError(f"pos is {pos!r} and quat is {quat!r}; give three metres and four quaternion components.")
    plugin.load()
    place = _place(parent, body, spec, pos, quat)
    carried = carriers(body, place.links)
    # MuJoCo wants a prefix when it attaches: the first letter of the name, which makes the names come out right
    prefix, local = name[0], name[1:]
    own = mujoco.MjSpec()
    own.activate_plugin(plugin.NAME)
    instance = own.add_plugin(name=instance_name(name)[1:], plugin_name=plugin.NAME, active=True)
    inner = own.worldbody.add_body(name=instance.name)
    bodies = _add_bodies(inner, carried, place.bodies, name)
    rank = _ranks(bodies, place)
    patches = _patches(body, carried, rank) if contact else []
    order = [carried[c] for c in np.argsort(rank)]
    instance.config = configuration(body, order, _branches(body, place, name), patches)
    if patches:
        parameters = contact if isinstance(contact, Contact) else Contact()
        _add_patches(own, body, carried, bodies, patches, parameters, name)
    if not place.bodies:
        _add_skins(own, body, carried, local)
    own.default.name = f"{local}{SEPARATOR}default"  # its own would meet that of a soft body with the same prefix
    try:
        place.holder.add_frame(pos=place.pos, quat=place.quat).attach_body(inner, prefix, "")
    except ValueError as error:
        raise MjframesError(f"{name}: MuJoCo cannot attach the soft body ({' '.join(str(error).split())}).") from error
    inner.name = name  # of one letter it has a separator behind it
    remember(body)
    if spec is not None and place.bodies:  # with bones that the soft body's own spec does not have
        _add_skins(spec, body, carried, name)


def _check_arguments(
    parent: mujoco.MjsBody, body: SoftBody, contact: bool | Contact, spec: mujoco.MjSpec | None
) -> None:
    """Raises MjframesError for arguments of other types, and for what the scene would do to the masses."""
    if not isinstance(parent, mujoco.MjsBody):
        raise MjframesError(f"parent is a {type(parent).__name__}; give a body of the scene, as spec.worldbody.")
    if not isinstance(body, SoftBody):
        raise MjframesError(f"body is a {type(body).__name__}; give the SoftBody that build or SoftBody.load returned.")
    if not isinstance(contact, (bool, Contact)):
        raise MjframesError(f"contact is {contact!r}; give True, False or a Contact.")
    world = links.path_of(parent)[-1]
    if spec is not None and not (isinstance(spec, mujoco.MjSpec) and spec.worldbody is world):
        what = "of another scene" if isinstance(spec, mujoco.MjSpec) else f"a {type(spec).__name__}"
        raise MjframesError(f"spec is {what}; give the MjSpec that the parent {parent.name!r} belongs to.")
    changed = changed_masses(world.compiler)
    if changed:
        raise MjframesError(f"the scene cannot hold a soft body: {changed}.")


@dataclass(frozen=True, eq=False)
class _Place:
    """Where a soft body goes.

    holder: the body that its frames hang on; pos, quat: of the volume's coordinate system in it.  links: pose of each
    body that holds a frame, in the volume's coordinates.  bodies: those of them that are not the holder.
    """

    holder: mujoco.MjsBody
    pos: list[float]
    quat: list[float]
    links: dict[str, Pose]
    bodies: dict[str, mujoco.MjsBody]


def _place(
    parent: mujoco.MjsBody, body: SoftBody, spec: mujoco.MjSpec | None, pos: Sequence[float], quat: Sequence[float]
) -> _Place:
    named = sorted({link for link in body.links if link != PARENT})
    if not body.links and links.moves(parent):
        in_world = links.compose(links.pose_in_world(parent), links.pose(pos, quat))
        world = links.path_of(parent)[-1]
        return _Place(world, printable(in_world[1]), printable_quaternion(links.quaternion(in_world[0])), {}, {})
    if not named:
        return _Place(parent, list(pos), list(quat), {PARENT: (np.eye(3), np.zeros(3))}, {})
    if spec is None:
        raise MjframesError(
            f"spec is missing: the soft body is attached to {', '.join(map(repr, named))} of the scene."
        )
    bodies = {link: links.find_link(spec, link) for link in named}
    if PARENT in body.links:
        bodies[PARENT] = parent
    holder = links.best_holder(parent, bodies.values())
    in_holder = links.compose(
        links.inverse(links.pose_in_world(holder)), links.compose(links.pose_in_world(parent), links.pose(pos, quat))
    )
    pos, quat = printable(in_holder[1]), printable_quaternion(links.quaternion(in_holder[0]))
    to_volume = links.inverse(links.compose(links.pose_in_world(holder), links.pose(pos, quat)))
    poses = {link: links.compose(to_volume, links.pose_in_world(other)) for link, other in bodies.items()}
    return _Place(holder, pos, quat, poses, bodies)


def _branches(body: SoftBody, place: _Place, name: str) -> np.ndarray:
    """(k,) 0 for points that MuJoCo's inertia can couple to the moving frames', another number for each other link."""
    branch = np.zeros(len(body.control.frame), int)
    apart: dict[str, int] = {}
    for i, link in enumerate(body.links):
        other = place.bodies.get(link)
        if other is None or other in links.path_of(place.holder) or links.is_static(other, place.holder):
            continue
        branch[body.control.frame == i] = apart.setdefault(link, len(apart) + 1)
    if apart:
        regions = sum(len(np.unique(branch[points])) > 1 for points in body.stiffness.points)
        warnings.warn(
            f"{name}: {regions} of {len(body.stiffness.points)} regions couple {', '.join(map(repr, apart))} to other "
            f"branches of the kinematic tree than {place.holder.name!r}'s; their inertia in the step is enlarged, "
            "their forces are exact.",
            BranchWarning,
            stacklevel=3,
        )
    return branch


def _add_bodies(
    inner: mujoco.MjsBody, carried: Sequence[Carrier], others: dict[str, mujoco.MjsBody], name: str
) -> list[mujoco.MjsBody]:
    bodies: list[mujoco.MjsBody] = []
    alone = sum(bool(carrier.joints) for carrier in carried) == 1
    for carrier in carried:
        link = others.get(carrier.link) if carrier.joints == "" else None
        outer = link or (bodies[carrier.parent] if carrier.parent >= 0 else inner)
        own = f"{name if link else name[1:]}{SEPARATOR}{carrier.points[0]}"
        child = outer.add_body(
            name=own,
            pos=carrier.offset,
            explicitinertial=True,
            ipos=[0, 0, 0],  # without it a saved model loses the masses
            iquat=carrier.quat,
            mass=carrier.mass,
            inertia=carrier.inertia,
        )
        if carrier.joints and alone:
            child.simple = False  # or MuJoCo keeps the diagonal of its inertia only
        if carrier.joints:
            for axis, letter in zip(np.eye(3), "xyz", strict=True):
                child.add_joint(name=f"{own}_{letter}", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
        if carrier.joints == "free":
            child.add_joint(name=f"{own}_ball", type=mujoco.mjtJoint.mjJNT_BALL)
        _use_plugin(child, instance_name(name)[0 if link else 1 :])
        bodies.append(child)
    return bodies


def _ranks(bodies: list[mujoco.MjsBody], place: _Place) -> np.ndarray:
    """(c,) the place of each carrier's body among them all in the compiled model, which is depth first."""
    if not place.bodies:
        return np.arange(len(bodies))
    everything = links.path_of(place.holder)[-1].find_all("body")
    end = len(everything)  # the soft body's own come last below the holder
    if place.holder in everything:
        end = everything.index(place.holder) + len(place.holder.find_all("body"))
    keys = [(everything.index(body), 0) if body in everything else (end, 1 + c) for c, body in enumerate(bodies)]
    rank = np.empty(len(bodies), int)
    rank[sorted(range(len(bodies)), key=lambda c: keys[c])] = np.arange(len(bodies))
    return rank


def changed_masses(compiler: mujoco.MjsCompiler) -> str:
    """What in a scene's compiler changes the masses of its bodies, and so those of soft ones; "" for nothing."""
    for option in ("settotalmass", "boundmass", "boundinertia"):
        if (value := getattr(compiler, option)) > 0:
            return f'its <compiler {option}="{value:g}"/> would change the masses of a soft body; take it out'
    return ""


def _use_plugin(element: mujoco.MjsBody | mujoco.MjsGeom, name: str, plugin_name: str = plugin.NAME) -> None:
    element.plugin.active = True
    element.plugin.plugin_name = plugin_name
    element.plugin.name = name


def _patches(body: SoftBody, carried: Sequence[Carrier], rank: np.ndarray) -> list[np.ndarray]:
    """The contact spheres of each patch; patches in the order of their bodies."""
    patches = np.split(np.arange(len(body.contact.patch)), np.flatnonzero(np.diff(body.contact.patch)) + 1)
    return sorted(patches, key=lambda spheres: rank[_carrier_of_patch(body, carried, spheres)])


def _carrier_of_patch(body: SoftBody, carried: Sequence[Carrier], spheres: np.ndarray) -> int:
    """That of the deepest control point: below it there is nothing that moves the patch."""
    deepest = patch_points(body, spheres)[-1]
    return next(c for c, carrier in enumerate(carried) if deepest in carrier.points)


def _add_patches(
    own: mujoco.MjSpec,
    body: SoftBody,
    carried: Sequence[Carrier],
    bodies: list[mujoco.MjsBody],
    patches: list[np.ndarray],
    contact: Contact,
    name: str,
) -> None:
    half = printable(BOUNDS * np.linalg.norm(np.ptp(body.control.rest, axis=0)))[0]
    corners = half * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    # its distance is not used
    own.add_mesh(name=f"{name[1:]}{SEPARATOR}bounds", uservert=corners.ravel(), octree_maxdepth=1)
    own.activate_plugin(plugin.PATCH_NAME)
    owners: set[str] = set()
    for number, spheres in enumerate(patches):
        on = bodies[_carrier_of_patch(body, carried, spheres)]
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
        _use_plugin(geom, geom.name, plugin.PATCH_NAME)
        owners.add(on.name)
    if contact.contype & contact.conaffinity:  # a soft body does not meet itself: MuJoCo need not ask
        inner = sorted(owner for owner in owners if owner.startswith(name[1:] + SEPARATOR))
        for first, second in itertools.combinations(inner, 2):
            own.add_exclude(bodyname1=first, bodyname2=second)


def _add_skins(spec: mujoco.MjSpec, body: SoftBody, carried: Sequence[Carrier], name: str) -> None:
    """One skin for each label that is seen, named after its material, if that is its alone.

    Its bones are the bodies, each with the weights of the points that ride on it.
    """
    skin = body.skin
    bone_of = np.empty(len(body.control.frame), int)
    for c, carrier in enumerate(carried):
        bone_of[carrier.points] = c
    gather = sparse.csr_array((np.ones(len(bone_of)), (np.arange(len(bone_of)), bone_of)))
    names = Counter(["", "", *(body.materials[int(label)].name for label in np.unique(skin.label))])  # "" is no name
    for label in np.unique(skin.label):
        faces = skin.faces[skin.label == label]
        used, local = np.unique(faces, return_inverse=True)
        weights = sparse.csc_array(skin.weights[used] @ gather)
        weights.data[np.abs(weights.data) < SKIN_WEIGHT] = 0
        weights.eliminate_zeros()
        bones = np.flatnonzero(np.diff(weights.indptr)).tolist()
        columns = [slice(weights.indptr[c], weights.indptr[c + 1]) for c in bones]
        material = body.materials[int(label)]
        spec.add_skin(
            name=name
            + SEPARATOR
            + "_".join(filter(None, [material.name, "" if names[material.name] == 1 else str(label)])),
            vert=skin.vertices[used].ravel(),
            face=local.ravel(),
            rgba=material.rgba,
            bodyname=[f"{name}{SEPARATOR}{carried[c].points[0]}" for c in bones],
            bindpos=np.ravel([carried[c].pose[1] for c in bones]),
            bindquat=np.ravel([links.quaternion(carried[c].pose[0]) for c in bones]),
            vertid=[weights.indices[column].tolist() for column in columns],
            vertweight=[weights.data[column].tolist() for column in columns],
        )
