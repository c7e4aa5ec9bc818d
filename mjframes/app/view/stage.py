"""A scene on viser's stage: geoms that follow their bodies, skins with vertices of their own, lights."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np
from viser import BoxHandle, CylinderHandle, FrameHandle, IcosphereHandle, MeshHandle, ViserServer

from mjframes.app.drawn import (
    drawn_geoms,
    geom_color,
    plane_size,
    skin_parts,
    skin_vertices,
    sky_color,
    surface,
)

Node = BoxHandle | CylinderHandle | IcosphereHandle | MeshHandle
GEOM = mujoco.mjtGeom
LINES = 20  # of a plane's grid, along its shorter side at least
FAR = 2.0  # [-] of the scene's extent: distance of a lamp that stands for light of one direction
LIT = (
    1.5  # [-] of the scene's extent: radius of what a lamp lights at most; its shadows are the coarser the wider it is
)
LAMP = np.pi  # [-] intensity of three.js for a lamp that lights as much as one of MuJoCo's
GLOSS = 0.04  # [-] intensity of the room that is mirrored: it lights little
BELOW = 150  # of 255: how bright the light from below is, of that from everywhere
AROUND = 0.5  # [-] of the head light's diffuse part that comes from everywhere instead


@dataclass(frozen=True, eq=False)
class Piece:
    """What is drawn of a skin in one colour.

    node: of viser.  skin: number of the skin.  used: which of its vertices (k,) the node has.
    """

    node: MeshHandle
    skin: int
    used: np.ndarray


class Stage:
    """What viser draws of a model.

    skins: the pieces of all skins.  vertices: of each skin as last drawn (n, 3) [m].
    rigid: nodes of geoms that move, with the body of each.
    """

    def __init__(self, server: ViserServer, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self._server, self._model = server, model
        self._scene = mujoco.MjvScene(model, 0)
        self._frames: dict[int, FrameHandle] = {}
        self.rigid: list[tuple[Node, int]] = []
        server.scene.set_up_direction("+z")
        _add_lights(server, model, data)
        if (sky := sky_color(model)) is not None:
            server.scene.set_background_image(np.full((1, 1, 3), np.round(255 * sky), np.uint8), format="png")
        for geom in drawn_geoms(model):
            self._add_geom(geom)
        self.vertices = skin_vertices(model, data, self._scene)
        self.skins = [piece for skin in range(model.nskin) for piece in self._add_skin(skin)]

    def draw(self, data: mujoco.MjData) -> None:
        """Show the present state."""
        self.vertices = skin_vertices(self._model, data, self._scene)
        with self._server.atomic():
            for piece in self.skins:
                piece.node.vertices = self.vertices[piece.skin][piece.used]
            for body, frame in self._frames.items():
                frame.position, frame.wxyz = data.xpos[body], data.xquat[body]

    def _add_skin(self, skin: int) -> list[Piece]:
        pieces = []
        for k, (faces, rgba) in enumerate(skin_parts(self._model, skin)):
            used, corners = np.unique(faces, return_inverse=True)
            color, opacity = _paint(rgba)
            vertices, faces = self.vertices[skin][used], corners.reshape(faces.shape)
            node = self._server.scene.add_mesh_simple(
                f"/skins/{skin}/{k}", vertices, faces, color=color, opacity=opacity
            )
            pieces.append(Piece(node, skin, used))
        return pieces

    def _add_geom(self, geom: int) -> None:
        model = self._model
        add = SHAPES.get(int(model.geom_type[geom]))
        if add is None:
            return
        body = int(model.geom_bodyid[geom])
        if body not in self._frames:
            self._frames[body] = self._server.scene.add_frame(f"/bodies/{body}", show_axes=False)
        name = f"/bodies/{body}/{geom}"
        self._server.scene.add_frame(name, show_axes=False, position=model.geom_pos[geom], wxyz=model.geom_quat[geom])
        nodes = add(self._server, model, geom, name)
        if model.body_weldid[body] > 0:
            self.rigid += [(node, body) for node in nodes]


def _paint(rgba: np.ndarray) -> tuple[tuple[int, int, int], float | None]:
    """Return viser's colour and opacity."""
    red, green, blue = (round(255 * float(part)) for part in np.clip(rgba[:3], 0, 1))
    return (red, green, blue), float(rgba[3]) if rgba[3] < 1 else None


def _plane(server: ViserServer, model: mujoco.MjModel, geom: int, name: str) -> list[Node]:
    """A slab, and lines on it that let one see how far things move."""
    size = plane_size(model, geom)
    color, opacity = _paint(geom_color(model, geom))
    width, length, thickness = size.tolist()
    server.scene.add_box(
        f"{name}/slab", color, (width, length, thickness), opacity=opacity, position=(0, 0, -thickness / 2),
        cast_shadow=False,
    )  # fmt: skip
    cell = _round_length(min(width, length) / LINES)
    red, green, blue = (round(0.85 * part) for part in color)
    server.scene.add_grid(
        f"{name}/lines", width, length, cell_size=cell, section_size=5 * cell, cell_color=(red, green, blue),
        section_color=(red, green, blue), section_thickness=1.5, shadow_opacity=0.0, position=(0, 0, 0.5 * thickness),
    )  # fmt: skip
    return []


