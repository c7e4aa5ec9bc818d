"""A soft body as MJCF: a holder, in it nested bodies on slides, one plugin instance, patch geoms, one skin a material.

Control point j is a body at x̄_j − x̄_parent with three slide joints, so that qpos = 0 at rest and x_j = x̄_j + Σ of the
slides of j and its ancestors. The four points of a frame form a chain; the first hangs on the last of the parent frame.
"""

from __future__ import annotations

import base64
import itertools
import re
from collections.abc import Sequence

import mujoco
import numpy as np
from scipy import sparse

from mjframes import plugin
from mjframes.asset import lower_triangle
from mjframes.body import SoftBody
from mjframes.constants import FORMAT_VERSION
from mjframes.contact import Contact
from mjframes.errors import MjframesError

ATTRIBUTES = (  # in the plugin's order, which is that of the compiled model (plugin/soft.cc)
    "version",
    "law",
    "alpha",
    "beta",
    "point_rest",
    "region_size",
    "region_point",
    "region_gradient",
    "region_stiffness",
    "contact_radius",
    "patch_size",
    "patch_clusters",
    "patch_cluster_size",
    "patch_point",
    "patch_weight",
    "lattice_spacing",
    "lattice_axes",
    "lattice_origin",
    "lattice_shape",
    "lattice_node",
    "lattice_distance",
    "lattice_patch",
    "lattice_count",
    "lattice_point",
    "lattice_weight",
    "lattice_sphere",
)

PATCH_GROUP = 4  # geom group of the patches' bounding boxes: not drawn unless asked for
BOUNDS = 2.0  # [-] a patch may stretch to this multiple of its body's size before the broad phase loses it
INERTIA = 1e-6  # [-] of m size²: point masses have none, but MuJoCo wants a positive one; slides never turn
DIGITS = 12  # decimals in SI: what is smaller is rounding, and MuJoCo saves it as 0
SKIN_WEIGHT = 1e-4  # [-] smaller skin weights are left out: below single precision of a pixel


def attach(
    parent: mujoco.MjsBody,
    body: SoftBody,
    name: str,
    pos: Sequence[float] = (0.0, 0.0, 0.0),
    quat: Sequence[float] = (1.0, 0.0, 0.0, 0.0),
    contact: bool | Contact = True,
) -> None:
    """Put a soft body into a spec, below the body `parent` of it.

    pos [m], quat: where the volume's coordinate system goes, in `parent`.  name: of the plugin instance, and the prefix
    of all that is added.  contact: whether it collides with the scene's geoms and other soft bodies, or how.
    Raises MjframesError for a name that cannot be used, and where the plugin cannot be loaded.
    """
    if not re.fullmatch(r"[A-Za-z0-9_.-]{2,}", name):
        raise MjframesError(f"name is {name!r}; use two or more letters, digits, '_', '-' or '.'.")
    if len(pos) != 3 or len(quat) != 4 or not np.isfinite([*pos, *quat]).all() or not np.any(quat):
        raise MjframesError(f"pos is {pos!r} and quat is {quat!r}; give three metres and four quaternion components.")
    plugin.load()
    # MuJoCo wants a prefix when it attaches: all but the last letter of the name, which makes the names come out right
    prefix, local = name[:-1], name[-1]
    spec = mujoco.MjSpec()
    spec.activate_plugin(plugin.NAME)
    patches = _patches(body) if contact else []
    parameters = contact if isinstance(contact, Contact) else Contact()
    instance = spec.add_plugin(name=local, plugin_name=plugin.NAME, active=True)
    instance.config = _configuration(body, patches)
    holder = spec.worldbody.add_body(name=local)
    bodies = _add_bodies(holder, body, local)
    if patches:
        _add_patches(spec, body, local, bodies, patches, parameters)
    _add_skins(spec, body, local)
    spec.default.name = f"{local}_default"  # by its own name it would meet that of a soft body with the same prefix
    frame = parent.add_frame(pos=list(pos), quat=list(quat))
    try:
        frame.attach_body(holder, prefix, "")
    except ValueError as error:
        raise MjframesError(f"{name}: MuJoCo cannot attach the soft body ({' '.join(str(error).split())}).") from error


