"""A soft body as MJCF: a holder, in it nested bodies, one plugin instance, patch geoms, one skin a material.

Each body carries control points (`carriers`). Those of moving frames are nested in the holder along the elimination
tree, with qpos = 0 at rest; those of held frames hang on the bodies that hold them.
"""

from __future__ import annotations

import itertools
import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from mjframes.base.errors import MjframesError, Notice, reason
from mjframes.body.soft_body import SoftBody
from mjframes.frames.supports import PARENT
from mjframes.scene import links, plugin
from mjframes.scene.carriers import Carrier, carriers, printable, printable_quaternion, too_small
from mjframes.scene.contact import Contact
from mjframes.scene.detach import detach
from mjframes.scene.identity import remember
from mjframes.scene.links import Pose
from mjframes.scene.load import changed_masses
from mjframes.scene.muscles import Muscle
from mjframes.scene.patch_geoms import add_patches, reserve_memory, use_plugin
from mjframes.scene.patches import ordered_patches
from mjframes.scene.plugin_text import SEPARATOR, configuration, decode, instance_name
from mjframes.scene.scaling import add_scaling
from mjframes.scene.skins import add_skins
from mjframes.scene.solver import avoid_wrong_solver
from mjframes.scene.tendons import Chamber, Fibre, add_tendons
from mjframes.scene.view import Soft, soft


class BranchWarning(UserWarning):
    """A soft body connects branches of the kinematic tree that MuJoCo's inertia matrix does not couple."""


class FloatWarning(Notice):
    """Nothing of a soft body is fixed to its moving parent, so it starts there and floats free."""


@dataclass(frozen=True, eq=False)
class Attachment:
    """A soft body in a spec, as `attach` returns it.

    Parameters
    ----------
    name
        Name of the soft body in the spec.
    body
        The soft body as it was built. Material points and frames need it.
    """

    name: str
    body: SoftBody

    def soft(self, model: mujoco.MjModel, data: mujoco.MjData) -> Soft:
        """Return the view of the soft body in a compiled model, see `mjframes.soft`."""
        return soft(model, data, self.name, self.body)


def attach(
    spec: mujoco.MjSpec,
    body: SoftBody,
    name: str,
    parent: str | mujoco.MjsBody | None = None,
    *,
    pos: Sequence[float] = (0.0, 0.0, 0.0),
    quat: Sequence[float] = (1.0, 0.0, 0.0, 0.0),
    contact: bool | Contact = True,
    tendons: Mapping[str, Chamber | Fibre | Muscle] | None = None,
) -> Attachment:
    """Put a soft body into a spec.

    Where bodies of the scene hold pieces of it (`Attached`), their poses at the reference configuration are those in
    which the soft body rests. Its frames then hang on the one of these bodies below most of the others.

    Parameters
    ----------
    spec
        The scene to change.
    body
        The soft body, from `build` or `SoftBody.load`.
    name
        Name of the soft body. Everything that belongs to it is called `name:something`, so it cannot clash with your
        names.
    parent
        The body of the spec to attach to, or its name. The default is the world.
    pos, quat
        Position [m] and quaternion (w, x, y, z) of the volume's coordinate system in `parent`. If `parent` moves and
        nothing of the soft body is fixed, this is only where it starts.
    contact
        Whether the soft body collides, or a `Contact` that says how. It never collides with what holds it.
    tendons
        Chambers, fibres and muscles by name. Each becomes a tendon of that name in the spec, for MuJoCo's actuators,
        sensors, springs and limits.

    Returns
    -------
    Attachment
        Reads the body back from the compiled model.

    Raises
    ------
    MjframesError
        For a name that cannot be used, for bodies that the spec does not have, for tendons outside the material, for a
        body of a few hundredths of a millimetre, and if the plugin cannot be loaded.

    Warns
    -----
    BranchWarning
        If the bodies that hold pieces are on several branches of the kinematic tree.
    FloatWarning
        If `parent` moves and nothing of the soft body is fixed.
    """
    within = _checked(spec, body, parent, contact)
    if not isinstance(name, str) or not re.fullmatch(r"[A-Za-z0-9_.-]+", name):
        raise MjframesError(f"name is {name!r}; use one or more letters, digits, '_', '-' or '.'.")
    links.require_pose(pos, quat)
    if name == "world":
        raise MjframesError("name is 'world', which MuJoCo calls the world's body; give another name.")
    if spec.body(name) is not None:
        raise MjframesError(f"name is {name!r}, which a body of the scene has already; give another name.")
    if tendons is not None and not isinstance(tendons, Mapping):
        raise MjframesError(
            f"tendons is a {type(tendons).__name__}; give a dictionary of Chamber, Fibre and Muscle by name."
        )
    plugin.load()
    place = _place(spec, body, within, pos, quat)
    if not body.links and links.moves(within):
        warnings.warn(
            f"{name}: nothing of it is fixed to {within.name!r}, which moves: it starts there and floats free; glue it "
            "with supports=mf.Fixed(mask) in mf.build, or --fixed on the command line.",
            FloatWarning,
            stacklevel=2,
        )
    carried = carriers(body, place.links)
    if any(carrier.joints and not carrier.mass for carrier in carried):
        raise too_small(body, name)
    # MuJoCo wants a prefix when it attaches: the first letter of the name, which makes the names come out right
    prefix, local = name[0], name[1:]
    own = mujoco.MjSpec()
    own.activate_plugin(plugin.NAME)
    instance = own.add_plugin(name=instance_name(name)[1:], plugin_name=plugin.NAME, active=True)
    # it has no mass; without an inertial MuJoCo would take its place, which comes later, for that of one
    inner = own.worldbody.add_body(name=instance.name, explicitinertial=True, ipos=[0, 0, 0], iquat=[1, 0, 0, 0])
    bodies = _add_bodies(inner, carried, place.bodies, name)
    rank = _ranks(bodies, place)
    patches = ordered_patches(body, carried, rank) if contact else []
    order = [carried[c] for c in np.argsort(rank)]
    parameters = contact if isinstance(contact, Contact) else Contact()
    branches = _branches(body, place, name)
    config = configuration(body, remember(body), order, branches, patches, parameters.dents)
    instance.config = config
    if patches:
        add_patches(own, body, carried, bodies, patches, parameters, name)
    if not place.bodies:
        add_skins(own, body, carried, local)
    add_scaling(own, local, body.deformable, body.materials)
    own.default.name = _default_name(spec, name)[1:]  # its own would meet that of a soft body with the same prefix
    try:
        place.holder.add_frame().attach_body(inner, prefix, "")
    except ValueError as error:
        raise MjframesError(
            f"{name}: MuJoCo cannot attach the soft body ({reason(error)}); where another one has the name, or had it, "
            f"mf.detach(spec, {name!r}) takes out what is left of that."
        ) from error
    inner.name = name  # of one letter it has a separator behind it
    inner.pos, inner.quat = place.pos, place.quat  # not the frame's: PyMJCF knows no <frame>
    if patches:
        reserve_memory(spec)
    if place.bodies:  # with bones that the soft body's own spec does not have
        add_skins(spec, body, carried, name)
    avoid_wrong_solver(spec)
    try:
        add_tendons(spec, body, name, carried, decode(config["point_rest"]).reshape(-1, 3), tendons or {})
    except MjframesError:
        detach(spec, name)
        raise
    return Attachment(name, body)


