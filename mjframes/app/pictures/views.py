"""Pictures of the surface in space, without OpenGL: orthographic projection, a depth buffer, a light at the camera.

A point p appears at (r · p, u · p) with r, u the camera's right and up. A pixel shows the triangle with the largest
t · p, t the direction towards the camera, in the colour of the voxel under it. So one `Shot` serves for all fields.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import KDTree
from skimage.transform import resize

from mjframes.volume.grid import Grid

Float = NDArray[np.float64]

SUPERSAMPLING = 2  # [pixels] a side that make one: smooth edges
SHADE = 0.55  # [-] darkening of surfaces seen edge-on: enough to see the shape, those seen from above keep their colour
STEPS_IN = (0.25, 0.75, 1.25)  # [voxels] under the surface where the voxel of a pixel is looked for
OUTLINE = 3.0  # [pixels of the depth buffer] a step in depth of that much draws a line
LINE = np.array([0.1, 0.1, 0.1])
GLASS = np.array([0.35, 0.45, 0.6])


@dataclass(frozen=True, eq=False)
class Camera:
    """An orthographic camera.

    right, up, toward: (3,) orthonormal; toward points at the viewer.
    """

    right: Float
    up: Float
    toward: Float

    def project(self, points: Float) -> Float:
        """Return where points (s, 3) appear, (s, 2) [m]."""
        return points @ np.stack([self.right, self.up], axis=1)


@dataclass(frozen=True, eq=False)
class Shot:
    """A surface as a camera sees it, row 0 at the bottom.

    extent: left, right, bottom, top [m].
    voxel: (h, w) int32, −1 in the background.
    facing: (h, w) cosine between normal and view.
    edge: (h, w) bool, where something is in front of something farther.
    """

    camera: Camera
    extent: tuple[float, float, float, float]
    voxel: NDArray[np.int32]
    facing: Float
    edge: NDArray[np.bool_]


def cameras(vertices: Float) -> tuple[Camera, Camera]:
    """Return two opposite cameras that look at the broad side of a surface (s, 3) at a slant, z upwards if possible."""
    order = np.argsort(np.ptp(vertices, axis=0), kind="stable")
    toward = np.zeros(3)
    toward[order] = 0.75, 0.55, 0.36
    if order[0] != 1:
        toward[1] *= -1  # with x to the right and z upwards the viewer is at negative y
    return _camera(toward), _camera(-toward)


def _camera(toward: Float) -> Camera:
    toward = toward / np.linalg.norm(toward)
    right = np.cross([0.0, 0.0, 1.0], toward)
    right /= np.linalg.norm(right)
    return Camera(right, np.cross(toward, right), toward)


def shoot(camera: Camera, vertices: Float, faces: NDArray[np.integer], grid: Grid, width: int, height: int) -> Shot:
    """Return the closed surface (s, 3), (t, 3) of the grid's voxels, as large as width × height pixels allow."""
    size = np.array([width, height]) * SUPERSAMPLING
    flat = camera.project(vertices)
    low, high = flat.min(axis=0), flat.max(axis=0)
    pixel = float(np.max((high - low) / (size - 8)))
    corner = (low + high) / 2 - pixel * size / 2
    depth = np.full((size[1], size[0]), -np.inf)
    normal = np.zeros((size[1], size[0], 3))
    _rasterize((flat - corner) / pixel - 0.5, vertices @ camera.toward, faces, _normals(vertices, faces), depth, normal)
    seen = np.isfinite(depth)
    row, column = np.nonzero(seen)
    normal[seen] /= np.maximum(np.linalg.norm(normal[seen], axis=1), 1e-12)[:, None]
    points = (
        (corner[0] + pixel * (column + 0.5))[:, None] * camera.right
        + (corner[1] + pixel * (row + 0.5))[:, None] * camera.up
        + depth[seen][:, None] * camera.toward
    )
    voxel = np.full(depth.shape, -1, np.int32)
    voxel[seen] = _voxels_under(grid, points, normal[seen])
    far = ndimage.minimum_filter(np.where(seen, depth, depth[seen].min() - 10 * pixel * max(size)), 3)
    extent = (corner[0], corner[0] + pixel * size[0], corner[1], corner[1] + pixel * size[1])
    steep = pixel / np.clip(normal @ camera.toward, 0.1, 1)  # a slanted surface has steps of that size by itself
    return Shot(camera, extent, voxel, normal @ camera.toward, seen & (depth - far > OUTLINE * steep))


def paint(shot: Shot, colors: Float, lines: NDArray[np.integer] | None = None) -> Float:
    """Return RGBA (h, w, 4) of the surface with colors (n, 4) on the voxels; dark lines where `lines` (n,) changes."""
    seen = shot.voxel >= 0
    image = np.zeros((*shot.voxel.shape, 4))
    image[seen] = colors[shot.voxel[seen]]
    image[..., :3] *= (1 - SHADE * (1 - np.clip(shot.facing, 0, 1)) ** 1.5)[..., None]
    dark = shot.edge
    if lines is not None:
        group = np.where(seen, lines[shot.voxel], -1)
        both = ndimage.minimum_filter(seen.astype(np.uint8), 3).astype(bool)
        dark = dark | (both & (ndimage.maximum_filter(group, 3) != ndimage.minimum_filter(group, 3)))
    image[dark, :3] = LINE
    return _downsample(image)


def glass(shot: Shot) -> Float:
    """Return RGBA (h, w, 4) of the surface as thin glass: opaque where it is seen edge-on."""
    image = np.zeros((*shot.voxel.shape, 4))
    image[..., :3] = GLASS
    image[..., 3] = (shot.voxel >= 0) * (0.06 + 0.5 * (1 - np.clip(shot.facing, 0, 1)) ** 2)
    image[shot.edge, 3] = 0.9
    return _downsample(image)


