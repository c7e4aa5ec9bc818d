"""Voxels of surface meshes: voxel v gets a mesh's label where the mesh has w(p_v) > ½ at the voxel's centre p_v.

Closed surfaces: along the column of voxels in z, w(z) = Σ over the crossings below z of −sign(n_z), exact integers.
A triangle covers a column where its projection winds around it; that is decided edge by edge, with the same arithmetic
for both triangles of an edge, so no ray slips through a seam. Open surfaces: the generalized winding number (libigl).
Input: surfaces (`meshes.py`) and a spacing [m]. Output: labels (nx, ny, nz), origin [m], and what was lost, in words.
The paper (§4) takes such volumes as given.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.spatial
from numba import njit, prange
from numpy.typing import NDArray

from mjframes.base.errors import MjframesError
from mjframes.volume.meshes import MeshSurface, import_igl, lids
from mjframes.volume.spacing import require_room

PROBE_CELLS = 400_000  # of the grid that estimates the volume for a wanted voxel count: to about 1 %, in 0.02 to 0.3 s
QUERIES = 1_000_000  # points per call of libigl: 24 MB of coordinates
SNAPPED = 16  # cells from which on a whole number of them on the shortest side changes the voxel count by < 10 %
LENGTHS = (5e-3, 5.0)  # [m] of a usual body
NOTABLE_LOSS = 0.02  # [-] difference of voxels and mesh in volume that is worth a notice
SHARPNESS = 256  # lost places whose thickness is measured
CAUGHT = 0.1  # [-] quantile of their thickness that the advised spacing resolves


@dataclass(frozen=True, eq=False)
class Box:
    """A block of cells.

    low: (3,) int64 index of its first one in the grid.
    shape: how many along each axis.
    """

    low: NDArray[np.int64]
    shape: tuple[int, int, int]

    @property
    def slices(self) -> tuple[slice, slice, slice]:
        """Return where it lies in the grid's array."""
        a, b, c = (slice(int(low), int(low) + n) for low, n in zip(self.low, self.shape, strict=True))
        return a, b, c


def voxelize(
    surfaces: Sequence[MeshSurface], spacing: NDArray[np.float64], fill: bool
) -> tuple[NDArray[np.unsignedinteger], NDArray[np.float64], list[str]]:
    """Return labels (nx, ny, nz): i + 1 in surfaces[i], the last one that has the voxel; origin (3,) [m]; notices.

    spacing: (3,) [m].  fill: whether the rest of the convex hull of all gets the label after the last.
    Raise MjframesError if a surface encloses no voxel, or nothing that deserves the name.
    """
    low, shape = _frame(surfaces, spacing)
    labels = np.zeros(shape, np.min_scalar_type(len(surfaces) + fill))
    notices = _doubts(surfaces)
    if fill:
        hull = convex_hull(surfaces)
        box = _box(hull, low, spacing, shape)
        labels[box.slices] = (_winding(hull, low, spacing, box) > 0) * labels.dtype.type(len(surfaces) + 1)
    for i, surface in enumerate(surfaces):
        box = _box(surface, low, spacing, shape)
        inside, notice = _inside(surface, low, spacing, box)
        is_simple = not (surface.open_edges or notice)
        losses = _losses(surface, inside, low, spacing, box, is_simple)
        if not inside.any():
            raise MjframesError(losses[0])
        notices += [*surface.notices, *notice, *losses]
        np.copyto(labels[box.slices], labels.dtype.type(i + 1), where=inside)
    for i, surface in enumerate(surfaces[:-1]):  # the last one cannot be covered
        if not (labels[_box(surface, low, spacing, shape).slices] == i + 1).any():
            raise MjframesError(f"{surface.name}: later meshes cover all of it; put it after them or leave it out.")
    return labels, low, notices


def _doubts(surfaces: Sequence[MeshSurface]) -> list[str]:
    """A notice if the unit of the meshes may be another."""
    length = float(np.subtract(*_bounds(surfaces)[::-1]).max())
    if LENGTHS[0] <= length <= LENGTHS[1]:
        return []
    return [f"{surfaces[0].name}: the body is {length:.3g} m long; if its unit is another, give scale or --unit."]


def spacing_for(surfaces: Sequence[MeshSurface], voxels: int, fill: bool) -> NDArray[np.float64]:
    """Return the edge (3,) [m] of the cubic voxels of which about `voxels` are inside, by the volume in a coarser grid.

    The shortest side of all meshes becomes a whole number of cells, so that a block keeps its volume.
    """
    extents = np.subtract(*_bounds(surfaces)[::-1])
    spacing = np.full(3, float(np.prod(extents) / PROBE_CELLS) ** (1 / 3))
    low, shape = _frame(surfaces, spacing)
    solids = [convex_hull(surfaces)] if fill else surfaces  # the hull holds all the rest
    covered = np.zeros(shape, bool)
    for surface in solids:
        box = _box(surface, low, spacing, shape)
        covered[box.slices] |= _inside(surface, low, spacing, box)[0]
    if not covered.any():
        raise MjframesError(
            f"{surfaces[0].name}: it is too thin to estimate its volume; give spacing instead of a number of voxels."
        )
    step = (np.count_nonzero(covered) * float(np.prod(spacing)) / voxels) ** (1 / 3)
    side = float(extents.min())
    return np.full(3, side / round(side / step) if side > SNAPPED * step else step)


