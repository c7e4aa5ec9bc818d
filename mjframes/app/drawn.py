"""What of a scene is drawn, and in which colour, for those that draw it instead of MuJoCo: logs and the page of `view`.

What MuJoCo draws by default is drawn: geoms of the groups 0 to 2. A texture counts with its mean colour, but for
`skin_parts`, which keeps what is drawn on a skin.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import mujoco
import numpy as np

GEOM = mujoco.mjtGeom
HIDDEN = 3  # geom groups from this on are not drawn by MuJoCo's default
PLAIN = (0.5, 0.5, 0.5, 1.0)  # colour of a geom that is given none, MuJoCo's default
ENDLESS = 4.0  # [-] of the scene's extent: half of a plane that has no end
THIN = 1e-3  # [-] of the scene's extent: thickness of a plane
BANDS = 6  # colours at most that stand for a skin's texture
Kind = Literal["box", "ball", "cylinder", "mesh"]


@dataclass(frozen=True, eq=False)
class Shape:
    """A piece of a geom.

    kind: a ball may be an ellipsoid.  size: (3,) from end to end along its own axes, but of a mesh [m].
    position, quat: (3,) [m] and (4,), in the axes of the geom's body.  rgba: (4,).
    mesh: vertices (n, 3) [m] and triangles (m, 3) in its own axes, of a mesh alone.
    """

    kind: Kind
    size: np.ndarray
    position: np.ndarray
    quat: np.ndarray
    rgba: np.ndarray
    mesh: tuple[np.ndarray, np.ndarray] | None = None


def shapes(model: mujoco.MjModel, geom: int) -> list[Shape]:
    """Return the pieces that a geom is drawn as: a capsule is a cylinder and two balls, a plane a thin box."""
    kind, (x, y, z) = model.geom_type[geom], 2 * model.geom_size[geom]
    if kind == GEOM.mjGEOM_PLANE:
        width, length, thickness = _plane_size(model, geom)
        return [_shape(model, geom, "box", (width, length, thickness), -thickness / 2)]
    if kind == GEOM.mjGEOM_BOX:
        return [_shape(model, geom, "box", (x, y, z))]
    if kind == GEOM.mjGEOM_SPHERE:
        return [_shape(model, geom, "ball", (x, x, x))]
    if kind == GEOM.mjGEOM_ELLIPSOID:
        return [_shape(model, geom, "ball", (x, y, z))]
    if kind == GEOM.mjGEOM_CYLINDER:
        return [_shape(model, geom, "cylinder", (x, x, y))]
    if kind == GEOM.mjGEOM_CAPSULE:
        ends = [_shape(model, geom, "ball", (x, x, x), end) for end in (-y / 2, y / 2)]
        return [_shape(model, geom, "cylinder", (x, x, y)), *ends]
    return [replace(_shape(model, geom, "mesh", (1, 1, 1)), mesh=_surface(model, geom))]


def drawn_geoms(model: mujoco.MjModel) -> list[int]:
    """Return the geoms that are drawn: those of the drawn groups that are not invisible."""
    return [g for g in range(model.ngeom) if model.geom_group[g] < HIDDEN and geom_color(model, g)[3] > 0]


def geom_color(model: mujoco.MjModel, geom: int) -> np.ndarray:
    """Return a geom's rgba (4,): its own where it has one, else its material's, times the mean of the texture."""
    own, material = model.geom_rgba[geom], int(model.geom_matid[geom])
    return own if material < 0 or tuple(own) != PLAIN else _material_color(model, material)


def skin_color(model: mujoco.MjModel, skin: int) -> np.ndarray:
    """Return a skin's rgba (4,): its material's where it has one, times the mean of the texture."""
    material = int(model.skin_matid[skin])
    return model.skin_rgba[skin] if material < 0 else _material_color(model, material)


def sky_color(model: mujoco.MjModel) -> np.ndarray | None:
    """Return the mean rgb (3,) of the scene's sky, None where it has none."""
    skies = np.flatnonzero(model.tex_type == mujoco.mjtTexture.mjTEXTURE_SKYBOX)
    return _texture_color(model, int(skies[0])) if len(skies) else None


def skin_faces(model: mujoco.MjModel, skin: int) -> np.ndarray:
    """Return the triangles (m, 3) of a skin."""
    return model.skin_face[model.skin_faceadr[skin] :][: model.skin_facenum[skin]]


