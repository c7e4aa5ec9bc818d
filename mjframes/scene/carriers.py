"""The MuJoCo bodies that control points ride on, as they are written: six digits, point masses, nested along the tree.

A point of a `point`, `affine` or `quadratic` frame has a body of its own on three slides. The four of a `rigid` frame
share one on three slides and a ball. Those of a held frame share one without joints, on the body that holds it. Point
masses are equimomental, so a shared body has exactly the frame's mass and inertia.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mjframes.base.errors import MjframesError
from mjframes.body.soft_body import SoftBody
from mjframes.scene.links import Pose, compose, inverse, quaternion

DIGITS = 12  # decimals in SI: what is smaller is rounding, and MuJoCo saves it as 0
SLIDER_INERTIA = 1e-6  # [-] of m size²: a point mass has none, but MuJoCo wants a positive one; slides never turn
LEAST_INERTIA = 1e-9  # [-] of m size²: of a shared body about the thinnest direction of its points


@dataclass(frozen=True, eq=False)
class Carrier:
    """One body of the model that carries control points.

    points: (p,) that ride on it.
    parent: the carrier it hangs on, −1 for the soft body's holder.
    joints: "slides", "free" (slides and ball), "".
    link: name of the scene's body that it is fixed to, without joints.
    offset: (3,) in what it hangs on [m].
    pose: of it at rest, in the volume's coordinates.
    mass: [kg].
    inertia: (3,) principal moments [kg m²].
    quat: (4,) of their axes in it.
    """

    points: np.ndarray
    parent: int
    link: str
    joints: str
    offset: list[float]
    pose: Pose
    mass: float
    inertia: list[float]
    quat: list[float]

    def local(self, rest: np.ndarray) -> np.ndarray:
        """Return points at rest (p, 3), in the body's axes [m]."""
        rotation, position = self.pose
        return (rest - position) @ rotation


def carriers(body: SoftBody, links: dict[str, Pose]) -> list[Carrier]:
    """Return carriers in the order of the frames.

    links: the pose of each scene body that holds a frame, in volume coordinates.
    """
    found: list[Carrier] = []
    last = {-1: -1}  # carrier that the children of a frame hang on
    size = np.ptp(body.control.rest, axis=0).max()
    for i, frame_type in enumerate(body.types):
        points = np.flatnonzero(body.control.frame == i)
        shared = i < body.held or frame_type == "rigid"
        above = last[int(body.parent[i])]
        for some in [points] if shared else np.split(points, len(points)):
            link = body.links[i] if i < body.held else ""
            outer = links[link] if i < body.held else _pose_of(found, above)
            mass = body.control.mass[some]
            centre = mass @ body.control.rest[some] / mass.sum()
            offset = printable(compose(inverse(outer), (np.eye(3), centre))[1])
            pose = compose(outer, (np.eye(3), np.array(offset)))
            inertia, quat = _inertia(body, some, pose) if shared else (printable(np.zeros(3)), [1.0, 0.0, 0.0, 0.0])
            least = (LEAST_INERTIA if shared else SLIDER_INERTIA) * mass.sum() * size**2
            least = max(least, 10.0**-DIGITS)  # of a body of a few millimetres it would round to zero
            found.append(
                Carrier(
                    points=some,
                    parent=-1 if i < body.held else above,
                    link=link,
                    joints="" if i < body.held else "free" if shared else "slides",
                    offset=offset,
                    pose=pose,
                    mass=printable(mass.sum())[0],
                    inertia=printable(np.maximum(inertia, least)),
                    quat=quat,
                )
            )
            above = len(found) - 1
        last[i] = above
    return found


def carrier_of(carried: Sequence[Carrier]) -> np.ndarray:
    """Return (k,) the carrier of each control point."""
    found = np.empty(sum(len(carrier.points) for carrier in carried), int)
    for c, carrier in enumerate(carried):
        found[carrier.points] = c
    return found


def too_small(body: SoftBody, name: str) -> MjframesError:
    """Return what to raise for a body whose masses or meshes are none for MuJoCo."""
    size = np.ptp(body.control.rest, axis=0).max()
    return MjframesError(
        f"{name}: its control points span {1e6 * size:.2g} µm, too little for MuJoCo's masses and meshes; give lengths "
        "in metres (spacing, scale, --unit), or model it larger."
    )


def printable(values: np.ndarray | np.floating | float) -> list[float]:
    """Return values rounded to the six digits that MuJoCo saves, so that a saved model is the same to the bit."""
    return [float(f"{value:.6g}") for value in np.round(np.atleast_1d(values), DIGITS)]


def printable_quaternion(quat: np.ndarray) -> list[float]:
    """Return the same rotation in six digits that MuJoCo's normalization and saving leave as they are."""
    rounded = printable(quat / np.linalg.norm(quat))
    for _ in range(20):  # each rounding is half a digit off: a few times is enough
        again = printable(np.array(rounded) / np.linalg.norm(rounded))
        if again == rounded:
            break
        rounded = again
    return rounded


def _pose_of(found: list[Carrier], carrier: int) -> Pose:
    return found[carrier].pose if carrier >= 0 else (np.eye(3), np.zeros(3))


def _inertia(body: SoftBody, points: np.ndarray, pose: Pose) -> tuple[list[float], list[float]]:
    """Principal moments (3,) of the point masses about the carrier's origin, and the quaternion of their axes in it."""
    arm = (body.control.rest[points] - pose[1]) @ pose[0]
    second = (body.control.mass[points, None] * arm).T @ arm
    moments, axes = np.linalg.eigh(np.trace(second) * np.eye(3) - second)
    axes[:, 0] *= np.linalg.det(axes)
    return printable(moments), printable_quaternion(quaternion(axes))