def _add_bodies(holder: mujoco.MjsBody, body: SoftBody, name: str) -> list[mujoco.MjsBody]:
    """One body for each control point; those of fixed frames have no joints."""
    control, size = body.control, np.ptp(body.control.rest, axis=0).max()
    bodies: list[mujoco.MjsBody] = []
    for j, (above, offset) in enumerate(zip(_parent_points(body), _offsets(body), strict=True)):
        child = (bodies[above] if above >= 0 else holder).add_body(
            name=f"{name}_{j}",
            pos=offset,
            explicitinertial=True,
            ipos=[0, 0, 0],  # without it a saved model loses the masses
            mass=_printable(control.mass[j])[0],
            inertia=_printable(np.full(3, INERTIA * control.mass[j] * size**2)),
        )
        for axis, letter in zip(np.eye(3), "xyz" if control.frame[j] >= body.fixed else "", strict=False):
            child.add_joint(name=f"{name}_{j}_{letter}", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
        _use_plugin(child, name)
        bodies.append(child)
    return bodies


def _printable(values: np.ndarray | np.floating | float) -> list[float]:
    """Rounded to the six digits that MuJoCo saves, so that a saved model is the same model to the bit."""
    return [float(f"{value:.6g}") for value in np.round(np.atleast_1d(values), DIGITS)]


def _offsets(body: SoftBody) -> list[list[float]]:
    """Of each control point where it rests, from the one it hangs on [m]."""
    rest = body.control.rest
    return [_printable(rest[j] - (rest[above] if above >= 0 else 0)) for j, above in enumerate(_parent_points(body))]


def _written_rest(body: SoftBody) -> np.ndarray:
    """x̄ (k, 3) [m] as the bodies have it, digits lost: from any other a stiff body is strained where it rests."""
    rest = np.array(_offsets(body))
    for j, above in enumerate(_parent_points(body)):
        rest[j] += rest[above] if above >= 0 else 0
    return rest


def _parent_points(body: SoftBody) -> list[int]:
    """Of each control point the one it hangs on, −1 for roots and those of fixed frames."""
    frame = body.control.frame
    last = {int(i): int(np.flatnonzero(frame == i)[-1]) for i in np.unique(frame)} | {-1: -1}
    return [
        -1 if i < body.fixed else j - 1 if j > 0 and frame[j - 1] == i else last[int(body.parent[i])]
        for j, i in enumerate(frame)
    ]


def _use_plugin(element: mujoco.MjsBody | mujoco.MjsGeom, name: str) -> None:
    element.plugin.active = True
    element.plugin.plugin_name = plugin.NAME
    element.plugin.name = name


def _patches(body: SoftBody) -> list[np.ndarray]:
    """The contact spheres of each patch; patches in the order of their bodies."""
    return np.split(np.arange(len(body.contact.patch)), np.flatnonzero(np.diff(body.contact.patch)) + 1)


def _patch_points(body: SoftBody, spheres: np.ndarray) -> np.ndarray:
    """The control points that move any of the spheres, and all points of their frames: one path, ancestors first."""
    frames = np.unique(body.control.frame[body.contact.weights[spheres].indices])
    return np.flatnonzero(np.isin(body.control.frame, frames))


def _add_patches(
    spec: mujoco.MjSpec,
    body: SoftBody,
    name: str,
    bodies: list[mujoco.MjsBody],
    patches: list[np.ndarray],
    contact: Contact,
) -> None:
    half = _printable(BOUNDS * np.linalg.norm(np.ptp(body.control.rest, axis=0)))[0]
    corners = half * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    spec.add_mesh(name=f"{name}_bounds", uservert=corners.ravel(), octree_maxdepth=1)  # its own distance is not used
    owners = [bodies[_patch_points(body, spheres)[-1]] for spheres in patches]
    for number, owner in enumerate(owners):
        geom = owner.add_geom(
            name=f"{name}_patch_{number}",
            type=mujoco.mjtGeom.mjGEOM_SDF,
            meshname=f"{name}_bounds",
            group=PATCH_GROUP,
            mass=0,
            rgba=[0.5, 0.5, 0.5, 0.1],
        )
        contact.write(geom)
        _use_plugin(geom, name)
    if contact.contype & contact.conaffinity:  # a soft body does not meet itself: MuJoCo need not ask
        for first, second in itertools.combinations(sorted({owner.name for owner in owners}), 2):
            spec.add_exclude(bodyname1=first, bodyname2=second)


def _add_skins(spec: mujoco.MjSpec, body: SoftBody, name: str) -> None:
    """One skin for each material that is seen."""
    skin, control = body.skin, body.control
    for label in np.unique(skin.label):
        faces = skin.faces[skin.label == label]
        used, local = np.unique(faces, return_inverse=True)
        weights = sparse.csc_array(skin.weights[used])
        weights.data[np.abs(weights.data) < SKIN_WEIGHT] = 0
        weights.eliminate_zeros()
        bones = np.flatnonzero(np.diff(weights.indptr))
        columns = [slice(weights.indptr[j], weights.indptr[j + 1]) for j in bones]
        material = body.materials[int(label)]
        spec.add_skin(
            name=f"{name}_{material.name or label}",
            vert=skin.vertices[used].ravel(),
            face=local.ravel(),
            rgba=material.rgba,
            bodyname=[f"{name}_{j}" for j in bones],
            bindpos=control.rest[bones].ravel(),
            bindquat=np.tile([1.0, 0.0, 0.0, 0.0], len(bones)),
            vertid=[weights.indices[column].tolist() for column in columns],
            vertweight=[weights.data[column].tolist() for column in columns],
        )


def _configuration(body: SoftBody, patches: list[np.ndarray]) -> dict[str, str]:
    """The plugin instance's attributes (plugin/soft.cc); with contact only if there are patches."""
    stiffness = body.stiffness
    values = {
        "version": str(FORMAT_VERSION),
        "law": "corotational",
        "alpha": repr(body.damping[0]),
        "beta": repr(body.damping[1]),
        "point_rest": encode(_written_rest(body)),
        "region_size": encode([len(points) for points in stiffness.points]),
        "region_point": encode(np.concatenate(stiffness.points)),
        "region_gradient": encode(np.concatenate(stiffness.gradient)),
        "region_stiffness": encode(np.concatenate([lower_triangle(matrix) for matrix in stiffness.matrix])),
    }
    if patches:
        points = [_patch_points(body, spheres) for spheres in patches]
        weights = body.contact.weights.toarray()
        sizes = [np.bincount(body.contact.cluster[spheres]) for spheres in patches]
        values |= {
            "contact_radius": repr(body.contact.radius),
            "patch_size": encode([len(some) for some in points]),
            "patch_clusters": encode([len(clusters) for clusters in sizes]),
            "patch_cluster_size": encode(np.concatenate(sizes)),
            "patch_point": encode(np.concatenate(points)),
            "patch_weight": encode(
                np.concatenate(
                    [weights[np.ix_(spheres, some)].T.ravel() for spheres, some in zip(patches, points, strict=True)]
                )
            ),
        }
        values |= _lattice_configuration(body)
    return values


def _lattice_configuration(body: SoftBody) -> dict[str, str]:
    lattice = body.lattice
    return {
        "lattice_spacing": repr(lattice.spacing),
        "lattice_axes": encode(body.fields.volume.axes),
        "lattice_origin": encode(lattice.origin),
        "lattice_shape": encode(lattice.shape),
        "lattice_node": encode(lattice.node),
        "lattice_distance": encode(lattice.distance),
        "lattice_patch": encode(lattice.patch),
        "lattice_count": encode(np.diff(lattice.weights.indptr)),
        "lattice_point": encode(lattice.weights.indices),
        "lattice_weight": encode(lattice.weights.data),
        "lattice_sphere": encode(lattice.spheres),
    }


def encode(values: np.ndarray | Sequence[int]) -> str:
    """An array as the plugin reads it: type, count and base64 of the little-endian values."""
    array = np.ravel(values)
    kind, form = ("i32", "<i4") if np.issubdtype(array.dtype, np.integer) else ("f64", "<f8")
    return f"{kind}:{array.size}:{base64.b64encode(array.astype(form).tobytes()).decode('ascii')}"


def decode(text: str) -> np.ndarray:
    """The values (count,) of what `encode` wrote."""
    kind, _, data = text.split(":")
    return np.frombuffer(base64.b64decode(data), "<i4" if kind == "i32" else "<f8")
