"""The surface of a soft body as MuJoCo's skins, whose bones are the bodies that carry its control points."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import mujoco
import numpy as np
from scipy import sparse

from mjframes.body.soft_body import SoftBody
from mjframes.scene import links
from mjframes.scene.carriers import Carrier
from mjframes.scene.plugin_text import SEPARATOR
from mjframes.scene.veins import add_veined_material, vein_coordinates

SKIN_WEIGHT = 1e-4  # [-] smaller skin weights are left out: below single precision of a pixel


def add_skins(spec: mujoco.MjSpec, body: SoftBody, carried: Sequence[Carrier], name: str) -> None:
    """Add a skin for each label that is seen, named after its material, if that is its alone.

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
        own = "_".join(filter(None, [material.name, "" if names[material.name] == 1 else str(label)]))
        added = spec.add_skin(
            name=name + SEPARATOR + own,
            vert=skin.vertices[used].ravel(),
            face=local.ravel(),
            bodyname=[f"{name}{SEPARATOR}{carried[c].points[0]}" for c in bones],
            bindpos=np.ravel([carried[c].pose[1] for c in bones]),
            bindquat=np.ravel([links.quaternion(carried[c].pose[0]) for c in bones]),
            vertid=[weights.indices[column].tolist() for column in columns],
            vertweight=[weights.data[column].tolist() for column in columns],
        )
        if material.veins is None:
            added.rgba = material.rgba
        else:  # MuJoCo takes a skin's own colour before that of its material
            add_veined_material(spec, material, added.name)
            added.material = added.name
            added.texcoord = vein_coordinates(skin.vertices[used], material.vein_spacing).ravel()
