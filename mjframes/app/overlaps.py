"""Soft bodies that are inside each other: by how deep their contacts are, and at the start by what both fill.

Contacts push out what is in by less than half of the thinner body's thickness. Deeper inside, both sides are as near,
and there may be no contact at all. So at the start the volume is measured that both surfaces enclose: a point is inside
of a closed surface if the surface's solid angle there is 4π (Van Oosterom and Strackee, 1983).
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjframes.app.dented import skin_vertices
from mjframes.app.drawn import skin_faces
from mjframes.scene.instability import spread
from mjframes.scene.view import Soft
from mjframes.volume.meshes import winding_number

Array = NDArray[np.float64]

INSIDE = 0.5  # [-] of a body's size at rest, by which another may be in it: a cube's quarter
SHARED = 0.55  # [-] of the smaller body's volume that may be the other's as well, but for what the volume is off …
UNSEEN = 0.03  # … and so much if no contact pushes them apart
POINTS = 12  # along each axis, that find the volume: 3 % of what both fill


class Overlaps:
    """Finds soft bodies of a model that are inside each other."""

    def __init__(self, model: mujoco.MjModel, bodies: Mapping[str, Soft]) -> None:
        self._model, self._names = model, list(bodies)
        self._owner = np.full(model.ngeom, -1)  # number of the body that a geom belongs to
        for number, body in enumerate(bodies.values()):
            self._owner[body.patches] = number
        self._carriers = [np.unique(body.bodies) for body in bodies.values()]
        self._least = INSIDE * np.array([spread(body.mass, body.rest) for body in bodies.values()])

    def find(self, data: mujoco.MjData) -> dict[tuple[str, str], float]:
        """Return how deep [m] those are in each other that are, by the contacts that `data` has."""
        found: dict[tuple[str, str], float] = {}
        deep = np.flatnonzero(data.contact.dist < -self._least.min(initial=np.inf))
        for (first, second), depth in zip(self._pairs(data, deep), -data.contact.dist[deep], strict=True):
            if 0 <= first < second and depth > min(self._least[[first, second]]):
                pair = self._names[first], self._names[second]
                found[pair] = max(found.get(pair, 0.0), float(depth))
        return found

    def shared(self, data: mujoco.MjData) -> dict[tuple[str, str], float]:
        """Return the share [-] of the smaller one's volume that is the other's as well, of those that can collide and
        that contacts may not push apart.

        data: after `mj_forward`.
        """
        if len(self._names) < 2:
            return {}
        touching = set(self._pairs(data, np.arange(data.ncon)))
        vertices = skin_vertices(self._model, data, mujoco.MjvScene(self._model, 0))
        surfaces = [self._surface(number, vertices) for number in range(len(self._names))]
        found: dict[tuple[str, str], float] = {}
        for first, second in combinations(range(len(self._names)), 2):
            most = SHARED if (first, second) in touching else UNSEEN
            share = overlap(surfaces[first], surfaces[second], most)
            if share > most and self._collide(first, second):
                found[self._names[first], self._names[second]] = share
        return found

    def _pairs(self, data: mujoco.MjData, contacts: NDArray[np.integer]) -> list[tuple[int, int]]:
        """The bodies that touch by these contacts, the lower number first; -1 for what is not soft."""
        geoms = data.contact.geom[contacts]
        return [(int(a), int(b)) for a, b in np.sort(np.where(geoms >= 0, self._owner[geoms], -1), axis=1)]

    def _surface(self, number: int, vertices: list[np.ndarray]) -> Array:
        """Triangles (m, 3, 3) of the skins that the body moves [m]."""
        model, found = self._model, [np.zeros((0, 3, 3))]
        for skin in range(model.nskin):
            bones = model.skin_bonebodyid[model.skin_boneadr[skin] :][: model.skin_bonenum[skin]]
            if np.isin(bones, self._carriers[number]).any():
                found.append(vertices[skin][skin_faces(model, skin)])
        return np.concatenate(found)

    def _collide(self, first: int, second: int) -> bool:
        """Whether MuJoCo looks for contacts between any geoms of both."""
        model = self._model
        a, b = (np.flatnonzero(self._owner == number) for number in (first, second))
        kinds = (model.geom_contype[a, None] & model.geom_conaffinity[b]) | (
            model.geom_contype[b] & model.geom_conaffinity[a, None]
        )
        low, high = (f(model.geom_bodyid[a, None], model.geom_bodyid[b]) for f in (np.minimum, np.maximum))
        return bool(((kinds != 0) & ~np.isin((low << 16) + high, model.exclude_signature)).any())


def overlap(first: Array, second: Array, least: float) -> float:
    """Return the share [-] of the smaller volume that two surfaces (m, 3, 3) both enclose, 0 if it is below `least`."""
    if not (len(first) and len(second)):
        return 0.0
    smaller = min(_volume(first), _volume(second))
    low = np.maximum(first.min(axis=(0, 1)), second.min(axis=(0, 1)))
    sides = np.minimum(first.max(axis=(0, 1)), second.max(axis=(0, 1))) - low
    if (sides <= 0).any() or not 0 < least * smaller < sides.prod():
        return 0.0
    steps = (np.arange(POINTS) + 0.5) / POINTS
    points = low + sides * np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    both = winding_number(points, first) > 0.5
    both[both] = winding_number(points[both], second) > 0.5
    return float(both.mean() * sides.prod() / smaller)


def _volume(surface: Array) -> float:
    return float(np.linalg.det(surface - surface[0, 0]).sum()) / 6