def _round_length(length: float) -> float:
    """Return the greatest of 1, 2, 5, 10, … times a power of ten that is not greater."""
    power = 10 ** np.floor(np.log10(length))
    return float(max(step for step in (1, 2, 5) if step * power <= length * (1 + 1e-9)) * power)


def _ball(server: ViserServer, model: mujoco.MjModel, geom: int, name: str) -> list[Node]:
    sphere = model.geom_type[geom] == GEOM.mjGEOM_SPHERE
    x, y, z = (np.repeat(model.geom_size[geom, 0], 3) if sphere else model.geom_size[geom]).tolist()
    return [_icosphere(server, model, geom, f"{name}/ball", (x, y, z))]


def _icosphere(
    server: ViserServer,
    model: mujoco.MjModel,
    geom: int,
    name: str,
    size: tuple[float, float, float],
    height: float = 0,
) -> IcosphereHandle:
    color, opacity = _paint(geom_color(model, geom))
    return server.scene.add_icosphere(name, 1.0, color, scale=size, opacity=opacity, position=(0, 0, height))


def _cylinder(server: ViserServer, model: mujoco.MjModel, geom: int, name: str) -> list[Node]:
    radius, half, _ = model.geom_size[geom].tolist()
    color, opacity = _paint(geom_color(model, geom))
    return [server.scene.add_cylinder(f"{name}/side", radius, 2 * half, color, opacity=opacity)]


def _capsule(server: ViserServer, model: mujoco.MjModel, geom: int, name: str) -> list[Node]:
    radius, half, _ = model.geom_size[geom].tolist()
    ends = [_icosphere(server, model, geom, f"{name}/{k}", (radius, radius, radius), k * half) for k in (-1, 1)]
    return _cylinder(server, model, geom, name) + ends


def _box(server: ViserServer, model: mujoco.MjModel, geom: int, name: str) -> list[Node]:
    x, y, z = (2 * model.geom_size[geom]).tolist()
    color, opacity = _paint(geom_color(model, geom))
    return [server.scene.add_box(f"{name}/box", color, (x, y, z), opacity=opacity)]


def _surface(server: ViserServer, model: mujoco.MjModel, geom: int, name: str) -> list[Node]:
    vertices, faces = surface(model, geom)
    color, opacity = _paint(geom_color(model, geom))
    return [
        server.scene.add_mesh_simple(
            f"{name}/mesh", vertices, faces, color=color, opacity=opacity, flat_shading=True, side="double"
        )
    ]


SHAPES: dict[int, Callable[[ViserServer, mujoco.MjModel, int, str], list[Node]]] = {
    int(GEOM.mjGEOM_PLANE): _plane,
    int(GEOM.mjGEOM_HFIELD): _surface,
    int(GEOM.mjGEOM_SPHERE): _ball,
    int(GEOM.mjGEOM_CAPSULE): _capsule,
    int(GEOM.mjGEOM_ELLIPSOID): _ball,
    int(GEOM.mjGEOM_CYLINDER): _cylinder,
    int(GEOM.mjGEOM_BOX): _box,
    int(GEOM.mjGEOM_MESH): _surface,
    int(GEOM.mjGEOM_SDF): _surface,
}


def _add_lights(server: ViserServer, model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Put up the scene's lamps where they start, or viser's own if it has none, and light from everywhere."""
    lamps = [k for k in range(model.nlight) if model.light_active[k]]
    server.scene.configure_default_lights(enabled=not lamps)
    head = model.vis.headlight
    ambient = float(np.max(head.ambient) + AROUND * np.max(head.diffuse)) if head.active else 0.0
    server.scene.configure_environment_map("studio", environment_intensity=GLOSS)
    server.scene.add_light_hemisphere("/lights", ground_color=(BELOW, BELOW, BELOW), intensity=LAMP * ambient)
    for k in lamps:
        direction = data.light_xdir[k] / np.linalg.norm(data.light_xdir[k])
        directional = model.light_type[k] == mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
        center, extent = model.stat.center, model.stat.extent
        position = center - FAR * extent * direction if directional else data.light_xpos[k]
        wide = float(np.arctan(LIT * extent / max(np.linalg.norm(center - position), 1e-3 * extent)))
        diffuse = model.light_diffuse[k]
        strength = float(diffuse.max())
        if strength <= 0:
            continue
        color, _ = _paint(np.append(diffuse / strength, 1))
        server.scene.add_light_spot(
            f"/lights/{k}",
            color=color,
            angle=min(wide, float(np.radians(model.light_cutoff[k]))),
            penumbra=1.0,
            decay=0.0,
            intensity=LAMP * strength,
            cast_shadow=bool(model.light_castshadow[k]),
            direction=tuple(direction.tolist()),
            position=position,
        )
