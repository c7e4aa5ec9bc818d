"""Taxels: a grid of places on a soft body's surface that feels pressure, shear and how its markers move.

The plugin solves for the pressure (plugin/taxels.h). Its kernel is that of an elastic layer of thickness t, glued at
its base, under a pressure spread as a Gaussian of variance s / 2 (Johnson, Contact Mechanics, §5.8), with γ = 3 − 4ν:

    K(r) = ∫₀^∞ M(kt) J₀(kr) e^(−s k² / 2) dk,   M(κ) = (2γ sinh 2κ − 4κ) / (2γ cosh 2κ + 4κ² + 1 + γ²)

A unit force makes a dent β² K(r) at distance r, β² = (1 − ν²) / (πE). For t → ∞, K = erf(r / √(2s)) / r.
Around the taxels are cells that are pressed as they are but not told, wider from ring to ring. Beyond are contact
vertices.
Index letters: t taxel; s contact vertex; a row, b column of the grid.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree
from scipy.special import j0

from mjframes.base.errors import MjframesError
from mjframes.base.numbers import is_number, is_whole
from mjframes.base.trimeshes import trimesh
from mjframes.body.soft_body import SoftBody
from mjframes.elasticity.shares import factor_of
from mjframes.scene import plugin
from mjframes.scene.material_points import material_points
from mjframes.scene.plugin_text import decode, encode
from mjframes.scene.sensors import Quantity, place_attributes, soft_attributes, write_sensor
from mjframes.surface.dents import PRESSURE
from mjframes.volume.grid import voxel_grid

Array = NDArray[np.float64]

QUANTITIES = {
    "pressure": Quantity("normal traction on each taxel", "Pa", 1, plugin=plugin.FORCE_SENSOR_NAME),
    "traction": Quantity(
        "pressure, and shear along two axes of the surface, on each taxel", "Pa", 3, plugin=plugin.FORCE_SENSOR_NAME
    ),
    "taxel_force": Quantity("force on each taxel, in the world's axes", "N", 3, plugin=plugin.FORCE_SENSOR_NAME),
    "resultant": Quantity("force on all taxels, in the world's axes", "N", 3, plugin=plugin.FORCE_SENSOR_NAME),
    "pressure_centre": Quantity("where it presses, in the world", "m", 3, plugin=plugin.FORCE_SENSOR_NAME),
    "markers": Quantity("how far each has moved along the grid's axes and its normal", "m", 3),
}
OF_ALL = ("resultant", "pressure_centre")
STEPS = 512  # of the kernel's table
DECAYED = 6.0  # [thicknesses] beyond which a layer gives way by less than 1e-3 of what it does below a force
FINEST = 12.0  # [1/√s] of a wave that the Gaussian leaves: e⁻⁷²
RING = 3  # [cells] around the taxels, and around those around them
COVERED = 0.75  # [cells] a contact vertex that is nearer to one is one of the map's
SAME_SIDE = 0.8  # [-] cosine of two faces' normals with no edge between them
MOST = 10_000  # taxels: a camera's picture, not a skin


@dataclass(frozen=True)
class TaxelGrid:
    """A grid of taxels, laid on a surface along its normal.

    The grid is flat. `add_taxels` moves each taxel along the normal to the outermost point of the surface.

    Parameters
    ----------
    center
        Middle of the grid (3,), in volume coordinates [m].
    normal
        Direction (3,) out of the surface, in the volume's axes.
    size
        Height and width (2,) of the grid [m], along its columns and its rows.
    shape
        Number of rows and columns.
    along
        Direction (3,) in which the row number grows. Its part along the normal does not count. The default is the
        volume's axis that is most across the normal.

    Raises
    ------
    MjframesError
        For directions that are zero or parallel, and for sizes and numbers that are not positive.
    """

    center: Sequence[float]
    normal: Sequence[float]
    size: Sequence[float]
    shape: tuple[int, int]
    along: Sequence[float] | None = None

    def __post_init__(self) -> None:
        for name, count in (("center", 3), ("normal", 3), ("size", 2)):
            value = getattr(self, name)
            if np.shape(value) != (count,) or not all(map(is_number, value)):
                raise MjframesError(f"{name} is {value!r}; give {count} finite numbers.")
        if not np.linalg.norm(self.normal) > 0:
            raise MjframesError(f"normal is {self.normal!r}; give a direction that is not zero.")
        if min(self.size) <= 0:
            raise MjframesError(f"size is {self.size!r}; give a height and a width > 0 in metres.")
        whole = np.shape(self.shape) == (2,) and all(map(is_whole, self.shape))
        if not whole or min(self.shape) < 1 or int(np.prod(self.shape)) > MOST:
            raise MjframesError(f"shape is {self.shape!r}; give two whole numbers ≥ 1, {MOST} taxels at most.")
        if self.along is not None and not (
            np.shape(self.along) == (3,) and all(map(is_number, self.along)) and np.linalg.norm(self._across) > 1e-9
        ):
            raise MjframesError(f"along is {self.along!r}; give a direction (3,) that is not along the normal.")

    @property
    def axes(self) -> Array:
        """Return the directions (3, 3) of growing rows and growing columns, and the normal, one a row."""
        normal, across = self._normal, self._across
        first = across / np.linalg.norm(across)
        return np.array([first, np.cross(normal, first), normal])

    @property
    def points(self) -> Array:
        """Return the middles (n, 3) of the taxels before they are moved to the surface, row by row [m]."""
        u, v, _ = self.axes
        a, b = _middles(self.size, self.shape).T
        return np.asarray(self.center, np.float64) + a[:, None] * u + b[:, None] * v

    @property
    def _normal(self) -> Array:
        return np.asarray(self.normal, np.float64) / np.linalg.norm(self.normal)

    @property
    def _across(self) -> Array:
        normal = self._normal
        along = np.eye(3)[np.argmin(abs(normal))] if self.along is None else np.asarray(self.along, np.float64)
        return along - (along @ normal) * normal


def add_taxels(
    spec: mujoco.MjSpec,
    body: SoftBody,
    name: str,
    grid: TaxelGrid,
    quantity: str = "pressure",
    sensor_name: str | None = None,
) -> mujoco.MjsSensor:
    """Add a sensor that feels where and how a soft body is touched to a spec.

    Parameters
    ----------
    spec
        The scene to change.
    body
        The soft body as it was attached.
    name
        Name of the soft body in the spec.
    grid
        Where the taxels are.
    quantity
        What to measure. Of each taxel: "pressure" [Pa]; "traction" (3,), the pressure and the shear along the rows' and
        the columns' directions on the surface [Pa]; "taxel_force" (3,) in the world's axes [N]; "markers" (3,), how far
        the material there has moved along the grid's axes, as seen from the body that the soft body hangs on [m]. Of
        all taxels: "resultant" (3,), the sum of their forces in the world's axes [N], and "pressure_centre" (3,), where
        they are pressed, in the world [m]; while nothing presses, the middle of the taxels.
    sensor_name
        Name of the sensor. The default is `name_quantity`.

    Returns
    -------
    mujoco.MjsSensor
        MuJoCo's sensor. Its values follow each other taxel by taxel, row by row.

    Raises
    ------
    MjframesError
        For other quantities, for a grid that is not on the surface, for a soft body that the spec does not have, that
        does not touch, is rigid there or has point frames, and for a sensor name that is taken.
    """
    if quantity not in QUANTITIES:
        raise MjframesError(f"quantity is {quantity!r}; it must be one of {', '.join(map(repr, QUANTITIES))}.")
    if not isinstance(grid, TaxelGrid):
        raise MjframesError(f"grid is a {type(grid).__name__}; give a TaxelGrid.")
    soft = soft_attributes(spec, body, name)
    place, normal = _on_surface(body, grid.axes, grid.points)
    if (beside := np.flatnonzero(np.isnan(place[:, 0]))).size:
        raise MjframesError(
            f"the grid's taxel {divmod(int(beside[0]), grid.shape[1])} is beside the soft body; move the grid or make "
            "it smaller."
        )
    config = {"quantity": quantity, "shape": "{} {}".format(*grid.shape)}
    if quantity == "markers":
        config |= _moved_with(body, soft, place) | {"place": encode(place), "axes": encode(grid.axes)}
    else:
        if "patch_size" not in soft:
            raise MjframesError(f"{name!r} has no contact; attach it with contact=True to feel what touches it.")
        if "point" in body.types:
            raise MjframesError(
                f"{name!r} has frames of the type 'point', which feel no pressure; build it with "
                "frame_type='affine', or take quantity='markers'."
            )
        config |= _pressed(body, grid, soft, place, normal)
    return write_sensor(spec, name, sensor_name or f"{name}_{quantity}", QUANTITIES[quantity].plugin, config)


def _moved_with(body: SoftBody, soft: dict[str, str], place: Array) -> dict[str, str]:
    """What the plugin reads of how places (n, 3) move with the body."""
    return place_attributes(material_points(body, decode(soft["point_rest"]).reshape(-1, 3), place))


def _on_surface(body: SoftBody, axes: Array, start: Array) -> tuple[Array, Array]:
    """Where points (n, 3) come to the skin along the grid's normal [m], and the normals there, outward; else NaN."""
    vertices, faces = body.skin.vertices, body.skin.faces
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    around, normals, areas = mesh.vertex_faces, mesh.face_normals, mesh.area_faces
    flat = vertices @ axes.T  # rows, columns, height
    corner, ab, ac = (flat[faces[:, 0]], *(flat[faces[:, i]] - flat[faces[:, 0]] for i in (1, 2)))
    twice = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    outward = np.flatnonzero(twice > 1e-12 * mesh.area)  # faces that face the normal's way
    corner, ab, ac, twice = corner[outward], ab[outward], ac[outward], twice[outward]
    place, normal = np.full_like(start, np.nan), np.full_like(start, np.nan)
    for t, (row, column, _) in enumerate(start @ axes.T):
        away = np.array([row, column]) - corner[:, :2]
        q = (away[:, 0] * ac[:, 1] - away[:, 1] * ac[:, 0]) / twice
        r = (ab[:, 0] * away[:, 1] - ab[:, 1] * away[:, 0]) / twice
        hit = np.flatnonzero((q >= -1e-9) & (r >= -1e-9) & (q + r <= 1 + 1e-9))
        if not len(hit):
            continue
        height = corner[hit, 2] + q[hit] * ab[hit, 2] + r[hit] * ac[hit, 2]
        top = hit[np.argmax(height)]
        face = int(outward[top])
        share = np.array([1 - q[top] - r[top], q[top], r[top]])
        place[t] = share @ vertices[faces[face]]
        normal[t] = share @ np.array([_smooth(around[corner], normals, areas, face) for corner in faces[face]])
    return place, normal / np.linalg.norm(normal, axis=1)[:, None]