def convex_hull(surfaces: Sequence[MeshSurface]) -> MeshSurface:
    """Return the convex hull of all surfaces, closed and oriented outwards."""
    points = np.concatenate([surface.vertices for surface in surfaces])
    hull = scipy.spatial.ConvexHull(points)
    a, b, c = (points[hull.simplices[:, corner]] for corner in range(3))
    is_inward = np.einsum("mx,mx->m", np.cross(b - a, c - a), hull.equations[:, :3]) < 0
    faces = np.where(is_inward[:, None], hull.simplices[:, ::-1], hull.simplices).astype(np.int64)
    return MeshSurface("hull", points, faces)


def _bounds(surfaces: Sequence[MeshSurface]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    low = np.min([surface.vertices.min(axis=0) for surface in surfaces], axis=0)
    return low, np.max([surface.vertices.max(axis=0) for surface in surfaces], axis=0)


def _frame(
    surfaces: Sequence[MeshSurface], spacing: NDArray[np.float64]
) -> tuple[NDArray[np.float64], tuple[int, int, int]]:
    """Origin (3,) [m] and shape of the smallest grid around all surfaces, from their lowest corner on.

    A box that begins at a cell's face is rounded to the nearest number of cells, in any other place to either side.
    """
    low, high = _bounds(surfaces)
    cells = np.maximum(np.ceil((high - low) / spacing - 1e-6), 1)  # a box of ten spacings is ten cells
    return low, require_room(cells, spacing)


def _box(
    surface: MeshSurface, origin: NDArray[np.float64], spacing: NDArray[np.float64], shape: tuple[int, int, int]
) -> Box:
    """The cells of the grid that the surface's bounding box touches."""
    low = np.floor((surface.vertices.min(axis=0) - origin) / spacing).astype(np.int64)
    high = np.floor((surface.vertices.max(axis=0) - origin) / spacing).astype(np.int64) + 1
    low, high = np.clip(low, 0, np.array(shape) - 1), np.clip(high, 1, shape)
    nx, ny, nz = np.maximum(high - low, 1).tolist()
    return Box(low, (nx, ny, nz))


def _index_coordinates(
    surface: MeshSurface, origin: NDArray[np.float64], spacing: NDArray[np.float64], box: Box
) -> NDArray[np.float64]:
    """Vertices (n, 3) in cells of the box, its voxel centres at the integers."""
    return (surface.vertices - origin) / spacing - 0.5 - box.low


def _winding(
    surface: MeshSurface, origin: NDArray[np.float64], spacing: NDArray[np.float64], box: Box
) -> NDArray[np.int32]:
    """w of a closed surface at the voxels of the box (nx, ny, nz)."""
    nx, ny, nz = box.shape
    change = np.zeros((nx, ny, nz + 1), np.int32)
    _crossings(_index_coordinates(surface, origin, spacing, box), surface.faces, change)
    np.cumsum(change, axis=2, out=change)
    return change[:, :, :nz]


def _inside(
    surface: MeshSurface, origin: NDArray[np.float64], spacing: NDArray[np.float64], box: Box
) -> tuple[NDArray[np.bool_], list[str]]:
    """Where w > ½ in the box, and what else w tells."""
    if surface.open_edges:
        return _generalized(surface, origin, spacing, box), []
    w = _winding(surface, origin, spacing, box)
    inside = w > 0
    volume = np.count_nonzero(inside)
    overlapping, inverted = int(np.count_nonzero(w > 1)), int(np.count_nonzero(w < 0))
    if not (overlapping or inverted) or volume == 0:
        return inside, []
    text = f"{surface.name}: the surface overlaps or intersects itself; inside is where its winding number exceeds 1/2,"
    text += f" so that {_percent(overlapping / volume)} of the volume, where it overlaps, counts once"
    text += f" and {_percent(inverted / volume)}, which is inside out, not at all." if inverted else "."
    return inside, [text]


def _generalized(
    surface: MeshSurface, origin: NDArray[np.float64], spacing: NDArray[np.float64], box: Box
) -> NDArray[np.bool_]:
    """Where the generalized winding number is > ½ in the box."""
    igl = import_igl(surface.name)
    lid = lids(surface)
    together = replace(lid, faces=np.concatenate([surface.faces, lid.faces]))
    integer = _winding(together, origin, spacing, box).reshape(-1, box.shape[2])
    inside = np.zeros(box.shape, bool)
    nx, ny, nz = box.shape
    first = origin + spacing * (box.low + 0.5)
    z = first[2] + spacing[2] * np.arange(nz)
    step = max(1, QUERIES // nz)
    flat = inside.reshape(-1, nz)
    for start in range(0, nx * ny, step):
        columns = np.arange(start, min(start + step, nx * ny))
        points = np.empty((len(columns), nz, 3))
        points[:, :, 0] = (first[0] + spacing[0] * (columns // ny))[:, None]
        points[:, :, 1] = (first[1] + spacing[1] * (columns % ny))[:, None]
        points[:, :, 2] = z
        w_lids = igl.fast_winding_number(lid.vertices, lid.faces, points.reshape(-1, 3)).reshape(-1, nz)
        flat[start : start + len(columns)] = integer[start : start + len(columns)] - w_lids > 0.5
    return inside


def _losses(
    surface: MeshSurface,
    inside: NDArray[np.bool_],
    origin: NDArray[np.float64],
    spacing: NDArray[np.float64],
    box: Box,
    is_simple: bool,
) -> list[str]:
    """Notices if some of the surface has no voxel near it, because it is thinner than one, and if the volume differs.

    is_simple: whether the mesh's own volume is known, by being closed and without overlaps.
    """
    u = _index_coordinates(surface, origin, spacing, box)
    a, b, c = (surface.vertices[surface.faces[:, corner]] for corner in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    share = _bare_share(u, surface.faces, inside)
    lost, total = float(area @ share), float(area.sum())
    notices = []
    if lost >= min(spacing) ** 2 or not inside.any():  # less is a corner, no part
        text = (
            f"{surface.name}: {_percent(lost / total)} of its surface ({lost:.2g} m²) encloses no voxel: parts thinner "
        )
        text += f"than the spacing of {max(spacing):.3g} m are lost"
        thickness = _thickness(surface.vertices, surface.faces, _spread(area * share))
        thickness = thickness[np.isfinite(thickness)]
        if len(thickness):
            # a ball of diameter t holds a voxel centre wherever it lies if the spacing is t/√3
            advice = min(float(np.quantile(thickness, CAUGHT)) / math.sqrt(3), min(spacing) / 2)
            text += f"; a spacing of {advice:.2g} m would catch nine tenths of them"
        notices.append(text + ".")
    voxels = np.count_nonzero(inside) * float(np.prod(spacing))
    solid = float(np.einsum("mx,mx->m", a - a[0], np.cross(b - a[0], c - a[0])).sum()) / 6
    if is_simple and abs(voxels - solid) > NOTABLE_LOSS * solid > 0:
        more = "more" if voxels > solid else "less"
        text = f"{surface.name}: its voxels hold {_percent(abs(voxels / solid - 1))} {more} than the mesh; "
        notices.append(text + "a finer spacing, or one that divides the sides of a block, comes closer.")
    return notices


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %" if share < 0.1 else f"{100 * share:.0f} %"


def _spread(weight: NDArray[np.float64]) -> NDArray[np.int64]:
    """At most SHARPNESS triangles, as often as they weigh."""
    total = np.cumsum(weight)
    return np.searchsorted(total, (np.arange(SHARPNESS) + 0.5) / SHARPNESS * total[-1])


@njit(cache=True, inline="always")
def _on_edge(u: NDArray[np.float64], i: int, j: int, x: int) -> tuple[float, float]:
    """(y, z) where the line from vertex i to vertex j has the coordinate x; the same whichever comes first."""
    if j < i:
        i, j = j, i
    t = (x - u[i, 0]) / (u[j, 0] - u[i, 0])
    return u[i, 1] + t * (u[j, 1] - u[i, 1]), u[i, 2] + t * (u[j, 2] - u[i, 2])


@njit(cache=True)
def _crossings(u: NDArray[np.float64], faces: NDArray[np.int64], change: NDArray[np.int32]) -> None:
    """Add to change (nx, ny, nz + 1), for each column and triangle that covers it, ±1 at the first voxel above."""
    nx, ny, nz = change.shape[0], change.shape[1], change.shape[2] - 1
    for t in range(faces.shape[0]):
        low = min(u[faces[t, 0], 0], u[faces[t, 1], 0], u[faces[t, 2], 0])
        high = max(u[faces[t, 0], 0], u[faces[t, 1], 0], u[faces[t, 2], 0])
        for x in range(max(0, math.ceil(low)), min(nx, math.ceil(high))):
            # two of the three edges pass the line x: one forwards, one backwards
            y_up, z_up, y_down, z_down = 0.0, 0.0, 0.0, 0.0
            for corner in range(3):
                i, j = faces[t, corner], faces[t, (corner + 1) % 3]
                starts, ends = u[i, 0] <= x, u[j, 0] <= x
                if starts and not ends:
                    y_up, z_up = _on_edge(u, i, j, x)
                elif ends and not starts:
                    y_down, z_down = _on_edge(u, i, j, x)
            if y_up == y_down:
                continue
            sign = -1 if y_up < y_down else 1
            near, far = min(y_up, y_down), max(y_up, y_down)
            for y in range(max(0, math.ceil(near)), min(ny, math.ceil(far))):
                z = z_up + (y - y_up) / (y_down - y_up) * (z_down - z_up)
                change[x, y, min(max(math.ceil(z), 0), nz)] += sign


@njit(cache=True)
def _bare_share(u: NDArray[np.float64], faces: NDArray[np.int64], inside: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(m,) share of each triangle that has no inside voxel among the 27 around it, by samples one cell apart."""
    nx, ny, nz = inside.shape
    share = np.zeros(faces.shape[0])
    for t in range(faces.shape[0]):
        a, b, c = u[faces[t, 0]], u[faces[t, 1]], u[faces[t, 2]]
        longest = 0.0
        for axis in range(3):
            longest = max(longest, abs(b[axis] - a[axis]), abs(c[axis] - b[axis]), abs(a[axis] - c[axis]))
        n = max(1, math.ceil(longest))
        bare = 0
        for p in range(n):
            for q in range(n - p):
                s, r = (p + 1 / 3) / n, (q + 1 / 3) / n
                x = round(a[0] + s * (b[0] - a[0]) + r * (c[0] - a[0]))
                y = round(a[1] + s * (b[1] - a[1]) + r * (c[1] - a[1]))
                z = round(a[2] + s * (b[2] - a[2]) + r * (c[2] - a[2]))
                found = False
                for i in range(max(0, x - 1), min(nx, x + 2)):
                    for j in range(max(0, y - 1), min(ny, y + 2)):
                        for k in range(max(0, z - 1), min(nz, z + 2)):
                            found = found or inside[i, j, k]
                bare += not found
        share[t] = bare / (n * (n + 1) / 2)
    return share


@njit(cache=True, inline="always")
def _triple(a: tuple[float, float, float], b: tuple[float, float, float], c: tuple[float, float, float]) -> float:
    """a · (b × c), of tuples: arrays this small would be made on the heap."""
    return a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2]) + a[2] * (b[0] * c[1] - b[1] * c[0])


@njit(cache=True, inline="always")
def _between(v: NDArray[np.float64], i: int, j: int) -> tuple[float, float, float]:
    """From vertex i to vertex j."""
    return v[j, 0] - v[i, 0], v[j, 1] - v[i, 1], v[j, 2] - v[i, 2]


@njit(cache=True, parallel=True)
def _thickness(v: NDArray[np.float64], faces: NDArray[np.int64], chosen: NDArray[np.int64]) -> NDArray[np.float64]:
    """(c,) [m]: how far the surface is from the middle of each chosen triangle against its normal; inf if nowhere."""
    thickness = np.full(len(chosen), np.inf)
    for s in prange(len(chosen)):
        own = chosen[s]
        i, j, k = faces[own, 0], faces[own, 1], faces[own, 2]
        e, f = _between(v, i, j), _between(v, i, k)
        ray = (f[1] * e[2] - f[2] * e[1], f[2] * e[0] - f[0] * e[2], f[0] * e[1] - f[1] * e[0])
        length = math.sqrt(ray[0] ** 2 + ray[1] ** 2 + ray[2] ** 2)
        if length == 0:
            continue
        ray = (ray[0] / length, ray[1] / length, ray[2] / length)
        for t in range(faces.shape[0]):
            i = faces[t, 0]
            e, f = _between(v, i, faces[t, 1]), _between(v, i, faces[t, 2])
            g = (
                v[i, 0] - (v[faces[own, 0], 0] + v[faces[own, 1], 0] + v[faces[own, 2], 0]) / 3,
                v[i, 1] - (v[faces[own, 0], 1] + v[faces[own, 1], 1] + v[faces[own, 2], 1]) / 3,
                v[i, 2] - (v[faces[own, 0], 2] + v[faces[own, 1], 2] + v[faces[own, 2], 2]) / 3,
            )
            # start + distance ray = corner + beta e + gamma f, by Cramer's rule
            det = _triple(ray, e, f)
            if t == own or det == 0:
                continue
            distance = _triple(g, e, f) / det
            beta, gamma = -_triple(ray, g, f) / det, -_triple(ray, e, g) / det
            if beta >= 0 and gamma >= 0 and beta + gamma <= 1 and 0 < distance < thickness[s]:
                thickness[s] = distance
    return thickness
