"""The surface in space, each triangle in the colour of the voxel under it, drawn by matplotlib."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from mjframes.app.pictures.slices import MM
from mjframes.volume.grid import Grid

Float = NDArray[np.float64]

SHORT = 0.3  # [-] of the largest extent: an axis so short has no room for a name
UNDER = 0.5  # [voxels] under a triangle where its voxel is looked for


@dataclass(frozen=True, eq=False)
class DrawnSurface:
    """A closed surface of t triangles.

    corners: (t, 3, 3) [m].  normals: (t, 3).  voxel: (t,) under each.
    """

    corners: Float
    normals: Float
    voxel: NDArray[np.integer]


def surface_of(grid: Grid, vertices: Float, faces: NDArray[np.integer]) -> DrawnSurface:
    """Return the surface (s, 3), (t, 3) of the grid's voxels."""
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None]
    inside = corners.mean(axis=1) - UNDER * grid.spacing.min() * normals
    return DrawnSurface(corners, normals, np.asarray(KDTree(grid.centers).query(inside)[1]))


def view_direction(corners: Float) -> Float:
    """Return where to look from (3,), so that one sees the broad side of a surface at a slant, from above."""
    order = np.argsort(np.ptp(corners.reshape(-1, 3), axis=0), kind="stable")
    toward = np.zeros(3)
    toward[order] = 0.75, 0.55, 0.36
    if order[0] != 1:
        toward[1] *= -1  # with x to the right and z upwards the viewer is at negative y
    return toward / np.linalg.norm(toward)


def draw_surface(axes: Any, surface: DrawnSurface, colors: Float, back: bool) -> None:
    """Draw a surface on axes in space [mm], colors (n, 4) of the voxels, lit from where one looks from.

    back: seen from the other side.
    """
    from matplotlib.colors import LightSource
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    toward = view_direction(surface.corners) * (-1 if back else 1)
    azimuth, elevation = np.degrees([np.arctan2(toward[1], toward[0]), np.arcsin(toward[2])]).tolist()
    seen = surface.normals @ toward > 0
    light = LightSource(90 - azimuth, elevation)
    shown = colors[surface.voxel[seen]]
    axes.add_collection3d(
        Poly3DCollection(
            list(MM * surface.corners[seen]), facecolors=shown, linewidths=0, antialiased=False, shade=True,
            lightsource=light,
        )
    )  # fmt: skip
    places = MM * surface.corners.reshape(-1, 3)
    low, high = places.min(axis=0), places.max(axis=0)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(high - low, zoom=1.02)
    axes.set_proj_type("ortho")
    axes.view_init(elevation, azimuth)
    share = (high - low) / (high - low).max()
    for axis, name, part in zip((axes.xaxis, axes.yaxis, axes.zaxis), "xyz", share, strict=True):
        if part > SHORT:
            axis.set_label_text(f"{name} [mm]", size=7)
            axis.labelpad = -6
        axis.set_tick_params(labelsize=6, pad=-2)
        axis.get_major_locator().set_params(nbins=max(1, round(5 * part)))