def _around(grid: TaxelGrid, width: float) -> tuple[Array, Array]:
    """Middles (n, 3) and areas (n,) of cells around a grid, twice as wide from ring to ring, until they have a width.

    What presses across the grid's edge presses them, too.
    """
    size, shape = np.array(grid.size, np.float64), np.array(grid.shape)
    middles, areas = [np.zeros((0, 2))], [np.zeros(0)]
    while len(areas) == 1 or np.sqrt(np.prod(size / shape)) < width:
        inner, inside = -(-shape // 2), size
        shape = inner + 2 * RING
        size = size / inner * shape
        ring = _middles(size, shape)
        middles.append(ring[(np.abs(ring) > inside / 2).any(axis=1)])
        areas.append(np.full(len(middles[-1]), float(np.prod(size / shape))))
    return np.asarray(grid.center, np.float64) + np.vstack(middles) @ grid.axes[:2], np.concatenate(areas)


def _middles(size: Sequence[float] | Array, shape: Sequence[int] | NDArray[np.integer]) -> Array:
    """The middles (n, 2) of cells along a grid's rows and columns, from its own middle, row by row [m]."""
    along = [extent * ((np.arange(count) + 0.5) / count - 0.5) for extent, count in zip(size, shape, strict=True)]
    return np.stack(np.meshgrid(*along, indexing="ij"), axis=-1).reshape(-1, 2)


def _smooth(around: NDArray[np.integer], normals: Array, areas: Array, face: int) -> Array:
    """The surface's normal (3,) at a vertex of a face, on that face's side of edges.

    around: the faces at the vertex, and −1.  normals, areas: of all faces.
    """
    around = around[around >= 0]
    some = around[normals[around] @ normals[face] > SAME_SIDE]
    mean = areas[some] @ normals[some]
    return mean / np.linalg.norm(mean)


def _pressed(body: SoftBody, grid: TaxelGrid, soft: dict[str, str], place: Array, normal: Array) -> dict[str, str]:
    """What the plugin reads of taxels at places (n, 3) with normals (n, 3) to find out how they are pressed."""
    vertex_area = _area(body) / max(len(body.contact.positions), 1)
    middle, cell = _around(grid, float(np.sqrt(vertex_area)))
    around, facing = _on_surface(body, grid.axes, middle)
    found = ~np.isnan(around[:, 0])
    cells, normals = np.vstack([place, around[found]]), np.vstack([normal, facing[found]])
    flat = np.concatenate([np.full(len(place), np.prod(grid.size) / np.prod(grid.shape)), cell[found]])
    area = flat / np.maximum(normals @ grid.axes[2], 0.2)
    beside, facing, vertex = _vertices_beside(soft, cells, np.sqrt(area))
    everything = np.vstack([cells, beside])
    widths = np.concatenate([area, np.full(len(beside), vertex_area)])
    least = float(widths.min())
    dents = body.contact.dents
    near = KDTree(body.contact.positions).query(place)[1]
    softness, thickness = float(np.median(dents.softness[near])) ** 2, float(np.median(dents.thickness[near]))
    material = int(np.bincount(dents.material[near]).argmax())
    table = voxel_grid(body.fields.volume).table
    if table[material].is_rigid or not softness > 0:
        raise MjframesError("the soft body is rigid where the grid is; taxels need flesh below them.")
    spread = 2 * PRESSURE * least / 12
    reach = min(float(np.linalg.norm(np.ptp(everything, axis=0))), DECAYED * thickness) + 2 * np.sqrt(widths.max())
    along = grid.axes[0] - (normal @ grid.axes[0])[:, None] * normal
    moved = _moved_with(body, soft, cells)
    return {key: value for key, value in moved.items() if key not in ("region", "rise")} | {
        "place": encode(everything),
        "normal": encode(np.vstack([normals, facing])),
        "along": encode(along / np.linalg.norm(along, axis=1)[:, None]),
        "area": encode(area[: len(place)]),
        "widened": encode(np.pi / 2 * PRESSURE * (widths - least) / 12),
        "vertex": encode(vertex),
        "kernel": _kernel(float(reach), spread, thickness, table[material].poisson),
        "kernel_step": repr(float(reach) / (STEPS - 1)),
        "softness": repr(softness),
        "thickness": repr(thickness),
        "factor": str(int(factor_of(table)[material]) + 1),
    }


@lru_cache(maxsize=16)  # the quantities of a grid have the same
def _kernel(reach: float, spread: float, thickness: float, poisson: float) -> str:
    """What the plugin reads of the response of a layer as far as `reach` [m]."""
    return encode(layer_response(np.linspace(0, reach, STEPS), spread, thickness, poisson))


def _area(body: SoftBody) -> float:
    """Of the skin [m²]."""
    a, b, c = (body.skin.vertices[body.skin.faces[:, i]] for i in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def _vertices_beside(soft: dict[str, str], place: Array, width: Array) -> tuple[Array, Array, NDArray[np.int64]]:
    """Of the contact vertices that are of no cell (n,): where they are (s, 3) [m], the normals there, their numbers."""
    if "lattice_vertex" not in soft:
        return np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, np.int64)
    axes = decode(soft["lattice_axes"]).reshape(3, 3)
    cubes, normal = (decode(soft[f"lattice_{key}"]).reshape(-1, 3) for key in ("vertex", "normal"))
    positions = decode(soft["lattice_origin"]) + float(soft["lattice_spacing"]) * cubes @ axes.T
    away, nearest = KDTree(place).query(positions)
    beside = np.flatnonzero(away > COVERED * width[nearest])
    facing = normal[beside].astype(np.float64)
    return positions[beside], facing / np.linalg.norm(facing, axis=1)[:, None], beside


@dataclass(frozen=True)
class TaxelMap:
    """A sensor of taxels in a compiled model.

    name: of the sensor.  quantity: that it measures.  shape: rows and columns.  values: where `sensordata` has them.
    """

    name: str
    quantity: str
    shape: tuple[int, int]
    values: slice

    def of(self, data: mujoco.MjData) -> Array:
        """Return what the taxels feel now (rows, columns, …)."""
        return data.sensordata[self.values].reshape(*self.shape, -1)


def taxel_maps(model: mujoco.MjModel) -> list[TaxelMap]:
    """Return the sensors of a model that have a value for each taxel or marker."""
    found = []
    for sensor in range(model.nsensor):
        instance = model.sensor_plugin[sensor]
        if instance < 0:
            continue
        text = bytes(model.plugin_attr[model.plugin_attradr[instance] :]).split(b"\0", 2)
        quantity = text[0].decode(errors="replace")
        if len(text) > 2 and quantity in QUANTITIES and quantity not in OF_ALL:
            rows, columns = map(int, text[1].split())
            first = int(model.sensor_adr[sensor])
            values = slice(first, first + int(model.sensor_dim[sensor]))
            found.append(TaxelMap(model.sensor(sensor).name, quantity, (rows, columns), values))
    return found


def layer_response(r: Array, spread: float, thickness: float, poisson: float) -> Array:
    """Return K (n,) [1/m] at distances r (n,) [m].  spread: s [m²].  thickness: t [m]."""
    most = FINEST / np.sqrt(spread)
    count = int(np.clip(4 * most * max(float(r.max()), thickness), 1000, 20_000))
    k = (np.arange(count) + 0.5) * most / count
    depth, g = np.minimum(k * thickness, 100), 3 - 4 * poisson
    share = (2 * g * np.sinh(2 * depth) - 4 * depth) / (2 * g * np.cosh(2 * depth) + 4 * depth**2 + 1 + g**2)
    share *= np.exp(-spread * k**2 / 2) * most / count
    return np.array([share @ j0(k * at) for at in r])
