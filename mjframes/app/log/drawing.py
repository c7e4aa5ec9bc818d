"""A scene as Foxglove's 3D panel draws it: its schemas `SceneUpdate` and `FrameTransforms`.

Rigid geoms are said once, each in the frame of its body, and go where the transforms take that. Skins are said anew in
every message, deformed, in the frame of the world, with some of their vertices only (`coarse`) and these rounded: they
are to be looked at, while films are drawn from states.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import mujoco
import numpy as np
from foxglove_schemas_protobuf.ArrowPrimitive_pb2 import ArrowPrimitive
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.CubePrimitive_pb2 import CubePrimitive
from foxglove_schemas_protobuf.CylinderPrimitive_pb2 import CylinderPrimitive
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.SpherePrimitive_pb2 import SpherePrimitive
from foxglove_schemas_protobuf.TriangleListPrimitive_pb2 import TriangleListPrimitive
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.timestamp_pb2 import Timestamp

from mjframes.app.drawn import drawn_geoms, geom_color, plane_size, skin_color, skin_vertices, surface
from mjframes.app.log.coarse import coarse_skins
from mjframes.app.log.numbers import nanoseconds_of

WORLD = "world"
HEAD = 0.25  # [-] of an arrow's length that is its head
RED = (0.9, 0.2, 0.1, 1.0)
VERTICES = 1000  # of the skins of a body, about: a steak of 0.25 m stays within 3 mm
ROUNDING = 1e-3  # [-] of the size of all skins at rest, at most: between vertices' places, which then compress

# One Point3 of the field `points` in protobuf's wire format: a thousand of them take 0.1 ms so, 5 ms as objects
POINT = np.dtype(
    [("tag", "V2"), ("x_tag", "V1"), ("x", "<f8"), ("y_tag", "V1"), ("y", "<f8"), ("z_tag", "V1"), ("z", "<f8")]
)
POINTS_TAG = TriangleListPrimitive.DESCRIPTOR.fields_by_name["points"].number << 3 | 2  # of what has a length


def timestamp(time: float) -> Timestamp:
    """Return simulated time [s] as protobuf has it."""
    seconds, nanoseconds = divmod(nanoseconds_of(time), 10**9)
    return Timestamp(seconds=seconds, nanos=nanoseconds)


def transforms(model: mujoco.MjModel, data: mujoco.MjData, time: float) -> FrameTransforms:
    """Return where the bodies are in the world."""
    now = timestamp(time)
    return FrameTransforms(
        transforms=[
            FrameTransform(
                timestamp=now,
                parent_frame_id=WORLD,
                child_frame_id=frame_name(model, body),
                translation=_vector(data.xpos[body]),
                rotation=_quaternion(data.xquat[body]),
            )
            for body in range(1, model.nbody)
        ]
    )


def frame_name(model: mujoco.MjModel, body: int) -> str:
    """Return the frame of a body: its name, `body_3` where it has none."""
    return model.body(body).name or f"body_{body}"


def rigid_scene(model: mujoco.MjModel) -> SceneUpdate:
    """Return the rigid geoms, one entity a body, which follows that body's frame."""
    entities = {}
    for geom in drawn_geoms(model):
        draw = SHAPES.get(int(model.geom_type[geom]))
        if draw is None:
            continue
        frame = frame_name(model, int(model.geom_bodyid[geom]))
        new = SceneEntity(timestamp=timestamp(0), frame_id=frame, id=frame, frame_locked=True)
        draw(model, geom, entities.setdefault(frame, new), _color(geom_color(model, geom)))
    return SceneUpdate(entities=entities.values())


class Skins:
    """The skins of a model that has some, as a log has them."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model, self._scene = model, mujoco.MjvScene(model, 0)
        self._names = [model.skin(skin).name or f"skin_{skin}" for skin in range(model.nskin)]
        coarse = coarse_skins(model, VERTICES)
        self._vertices = [skin.vertices for skin in coarse]
        self._constant = [  # what does not change of their triangles, serialized
            TriangleListPrimitive(
                indices=own.faces.ravel().tolist(), color=_color(skin_color(model, skin))
            ).SerializeToString()
            for skin, own in enumerate(coarse)
        ]
        size = np.ptp(model.skin_vert, axis=0).max()
        self._grid = 2.0 ** math.floor(math.log2(ROUNDING * size)) if size > 0 else 1.0  # a power of 2: few bits

    def update(self, data: mujoco.MjData, time: float) -> SceneUpdate:
        """Return the skins as they are deformed, one entity each."""
        places = np.round(np.concatenate(skin_vertices(self._model, data, self._scene)) / self._grid) * self._grid
        places += 0.0  # no −0, which differs from 0 in its bits
        return SceneUpdate(
            entities=[
                SceneEntity(
                    timestamp=timestamp(time),
                    frame_id=WORLD,
                    id=name,
                    triangles=[TriangleListPrimitive.FromString(point_bytes(places[vertices]) + constant)],
                )
                for name, vertices, constant in zip(self._names, self._vertices, self._constant, strict=True)
            ]
        )


def contact_forces(model: mujoco.MjModel, data: mujoco.MjData, time: float) -> SceneUpdate:
    """Return an arrow for the force that each contact's first geom puts on the second, as long as MuJoCo draws it."""
    arrows, wrench = [], np.zeros(6)
    length = model.vis.map.force / model.stat.meanmass  # [m/N]
    width = model.vis.scale.forcewidth * model.stat.meansize  # [m]
    for number in range(data.ncon):
        mujoco.mj_contactForce(model, data, number, wrench)
        contact = data.contact[number]
        force = np.reshape(contact.frame, (3, 3)).T @ wrench[:3]
        size = float(np.linalg.norm(force))
        if size > 0:
            arrow = ArrowPrimitive(
                pose=Pose(position=_vector(contact.pos), orientation=_quaternion(_turn_of_x(force / size))),
                shaft_length=(1 - HEAD) * length * size,
                shaft_diameter=width,
                head_length=HEAD * length * size,
                head_diameter=2 * width,
                color=_color(RED),
            )
            arrows.append(arrow)
    entity = SceneEntity(timestamp=timestamp(time), frame_id=WORLD, id="contact forces", arrows=arrows)
    return SceneUpdate(entities=[entity])


