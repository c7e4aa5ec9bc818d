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
    """Add a skin for each label that is seen, named after its material, if that is its alone.

    Its bones are the bodies, each with the weights of the points that ride on it.
    """
    skin = body.skin
    bone_of = carrier_of(carried)
    gather = sparse.csr_array((np.ones(len(bone_of)), (np.arange(len(bone_of)), bone_of)))
    rounded = sparse.csr_array(in_units(sparse.csr_array(skin.weights @ gather), WEIGHT_UNITS) / WEIGHT_UNITS)
    rounded.eliminate_zeros()
    places = np.round(skin.vertices, math.ceil(-math.log10(VERTEX_ROUNDING * np.ptp(skin.vertices, axis=0).max())))
    names = Counter(["", "", *(body.materials[int(label)].name for label in np.unique(skin.label))])  # "" is no name
    for label in np.unique(skin.label):
        faces = skin.faces[skin.label == label]
        used, local = np.unique(faces, return_inverse=True)
        weights = sparse.csc_array(rounded[used])
        bones = np.flatnonzero(np.diff(weights.indptr)).tolist()
        columns = [slice(weights.indptr[c], weights.indptr[c + 1]) for c in bones]
        material = body.materials[int(label)]
        own = "_".join(filter(None, [material.name, "" if names[material.name] == 1 else str(label)]))
        spec.add_skin(
            name=name + SEPARATOR + own,
            vert=places[used].ravel(),
            face=local.ravel(),
            bodyname=[f"{name}{SEPARATOR}{carried[c].points[0]}" for c in bones],
            bindpos=np.ravel([carried[c].pose[1] for c in bones]),
            bindquat=np.ravel([links.quaternion(carried[c].pose[0]) for c in bones]),
            vertid=[weights.indices[column].tolist() for column in columns],
            vertweight=[weights.data[column].tolist() for column in columns],
            rgba=material.rgba,
        )
