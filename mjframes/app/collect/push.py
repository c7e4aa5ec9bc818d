"""Pushes: a force of a tenth of a second on one place of a body, each world's own.

Its size is drawn evenly between the bounds, its direction evenly on the sphere, its start evenly in the time that
there is. A soft body is pushed at one of the vertices of its skins, another one at its centre of mass.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from mjframes.app.carried import Carried, on_body, on_skin
from mjframes.app.collect.options import Bounds
from mjframes.app.collect.variation import stream
from mjframes.base.errors import MjframesError
from mjframes.scene.forces import wrenches
from mjframes.scene.view import soft, soft_names

LENGTH = 0.1  # [s] that a push lasts


@dataclass(frozen=True, eq=False)
class Push:
    """The pushes on one body.

    body: its name.  bounds: of the force [N].  number: of the MuJoCo body, of one that is not soft.
    vertices: (v, 2) skin and number there of each vertex of a soft one.
    """

    body: str
    bounds: Bounds
    number: int
    vertices: np.ndarray

    def draw(self, seed: int, world: int, seconds: float) -> dict[str, float]:
        """Return a world's push: its force [N] along the world's axes, when it starts [s], and the vertex."""
        low, high = self.bounds
        random = stream(seed, world, f"{self.body}.push")
        size, start = low + (high - low) * random.random(), max(0.0, seconds - LENGTH) * random.random()
        direction = random.normal(size=3)
        force = size * direction / np.linalg.norm(direction)
        drawn = {f"{self.body}.push.{axis}": float(part) for axis, part in zip("xyz", force, strict=True)}
        drawn[f"{self.body}.push.time"] = float(start)
        if len(self.vertices):
            drawn[f"{self.body}.push.vertex"] = int(random.integers(len(self.vertices)))
        return drawn

    def wrenches(self, model: mujoco.MjModel, data: mujoco.MjData, drawn: Mapping[str, float]) -> np.ndarray:
        """Return what the push is in `xfrc_applied` (nbody, 6).

        data: at the start, after `mj_kinematics`; torques on rigid frames keep the arms that they have there.
        """
        force = np.array([drawn[f"{self.body}.push.{axis}"] for axis in "xyz"])
        point = self._point(model, drawn)
        return wrenches(data, point.bodies, point.seen(data), point.weights[:, None] * force)

    def _point(self, model: mujoco.MjModel, drawn: Mapping[str, float]) -> Carried:
        if not len(self.vertices):
            return on_body(self.number, model.body_ipos[self.number])
        skin, vertex = self.vertices[int(drawn[f"{self.body}.push.vertex"])].tolist()
        return on_skin(model, skin, vertex)


def pushes(
    model: mujoco.MjModel, data: mujoco.MjData, wanted: Sequence[tuple[str, Bounds]], seconds: float
) -> tuple[Push, ...]:
    """Return the pushes that are asked for; data: what they are reckoned in.

    Raise MjframesError for bodies that are not there or do not move, forces below 0, and where there is no time.
    """
    if wanted and seconds < LENGTH:
        raise MjframesError(f"seconds is {seconds:g}, and a push takes {LENGTH:g} s; give more, or leave push out.")
    found = []
    for name, bounds in wanted:
        if bounds[0] < 0:
            raise MjframesError(
                f"push of {name!r} goes from {bounds[0]:g} N; directions are random, give sizes from 0 on."
            )
        if name in soft_names(model):
            found.append(Push(name, bounds, -1, _vertices(model, soft(model, data, name).bodies, name)))
        else:
            found.append(Push(name, bounds, _moving_body(model, name), np.zeros((0, 2), int)))
    return tuple(found)


def _vertices(model: mujoco.MjModel, bodies: np.ndarray, name: str) -> np.ndarray:
    """(v, 2) the vertices of the skins whose bones are all among the bodies."""
    bones = [model.skin_bonebodyid[a : a + n] for a, n in zip(model.skin_boneadr, model.skin_bonenum, strict=True)]
    own = [skin for skin, some in enumerate(bones) if np.isin(some, bodies).all()]
    if not own:
        raise MjframesError(f"push has {name!r}, which has no skin and so no surface to push; leave it out.")
    return np.array([(skin, vertex) for skin in own for vertex in range(model.skin_vertnum[skin])])


def _moving_body(model: mujoco.MjModel, name: str) -> int:
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)
    if body < 0 or model.body_weldid[body] == 0:
        moving = [model.body(b).name for b in range(1, model.nbody) if model.body_weldid[b]]
        known = ", ".join(map(repr, [*soft_names(model), *(n for n in moving if n and ":" not in n)])) or "none"
        raise MjframesError(f"push has {name!r}, which does not move; what does is: {known}.")
    return body
