"""The bodies of a scene that hold pieces of a soft body: their names, their order, their poses at the reference.

A pose is (R, t) with p_outer = R p_inner + t. MuJoCo resolves orientations only when it compiles: each body and frame
is compiled alone here, so that a scene needs not be complete.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import mujoco
import numpy as np

from mjframes.base.errors import MjframesError
from mjframes.base.numbers import is_number

Pose = tuple[np.ndarray, np.ndarray]  # (3, 3), (3,) [m]


def find_body(spec: mujoco.MjSpec, name: str, said: str = "parent is", where: object = "the scene") -> mujoco.MjsBody:
    """Return the body `name` of the spec. Raise MjframesError, as it is `said`, where there is none."""
    body = spec.body(name)
    if body is None:
        known = ", ".join(repr(other.name) for other in spec.bodies if other.name)
        raise MjframesError(f"{said} {name!r}, but the bodies of {where} are: {known}.")
    return body


def path_of(body: mujoco.MjsBody) -> list[mujoco.MjsBody]:
    """Return the body and all that it hangs on, the world last."""
    path = [body]
    while path[-1].parent is not None:
        path.append(path[-1].parent)
    return path


def best_holder(parent: mujoco.MjsBody, links: Iterable[mujoco.MjsBody]) -> mujoco.MjsBody:
    """Return the one of these bodies with the most of the links at and above it; `parent` of equals.

    The frames hang on it: what is above them in the tree can be coupled to them in MuJoCo's inertia matrix.
    """
    links = list(links)
    return max([parent, *links], key=lambda body: sum(link in path_of(body) for link in links))


def is_static(link: mujoco.MjsBody, holder: mujoco.MjsBody) -> bool:
    """Return whether no joint stands between the link and the nearest body that it shares with the holder's path."""
    shared = path_of(holder)
    return all(not body.joints for body in path_of(link) if body not in shared)


def moves(body: mujoco.MjsBody) -> bool:
    """Return whether it is on a kinematic tree or a mocap body."""
    return any(outer.joints or outer.mocap for outer in path_of(body)[:-1])


def pose_in_world(body: mujoco.MjsBody) -> Pose:
    """Return the pose of the body in the world, at the model's reference configuration."""
    pose: Pose = (np.eye(3), np.zeros(3))
    for inner in path_of(body)[:-1]:
        element = inner
        while element is not None:
            pose = compose(_own_pose(element), pose)
            element = element.frame
    return pose


def site_in_world(site: mujoco.MjsSite) -> np.ndarray:
    """Return where a site is (3,) [m], at the model's reference configuration."""
    place: Pose = (np.eye(3), np.array(site.pos, float))
    element = site.frame
    while element is not None:
        place = compose(_own_pose(element), place)
        element = element.frame
    return compose(pose_in_world(site.parent), place)[1]


def compose(outer: Pose, inner: Pose) -> Pose:
    """Return the pose of what `inner` places, placed by `outer`."""
    return outer[0] @ inner[0], outer[0] @ inner[1] + outer[1]


def inverse(pose: Pose) -> Pose:
    """Return the pose of the outer coordinate system in the inner one."""
    return pose[0].T, -pose[0].T @ pose[1]


def pose(pos: Iterable[float], quat: Iterable[float]) -> Pose:
    """Return a pose from a position [m] and a quaternion of any length."""
    matrix = np.zeros(9)
    q = np.array(list(quat), float)
    mujoco.mju_quat2Mat(matrix, q / np.linalg.norm(q))
    return matrix.reshape(3, 3), np.array(list(pos), float)


def require_pose(pos: Sequence[float] | np.ndarray, quat: Sequence[float] | np.ndarray) -> None:
    """Raise MjframesError for what is no position [m] and quaternion (w, x, y, z) of any length."""
    if np.shape(pos) != (3,) or np.shape(quat) != (4,) or not all(map(is_number, (*pos, *quat))) or not np.any(quat):
        raise MjframesError(
            f"pos is {pos!r} and quat is {quat!r}; "
            "give three metres and four quaternion components, of which not all are 0."
        )


def quaternion(rotation: np.ndarray) -> np.ndarray:
    """Return the quaternion (4,) of a rotation matrix (3, 3)."""
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, np.ravel(rotation))
    return quat


def _own_pose(element: mujoco.MjsBody | mujoco.MjsFrame) -> Pose:
    """In the frame or body that it stands in."""
    alone = mujoco.MjSpec()
    alone.compiler.degree = element.compiler.degree
    alone.compiler.eulerseq = element.compiler.eulerseq
    body = alone.worldbody.add_body(pos=element.pos, quat=element.quat)
    for field in ("type", "axisangle", "xyaxes", "zaxis", "euler"):
        setattr(body.alt, field, getattr(element.alt, field))
    model = alone.compile()
    return pose(model.body_pos[1], model.body_quat[1])