def _default_name(spec: mujoco.MjSpec, name: str) -> str:
    """Return a name for the default class, other than those that `detach` left."""
    names = (f"{name}{SEPARATOR}default{number or ''}" for number in itertools.count())
    return next(own for own in names if spec.find_default(own) is None)


def _checked(
    spec: mujoco.MjSpec, body: SoftBody, parent: str | mujoco.MjsBody | None, contact: bool | Contact
) -> mujoco.MjsBody:
    """The parent. Raise MjframesError for arguments of other types, and for what the scene would do to the masses."""
    if not isinstance(spec, mujoco.MjSpec):
        raise MjframesError(f"spec is a {type(spec).__name__}; give the scene as an MjSpec, as MjSpec.from_file(path).")
    if not isinstance(body, SoftBody):
        raise MjframesError(f"body is a {type(body).__name__}; give the SoftBody that build or SoftBody.load returned.")
    if not isinstance(contact, (bool, Contact)):
        raise MjframesError(f"contact is {contact!r}; give True, False or a Contact.")
    size = float(np.linalg.norm(np.ptp(body.control.rest, axis=0)))
    if isinstance(contact, Contact) and contact.margin is not None and contact.margin > size:
        raise MjframesError(
            f"the margin of the contact is {contact.margin:g} m, but the body is {size:.2g} m large: "
            "all nearer than the margin is pushed away; give a few millimetres, or a gap to find what is near."
        )
    holder = spec.worldbody if parent is None else parent
    if isinstance(holder, str):
        holder = links.find_body(spec, holder)
    elif not isinstance(holder, mujoco.MjsBody):
        raise MjframesError(f"parent is a {type(parent).__name__}; give a body of the scene, or its name.")
    if links.path_of(holder)[-1] is not spec.worldbody:
        raise MjframesError(f"parent is the body {holder.name!r} of another scene; give one of the spec's.")
    changed = changed_masses(spec.compiler)
    if changed:
        raise MjframesError(f"the scene cannot hold a soft body: {changed}.")
    return holder


@dataclass(frozen=True, eq=False)
class _Place:
    """Where a soft body goes.

    holder: the body that its frames hang on; pos, quat: of the volume's coordinate system in it.
    links: pose of each body that holds a frame, in the volume's coordinates.
    bodies: those of them that are not the holder.
    """

    holder: mujoco.MjsBody
    pos: list[float]
    quat: list[float]
    links: dict[str, Pose]
    bodies: dict[str, mujoco.MjsBody]


def _place(
    spec: mujoco.MjSpec, body: SoftBody, parent: mujoco.MjsBody, pos: Sequence[float], quat: Sequence[float]
) -> _Place:
    named = sorted({link for link in body.links if link != PARENT})
    if not body.links and links.moves(parent):
        in_world = links.compose(links.pose_in_world(parent), links.pose(pos, quat))
        return _Place(
            spec.worldbody, printable(in_world[1]), printable_quaternion(links.quaternion(in_world[0])), {}, {}
        )
    if not named:
        return _Place(parent, list(pos), list(quat), {PARENT: (np.eye(3), np.zeros(3))}, {})
    bodies = {link: links.find_body(spec, link, "attached names the body") for link in named}
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
        use_plugin(child, instance_name(name)[0 if link else 1 :])
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
