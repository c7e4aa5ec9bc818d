"""The surface of a soft body as MuJoCo's skins, whose bones are the bodies that carry its control points."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence

import mujoco
import numpy as np
from scipy import sparse

from mjframes.body.soft_body import SoftBody
from mjframes.scene import links
from mjframes.scene.carriers import Carrier, carrier_of
from mjframes.scene.plugin_text import SEPARATOR
from mjframes.scene.rounding import in_units

WEIGHT_UNITS = 10_000  # of skin weights, which MJCF writes as text: where frames turn, 1e-4 of their distance
VERTEX_ROUNDING = 1e-4  # [-] of the body's size, at most: of the vertices' places, a tenth of a pixel


def add_skins(spec: mujoco.MjSpec, body: SoftBody, carried: Sequence[Carrier], name: str) -> None:
    """Add a skin for each label that is seen, named after its material, if that is its alone."""
    skin = body.skin
    names = Counter(["", "", *(body.materials[int(label)].name for label in np.unique(skin.label))])  # "" is no name
    for label in np.unique(skin.label):
        material = body.materials[int(label)]
        own = "_".join(filter(None, [material.name, "" if names[material.name] == 1 else str(label)]))
        faces = skin.faces[skin.label == label]
        add_skin(spec, carried, name + SEPARATOR + own, name, skin.vertices, faces, skin.weights, material.rgba)


def add_skin(
    spec: mujoco.MjSpec,
    carried: Sequence[Carrier],
    own: str,
    name: str,
    vertices: np.ndarray,
    faces: np.ndarray,
    weights: sparse.csr_array,
    rgba: Sequence[float],
) -> None:
    """Add the skin `own` of triangles to the spec, moved by the bodies of the soft body `name`.

    Its bones are the bodies, each with the weights of the points that ride on it.
    """
    bone_of = carrier_of(carried)
    gather = sparse.csr_array((np.ones(len(bone_of)), (np.arange(len(bone_of)), bone_of)))
    used, local = np.unique(faces, return_inverse=True)
    rounded = sparse.csr_array(in_units(sparse.csr_array(weights[used] @ gather), WEIGHT_UNITS) / WEIGHT_UNITS)
    rounded.eliminate_zeros()
    places = np.round(vertices, math.ceil(-math.log10(VERTEX_ROUNDING * np.ptp(vertices, axis=0).max())))
    by_bone = sparse.csc_array(rounded)
    bones = np.flatnonzero(np.diff(by_bone.indptr)).tolist()
    columns = [slice(by_bone.indptr[c], by_bone.indptr[c + 1]) for c in bones]
    spec.add_skin(
        name=own,
        vert=places[used].ravel(),
        face=local.ravel(),
        bodyname=[f"{name}{SEPARATOR}{carried[c].points[0]}" for c in bones],
        bindpos=np.ravel([carried[c].pose[1] for c in bones]),
        bindquat=np.ravel([links.quaternion(carried[c].pose[0]) for c in bones]),
        vertid=[by_bone.indices[column].tolist() for column in columns],
        vertweight=[by_bone.data[column].tolist() for column in columns],
        rgba=rgba,
    )