def skin_parts(model: mujoco.MjModel, skin: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return a skin as pieces of one colour each: triangles (m, 3) and rgba (4,).

    There is one piece where the skin has no texture, and BANDS at most where it has one: the colours of its triangles
    are put into bands along the direction in which they differ most.
    """
    faces, color = skin_faces(model, skin), skin_color(model, skin)
    colors = _face_colors(model, skin, faces)
    if colors is None:
        return [(faces, color)]
    axis = np.linalg.svd(colors - colors.mean(axis=0), full_matrices=False)[2][0]
    along = colors @ axis
    band = np.minimum((BANDS * (along - along.min()) / max(float(np.ptp(along)), 1e-9)).astype(int), BANDS - 1)
    return [(faces[band == k], np.append(colors[band == k].mean(axis=0), color[3])) for k in np.unique(band)]


def _shape(model: mujoco.MjModel, geom: int, kind: Kind, size: tuple[float, float, float], height: float = 0) -> Shape:
    """Return a piece of a geom; height: of its centre along the geom's z axis [m]."""
    raised = np.zeros(3)
    mujoco.mju_rotVecQuat(raised, np.array([0, 0, height]), model.geom_quat[geom])
    place = model.geom_pos[geom] + raised
    return Shape(kind, np.array(size, float), place, model.geom_quat[geom], geom_color(model, geom))


def _plane_size(model: mujoco.MjModel, geom: int) -> np.ndarray:
    """Return width, length and thickness (3,) of the slab that stands for a plane [m]; its top is the plane."""
    half = model.geom_size[geom, :2]
    x, y = 2 * np.where(half > 0, half, ENDLESS * model.stat.extent)
    return np.array([x, y, THIN * model.stat.extent])


def _surface(model: mujoco.MjModel, geom: int) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices (n, 3) [m] and triangles (m, 3) of a mesh, a signed distance field or a height field, in the
    geom's axes.
    """
    if model.geom_type[geom] == GEOM.mjGEOM_HFIELD:
        return _height_field(model, int(model.geom_dataid[geom]))
    mesh = int(model.geom_dataid[geom])
    vertices = model.mesh_vert[model.mesh_vertadr[mesh] :][: model.mesh_vertnum[mesh]]
    return vertices, model.mesh_face[model.mesh_faceadr[mesh] :][: model.mesh_facenum[mesh]]


def _material_color(model: mujoco.MjModel, material: int) -> np.ndarray:
    color = np.array(model.mat_rgba[material], float)
    texture = int(model.mat_texid[material, int(mujoco.mjtTextureRole.mjTEXROLE_RGB)])
    if texture >= 0 and model.tex_nchannel[texture] >= 3:
        color[:3] *= _texture_color(model, texture)
    return color


def _face_colors(model: mujoco.MjModel, skin: int, faces: np.ndarray) -> np.ndarray | None:
    """Return the rgb (m, 3) of a skin's triangles, None where it has no texture or no coordinates for one."""
    material, start = int(model.skin_matid[skin]), int(model.skin_texcoordadr[skin])
    if material < 0 or start < 0:
        return None
    texture = int(model.mat_texid[material, int(mujoco.mjtTextureRole.mjTEXROLE_RGB)])
    if texture < 0 or model.tex_nchannel[texture] < 3:
        return None
    place = model.skin_texcoord[start:][: model.skin_vertnum[skin]][faces].mean(axis=1) * model.mat_texrepeat[material]
    width, height = int(model.tex_width[texture]), int(model.tex_height[texture])
    pixels = model.tex_data[model.tex_adr[texture] :][: width * height * model.tex_nchannel[texture]]
    column, row = np.floor(place % 1 * (width, height)).astype(int).T
    found = pixels.reshape(height, width, -1)[np.minimum(row, height - 1), np.minimum(column, width - 1), :3] / 255
    return found * model.mat_rgba[material, :3]


def _texture_color(model: mujoco.MjModel, texture: int) -> np.ndarray:
    """Return the mean rgb (3,) of a texture of three channels or more."""
    start, channels = int(model.tex_adr[texture]), int(model.tex_nchannel[texture])
    size = int(model.tex_width[texture]) * int(model.tex_height[texture]) * channels
    return model.tex_data[start : start + size].reshape(-1, channels)[:, :3].mean(axis=0) / 255


def _height_field(model: mujoco.MjModel, field: int) -> tuple[np.ndarray, np.ndarray]:
    rows, columns = int(model.hfield_nrow[field]), int(model.hfield_ncol[field])
    x, y, z, _ = model.hfield_size[field]
    heights = z * model.hfield_data[model.hfield_adr[field] :][: rows * columns]
    grid = np.meshgrid(np.linspace(-x, x, columns), np.linspace(-y, y, rows))
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    faces = [corner, corner + 1, corner + columns, corner + 1, corner + columns + 1, corner + columns]
    vertices = np.column_stack([grid[0].ravel(), grid[1].ravel(), heights])
    return vertices, np.stack(faces, axis=1).reshape(-1, 3)
