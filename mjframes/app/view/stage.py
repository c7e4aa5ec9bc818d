"""A scene on viser's stage: geoms that follow their bodies, skins with vertices of their own, lights."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from viser import BoxHandle, CylinderHandle, FrameHandle, IcosphereHandle, MeshHandle, ViserServer

from mjframes.app.dented import skin_vertices
from mjframes.app.drawn import Shape, drawn_geoms, shapes, skin_parts, sky_color

Node = BoxHandle | CylinderHandle | IcosphereHandle | MeshHandle
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
        model, server = self._model, self._server
        body = int(model.geom_bodyid[geom])
        if body not in self._frames:
            self._frames[body] = server.scene.add_frame(f"/bodies/{body}", show_axes=False)
        is_plane = model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE
        for k, shape in enumerate(shapes(model, geom)):
            name = f"/bodies/{body}/{geom}/{k}"
            node = _add_shape(server, shape, name, cast_shadow=not is_plane)
            if is_plane:
                _add_lines(server, shape, f"{name}/lines")
            if model.body_weldid[body] > 0:
                self.rigid.append((node, body))


def _paint(rgba: np.ndarray) -> tuple[tuple[int, int, int], float | None]:
    """Return viser's colour and opacity."""
    red, green, blue = (round(255 * float(part)) for part in np.clip(rgba[:3], 0, 1))
    return (red, green, blue), float(rgba[3]) if rgba[3] < 1 else None


def _add_shape(server: ViserServer, shape: Shape, name: str, cast_shadow: bool) -> Node:
    color, opacity = _paint(shape.rgba)
    x, y, z = shape.size.tolist()
    looks: dict[str, Any] = {
        "color": color, "opacity": opacity, "cast_shadow": cast_shadow, "position": shape.position, "wxyz": shape.quat,
    }  # fmt: skip
    if shape.mesh is not None:
        return server.scene.add_mesh_simple(name, *shape.mesh, flat_shading=True, side="double", **looks)
    if shape.kind == "box":
        return server.scene.add_box(name, dimensions=(x, y, z), **looks)
    if shape.kind == "ball":
        return server.scene.add_icosphere(name, 1.0, scale=(x / 2, y / 2, z / 2), **looks)
    return server.scene.add_cylinder(name, x / 2, z, **looks)


def _add_lines(server: ViserServer, slab: Shape, name: str) -> None:
    """Add lines to a plane, in the frame of its slab, that let one see how far things move."""
    width, length, thickness = slab.size.tolist()
    (red, green, blue), _ = _paint(0.85 * slab.rgba)
    cell = _round_length(min(width, length) / LINES)
    server.scene.add_grid(
        name, width, length, cell_size=cell, section_size=5 * cell, cell_color=(red, green, blue),
        section_color=(red, green, blue), section_thickness=1.5, shadow_opacity=0.0, position=(0, 0, thickness),
    )  # fmt: skip


def _round_length(length: float) -> float:
    """Return the greatest of 1, 2, 5, 10, … times a power of ten that is not greater."""
    power = 10 ** np.floor(np.log10(length))
    return float(max(step for step in (1, 2, 5) if step * power <= length * (1 + 1e-9)) * power)


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
