"""A scene as Foxglove's 3D panel draws it, by its schemas `SceneUpdate` and `FrameTransforms`, and its image panel.

Rigid geoms are said once, each in the frame of its body, and go where the transforms take that. Skins are said anew in
every message, deformed, in the frame of the world, with some of their vertices only (`coarse`) and these rounded: they
are to be looked at, while films are drawn from states.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from functools import partial

import mujoco
import numpy as np
from foxglove.messages import (
    ArrowPrimitive,
    Color,
    CompressedVideo,
    CubePrimitive,
    CylinderPrimitive,
    FrameTransform,
    FrameTransforms,
    Point3,
    Pose,
    Quaternion,
    RawImage,
    SceneEntity,
    SceneUpdate,
    SpherePrimitive,
    Timestamp,
    TriangleListPrimitive,
    Vector3,
)

from mjframes.app.dented import skin_vertices
from mjframes.app.drawn import Shape, drawn_geoms, shapes, skin_color
from mjframes.app.log.coarse import coarse_skins
from mjframes.app.log.numbers import nanoseconds_of
from mjframes.app.taxel_picture import TaxelPicture
from mjframes.scene.taxels import taxel_maps

Drawing = CompressedVideo | FrameTransforms | RawImage | SceneUpdate
WORLD = "world"
HEAD = 0.25  # [-] of an arrow's length that is its head
RED = (0.9, 0.2, 0.1, 1.0)
VERTICES = 1000  # of the skins of a body, about: a steak of 0.25 m stays within 3 mm
ROUNDING = 1e-3  # [-] of the size of all skins at rest, at most: between vertices' places, which then compress


def transforms(model: mujoco.MjModel, data: mujoco.MjData, time: float) -> FrameTransforms:
    """Return where the bodies are in the world."""
    now = _timestamp(time)
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
    pieces: dict[str, list[Shape]] = {}
    for geom in drawn_geoms(model):
        pieces.setdefault(frame_name(model, int(model.geom_bodyid[geom])), []).extend(shapes(model, geom))
    return SceneUpdate(entities=[_rigid_entity(frame, own) for frame, own in pieces.items()])


class Skins:
    """The skins of a model that has some, as a log has them."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model, self._scene = model, mujoco.MjvScene(model, 0)
        self._names = [model.skin(skin).name or f"skin_{skin}" for skin in range(model.nskin)]
        coarse = coarse_skins(model, VERTICES)
        self._vertices = [skin.vertices for skin in coarse]
        self._indices = [skin.faces.ravel().tolist() for skin in coarse]
        self._colors = [_color(skin_color(model, skin)) for skin in range(model.nskin)]
        size = np.ptp(model.skin_vert, axis=0).max()
        self._grid = 2.0 ** math.floor(math.log2(ROUNDING * size)) if size > 0 else 1.0  # a power of 2: few bits

    def update(self, data: mujoco.MjData, time: float) -> SceneUpdate:
        """Return the skins as they are deformed, one entity each."""
        places = np.round(np.concatenate(skin_vertices(self._model, data, self._scene)) / self._grid) * self._grid
        places += 0.0  # no −0, which differs from 0 in its bits
        own = zip(self._names, self._vertices, self._indices, self._colors, strict=True)
        return SceneUpdate(
            entities=[
                SceneEntity(
                    timestamp=_timestamp(time),
                    frame_id=WORLD,
                    id=name,
                    triangles=[TriangleListPrimitive(points=_points(places[vertices]), indices=indices, color=color)],
                )
                for name, vertices, indices, color in own
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
    entity = SceneEntity(timestamp=_timestamp(time), frame_id=WORLD, id="contact forces", arrows=arrows)
    return SceneUpdate(entities=[entity])


def taxel_image(picture: TaxelPicture, data: mujoco.MjData, time: float) -> RawImage:
    """Return what a map of taxels feels, as a picture."""
    pixels = picture.draw(data)
    height, width, _ = pixels.shape
    return RawImage(
        timestamp=_timestamp(time),
        frame_id=picture.taxels.name,
        width=width,
        height=height,
        encoding="rgb8",
        step=3 * width,
        data=pixels.tobytes(),
    )


def video_frame(picture: bytes, camera: str, time: float) -> CompressedVideo:
    """Return a frame of H.264 in Annex B.  camera: its name."""
    return CompressedVideo(timestamp=_timestamp(time), frame_id=camera, data=picture, format="h264")


def _rigid_entity(frame: str, pieces: Iterable[Shape]) -> SceneEntity:
    cubes, spheres, cylinders, triangles = [], [], [], []
    for one in pieces:
        pose = Pose(position=_vector(one.position), orientation=_quaternion(one.quat))
        size, color = _vector(one.size), _color(one.rgba)
        if one.mesh is not None:
            vertices, faces = one.mesh
            indices = faces.ravel().tolist()
            triangles.append(TriangleListPrimitive(pose=pose, points=_points(vertices), indices=indices, color=color))
        elif one.kind == "box":
            cubes.append(CubePrimitive(pose=pose, size=size, color=color))
        elif one.kind == "ball":
            spheres.append(SpherePrimitive(pose=pose, size=size, color=color))
        else:
            cylinders.append(CylinderPrimitive(pose=pose, size=size, bottom_scale=1, top_scale=1, color=color))
    return SceneEntity(
        timestamp=_timestamp(0), frame_id=frame, id=frame, frame_locked=True,
        cubes=cubes, spheres=spheres, cylinders=cylinders, triangles=triangles,
    )  # fmt: skip


def _turn_of_x(direction: np.ndarray) -> np.ndarray:
    """Return the quaternion (w, x, y, z) that turns the x axis to a unit vector."""
    if direction[0] < -1 + 1e-12:
        return np.array([0.0, 0.0, 0.0, 1.0])
    turn = np.array([1 + direction[0], 0.0, -direction[2], direction[1]])
    return turn / np.linalg.norm(turn)


def _timestamp(time: float) -> Timestamp:
    """Return simulated time [s] as Foxglove has it."""
    return Timestamp(*divmod(nanoseconds_of(time), 10**9))


def _points(places: np.ndarray) -> list[Point3]:
    return [Point3(x=x, y=y, z=z) for x, y, z in places.tolist()]


def _vector(values: np.ndarray) -> Vector3:
    x, y, z = values.tolist()
    return Vector3(x=x, y=y, z=z)


def _quaternion(values: np.ndarray) -> Quaternion:
    w, x, y, z = values.tolist()
    return Quaternion(w=w, x=x, y=y, z=z)


def _color(values: np.ndarray | tuple[float, ...]) -> Color:
    r, g, b, a = map(float, values)
    return Color(r=r, g=g, b=b, a=a)


def channels(model: mujoco.MjModel) -> dict[str, Callable[[mujoco.MjData, float], Drawing]]:
    """Return what is drawn anew in every message, by topic, as CHANNELS has it; each map of taxels has a topic."""
    found = {topic: draw for topic, make in CHANNELS.items() if (draw := make(model))}
    return found | {f"/taxels/{one.name}": partial(taxel_image, TaxelPicture(one)) for one in taxel_maps(model)}


# What is drawn anew in every message: of a model, a function of its data and time [s], None where it has nothing of it
CHANNELS: dict[str, Callable[[mujoco.MjModel], Callable[[mujoco.MjData, float], Drawing] | None]] = {
    "/tf": lambda model: partial(transforms, model),
    "/scene/soft": lambda model: Skins(model).update if model.nskin else None,
    "/scene/forces": lambda model: partial(contact_forces, model),
}