def field_image(shot: Shot, grid: Grid, field: Float) -> np.ma.MaskedArray:
    """Return (h, w) of a field (n,) on the surface, smoothed over a voxel, so that its contours have no steps."""
    seen = (shot.voxel >= 0).astype(np.float64)
    width = 0.7 * grid.spacing.max() / ((shot.extent[1] - shot.extent[0]) / shot.voxel.shape[1])
    share = ndimage.gaussian_filter(seen, width)
    smooth = ndimage.gaussian_filter(np.where(seen > 0, field[shot.voxel], 0), width) / np.maximum(share, 1e-12)
    half = (slice(SUPERSAMPLING // 2, None, SUPERSAMPLING),) * 2
    return np.ma.masked_where(seen[half] == 0, smooth[half])


def radiograph(shot: Shot, grid: Grid, some: NDArray[np.bool_], color: tuple[float, float, float]) -> Float:
    """Return RGBA (h, w, 4), in the shot's extent, of how much of the voxels `some` (n,) lies behind each point."""
    left, right, bottom, top = shot.extent
    step = float(grid.spacing.min())
    bins = [max(1, int(np.ceil((top - bottom) / step))), max(1, int(np.ceil((right - left) / step)))]
    flat = shot.camera.project(grid.centers[some])
    thickness = np.histogram2d(flat[:, 1], flat[:, 0], bins, [[bottom, top], [left, right]])[0]
    size = (shot.voxel.shape[0] // SUPERSAMPLING, shot.voxel.shape[1] // SUPERSAMPLING)
    smooth = np.asarray(resize(ndimage.gaussian_filter(thickness, 0.6), size, order=1))
    image = np.empty((*size, 4))
    image[..., :3] = color
    image[..., 3] = 0.75 * np.sqrt(smooth / max(smooth.max(), 1e-12))
    image[..., 3] *= shot.voxel[::SUPERSAMPLING, ::SUPERSAMPLING] >= 0  # smoothing leaks
    return image


def _downsample(image: Float) -> Float:
    """RGBA of SUPERSAMPLING² pixels each, colours weighted by opacity."""
    h, w, s = image.shape[0] // SUPERSAMPLING, image.shape[1] // SUPERSAMPLING, SUPERSAMPLING
    blocks = image.reshape(h, s, w, s, 4)
    opacity = blocks[..., 3:].sum(axis=(1, 3))
    color = (blocks[..., :3] * blocks[..., 3:]).sum(axis=(1, 3)) / np.maximum(opacity, 1e-12)
    return np.concatenate([color, opacity / s**2], axis=-1).clip(0, 1)


def _voxels_under(grid: Grid, points: Float, normals: Float) -> NDArray[np.int32]:
    """The voxel under each point of the surface: the first found along the normal inwards, else the nearest."""
    found = np.full(len(points), -1, np.int32)
    for step in STEPS_IN:
        left = found < 0
        inside = points[left] - step * grid.spacing.min() * normals[left]
        index = np.floor((inside - grid.origin) @ grid.axes / grid.spacing).astype(np.int64)
        valid = np.all((index >= 0) & (index < grid.lookup.shape), axis=1)
        found[left] = np.where(valid, grid.lookup[tuple(np.where(valid[:, None], index, 0).T)], -1)
    if np.any(left := found < 0):
        found[left] = KDTree(grid.centers).query(points[left])[1]
    return found


def _normals(vertices: Float, faces: NDArray[np.integer]) -> Float:
    """(s, 3) at the vertices, weighted by area, of any length."""
    area = np.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]])
    normals = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(normals, faces[:, corner], area)
    return normals / np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None]


@njit(cache=True)
def _rasterize(
    flat: Float, height: Float, faces: NDArray[np.integer], normals: Float, depth: Float, normal: Float
) -> None:
    """Fill depth (h, w) and normal (h, w, 3), both interpolated; flat (s, 2) in pixels, centres at integers."""
    rows, columns = depth.shape
    for t in range(len(faces)):
        a, b, c = faces[t, 0], faces[t, 1], faces[t, 2]
        ux, uy = flat[b, 0] - flat[a, 0], flat[b, 1] - flat[a, 1]
        vx, vy = flat[c, 0] - flat[a, 0], flat[c, 1] - flat[a, 1]
        area = ux * vy - uy * vx
        if area <= 0:  # seen from behind: the surface is closed
            continue
        first_x = max(0, int(np.ceil(min(flat[a, 0], flat[b, 0], flat[c, 0]))))
        last_x = min(columns - 1, int(np.floor(max(flat[a, 0], flat[b, 0], flat[c, 0]))))
        first_y = max(0, int(np.ceil(min(flat[a, 1], flat[b, 1], flat[c, 1]))))
        last_y = min(rows - 1, int(np.floor(max(flat[a, 1], flat[b, 1], flat[c, 1]))))
        for y in range(first_y, last_y + 1):
            for x in range(first_x, last_x + 1):
                px, py = x - flat[a, 0], y - flat[a, 1]
                p = (px * vy - py * vx) / area
                q = (ux * py - uy * px) / area
                if p < 0 or q < 0 or p + q > 1:
                    continue
                z = height[a] + p * (height[b] - height[a]) + q * (height[c] - height[a])
                if z > depth[y, x]:
                    depth[y, x] = z
                    for k in range(3):
                        normal[y, x, k] = (1 - p - q) * normals[a, k] + p * normals[b, k] + q * normals[c, k]
