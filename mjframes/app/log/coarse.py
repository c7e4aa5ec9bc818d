"""Skins with fewer triangles, for logs: a film needs every vertex of a skin, a look at a log does not.

The coarse surface has vertices of the skin, so that it goes wherever MuJoCo takes those. Skins on bones in common, as
those of a soft body's materials, are made coarse together: no gap opens between them.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from mjframes.app.drawn import skin_faces
from mjframes.surface.decimate import decimate


@dataclass(frozen=True, eq=False)
class CoarseSkin:
    """What stands for a skin.

    vertices: (n,) which of the vertices of all of the model's skins.  faces: (m, 3) triangles of these n.
    """

    vertices: np.ndarray
    faces: np.ndarray


def coarse_skins(model: mujoco.MjModel, target: int) -> list[CoarseSkin]:
    """Return what stands for each of the model's skins.

    target: vertices of the skins on bones in common, all together, or more where their shape needs them.
    """
    found = [CoarseSkin(np.zeros(0, int), np.zeros((0, 3), int))] * model.nskin
    for together in _groups(model):
        skin_of, fine = [], []
        for skin in together:
            faces = model.skin_vertadr[skin] + skin_faces(model, skin)
            fine.append(faces)
            skin_of.append(np.full(len(faces), skin))
        for skin, faces in _coarse(model.skin_vert, np.concatenate(fine), np.concatenate(skin_of), target).items():
            used, local = np.unique(faces, return_inverse=True)
            found[skin] = CoarseSkin(used, local.reshape(-1, 3))
    return found


def _groups(model: mujoco.MjModel) -> list[np.ndarray]:
    """The numbers of the skins, those with bones in common together."""
    skin = np.repeat(np.arange(model.nskin), model.skin_bonenum)
    rides = sparse.csr_array((np.ones(len(skin)), (skin, model.skin_bonebodyid)), (model.nskin, model.nbody))
    _, group = connected_components(rides @ rides.T)
    return [np.flatnonzero(group == number) for number in range(group.max(initial=-1) + 1)]


def _coarse(vertices: np.ndarray, faces: np.ndarray, label: np.ndarray, target: int) -> dict[int, np.ndarray]:
    """Label → triangles, of fewer of the vertices (s, 3).  faces: (t, 3), of several labels (t,).

    A new triangle has the label of the old one whose centre is nearest.
    """
    used: np.ndarray = np.unique(faces)
    places, first, number = np.unique(vertices[used], axis=0, return_index=True, return_inverse=True)
    joined = np.empty(len(vertices), int)  # skins that meet have vertices of their own there
    joined[used] = number.ravel()
    fewer, triangles = decimate(places, joined[faces], target)
    nearest = np.asarray(KDTree(places).query(fewer)[1])
    corners = nearest[triangles]
    corners = corners[(corners != np.roll(corners, 1, axis=1)).all(axis=1)]
    centers = KDTree(vertices[faces].mean(axis=1))
    own = label[centers.query(places[corners].mean(axis=1))[1]]
    return {int(number): used[first][corners[own == number]] for number in np.unique(own)}
