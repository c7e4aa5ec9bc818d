"""Pushes: a force of a tenth of a second on one place of a body, each world's own.

Its size is drawn evenly between the bounds, its direction evenly on the sphere, its start evenly in the time that
there is. A soft body is pushed at one of its contact vertices, by the control weights there; another one at its centre
of mass.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from mjframes.app.collect.plan import Bounds
from mjframes.app.collect.variation import stream
from mjframes.base.errors import MjframesError
from mjframes.scene.forces import wrenches
from mjframes.scene.plugin_text import decode
from mjframes.scene.view import Soft, soft, soft_names

LENGTH = 0.1  # [s] that a push lasts


@dataclass(frozen=True, eq=False)
class Push:
    """The pushes on one body.

    body: its name.  bounds: of the force [N].  number: of the MuJoCo body, of one that is not soft.
    view: of a soft one.  weights: (k, vertices) of its control points at its contact vertices.
    """

    body: str
    bounds: Bounds
    number: int
    view: Soft | None
    weights: np.ndarray

    def draw(self, seed: int, world: int, seconds: float) -> dict[str, float]:
        """Return a world's push: its force [N] along the world's axes, when it starts [s], and the vertex."""
        low, high = self.bounds
        random = stream(seed, world, f"{self.body}.push")
        size, start = low + (high - low) * random.random(), max(0.0, seconds - LENGTH) * random.random()
        direction = random.normal(size=3)
        force = size * direction / np.linalg.norm(direction)
        drawn = {f"{self.body}.push.{axis}": float(part) for axis, part in zip("xyz", force, strict=True)}
        drawn[f"{self.body}.push.time"] = float(start)
        if self.view is not None:
            drawn[f"{self.body}.push.vertex"] = int(random.integers(self.weights.shape[1]))
        return drawn

    def wrenches(self, data: mujoco.MjData, drawn: Mapping[str, float]) -> np.ndarray:
        """Return what the push is in `xfrc_applied` (nbody, 6).

        data: at the start, after `mj_kinematics`; torques on rigid frames keep the arms that they have there.
        """
        force = np.array([drawn[f"{self.body}.push.{axis}"] for axis in "xyz"])
        if self.view is None:
            found = np.zeros_like(data.xfrc_applied)
            found[self.number, :3] = force
            return found
        on_points = self.weights[:, int(drawn[f"{self.body}.push.vertex"]), None] * force
        return wrenches(data, self.view.bodies, self.view.control_positions, on_points)


def pushes(
    model: mujoco.MjModel, data: mujoco.MjData, wanted: Sequence[tuple[str, Bounds]], seconds: float
) -> tuple[Push, ...]:
    """Return the pushes that are asked for; data: what they are reckoned in.

    Raise MjframesError for bodies that are not there or do not move, forces below 0, what is asked for twice, and where
    there is no time for a push.
    """
    found: dict[str, Push] = {}
    for name, bounds in wanted:
        if bounds[0] < 0:
            raise MjframesError(
                f"push of {name!r} goes from {bounds[0]:g} N; directions are random, give sizes from 0 on."
            )
        if name in found:
            raise MjframesError(f"push has {name!r} twice; leave one of them out.")
        if seconds < LENGTH:
            raise MjframesError(f"seconds is {seconds:g}, and a push takes {LENGTH:g} s; give more, or leave push out.")
        if name in soft_names(model):
            view = soft(model, data, name)
            found[name] = Push(name, bounds, -1, view, _vertex_weights(view))
        else:
            found[name] = Push(name, bounds, _moving_body(model, name), None, np.zeros((0, 0)))
    return tuple(found.values())


def _vertex_weights(view: Soft) -> np.ndarray:
    """(k, vertices) of the control points at the contact vertices of a soft body."""
    if "patch_size" not in view.configuration:
        raise MjframesError(f"push has {view.name!r}, which has no contact and so no surface to push; leave it out.")
    sizes, clusters, counts, points, weights = (
        decode(view.configuration[f"patch_{key}"]) for key in ("size", "clusters", "cluster_size", "point", "weight")
    )
    sizes, clusters = sizes.astype(int), clusters.astype(int)
    vertices = [int(some.sum()) for some in np.split(counts, np.cumsum(clusters)[:-1].astype(int))]
    found = np.zeros((len(view.bodies), sum(vertices)))
    of_patch = np.split(points.astype(int), np.cumsum(sizes)[:-1])
    blocks = np.split(weights, np.cumsum(sizes * np.array(vertices))[:-1].astype(int))
    ends = np.cumsum(vertices).tolist()
    for own, block, count, end in zip(of_patch, blocks, vertices, ends, strict=True):
        found[own, end - count : end] = block.reshape(len(own), count)
    return found


def _moving_body(model: mujoco.MjModel, name: str) -> int:
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)
    if body < 0 or model.body_weldid[body] == 0:
        moving = [model.body(b).name for b in range(1, model.nbody) if model.body_weldid[b]]
        known = ", ".join(map(repr, [*soft_names(model), *(n for n in moving if n and ":" not in n)])) or "none"
        raise MjframesError(f"push has {name!r}, which does not move; what does is: {known}.")
    return body