def point_bytes(points: np.ndarray) -> bytes:
    """Return points (n, 3) as the field `points` of a serialized TriangleListPrimitive."""
    table = np.empty(len(points), POINT)
    table["tag"] = bytes([POINTS_TAG, POINT.itemsize - 2])
    for number, axis in enumerate("xyz", start=1):
        table[f"{axis}_tag"] = bytes([number << 3 | 1])  # eight bytes follow
        table[axis] = points[:, number - 1]
    return table.tobytes()


def _plane(model: mujoco.MjModel, geom: int, entity: SceneEntity, color: Color) -> None:
    size = plane_size(model, geom)
    pose = _pose(model, geom, (0, 0, -size[2] / 2))
    entity.cubes.append(CubePrimitive(pose=pose, size=_vector(size), color=color))


def _ball(model: mujoco.MjModel, geom: int, entity: SceneEntity, color: Color) -> None:
    sphere = model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_SPHERE
    size = 2 * (np.repeat(model.geom_size[geom, 0], 3) if sphere else model.geom_size[geom])
    entity.spheres.append(SpherePrimitive(pose=_pose(model, geom), size=_vector(size), color=color))


def _cylinder(model: mujoco.MjModel, geom: int, entity: SceneEntity, color: Color) -> None:
    radius, half, _ = model.geom_size[geom]
    size = _vector((2 * radius, 2 * radius, 2 * half))
    cylinder = CylinderPrimitive(pose=_pose(model, geom), size=size, bottom_scale=1, top_scale=1, color=color)
    entity.cylinders.append(cylinder)


def _capsule(model: mujoco.MjModel, geom: int, entity: SceneEntity, color: Color) -> None:
    _cylinder(model, geom, entity, color)
    radius, half, _ = model.geom_size[geom]
    for end in (-half, half):
        pose = _pose(model, geom, (0, 0, end))
        entity.spheres.append(SpherePrimitive(pose=pose, size=_vector(np.repeat(2 * radius, 3)), color=color))


def _box(model: mujoco.MjModel, geom: int, entity: SceneEntity, color: Color) -> None:
    size = _vector(2 * model.geom_size[geom])
    entity.cubes.append(CubePrimitive(pose=_pose(model, geom), size=size, color=color))


def _surface(model: mujoco.MjModel, geom: int, entity: SceneEntity, color: Color) -> None:
    vertices, faces = surface(model, geom)
    triangles = TriangleListPrimitive.FromString(point_bytes(vertices))
    triangles.pose.CopyFrom(_pose(model, geom))
    triangles.color.CopyFrom(color)
    triangles.indices.extend(faces.ravel().tolist())
    entity.triangles.append(triangles)


SHAPES: dict[int, Callable[[mujoco.MjModel, int, SceneEntity, Color], None]] = {
    int(mujoco.mjtGeom.mjGEOM_PLANE): _plane,
    int(mujoco.mjtGeom.mjGEOM_HFIELD): _surface,
    int(mujoco.mjtGeom.mjGEOM_SPHERE): _ball,
    int(mujoco.mjtGeom.mjGEOM_CAPSULE): _capsule,
    int(mujoco.mjtGeom.mjGEOM_ELLIPSOID): _ball,
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): _cylinder,
    int(mujoco.mjtGeom.mjGEOM_BOX): _box,
    int(mujoco.mjtGeom.mjGEOM_MESH): _surface,
    int(mujoco.mjtGeom.mjGEOM_SDF): _surface,
}


def _pose(model: mujoco.MjModel, geom: int, offset: tuple[float, float, float] = (0, 0, 0)) -> Pose:
    """Return a geom's pose in its body, moved by `offset` along its own axes."""
    turned = np.zeros(3)
    mujoco.mju_rotVecQuat(turned, np.array(offset, float), model.geom_quat[geom])
    return Pose(position=_vector(model.geom_pos[geom] + turned), orientation=_quaternion(model.geom_quat[geom]))


def _turn_of_x(direction: np.ndarray) -> np.ndarray:
    """Return the quaternion (w, x, y, z) that turns the x axis to a unit vector."""
    if direction[0] < -1 + 1e-12:
        return np.array([0.0, 0.0, 0.0, 1.0])
    turn = np.array([1 + direction[0], 0.0, -direction[2], direction[1]])
    return turn / np.linalg.norm(turn)


def _vector(values: np.ndarray | tuple[float, float, float]) -> Vector3:
    x, y, z = map(float, values)
    return Vector3(x=x, y=y, z=z)


def _quaternion(values: np.ndarray) -> Quaternion:
    w, x, y, z = map(float, values)
    return Quaternion(w=w, x=x, y=y, z=z)


def _color(values: np.ndarray | tuple[float, ...]) -> Color:
    r, g, b, a = map(float, values)
    return Color(r=r, g=g, b=b, a=a)
