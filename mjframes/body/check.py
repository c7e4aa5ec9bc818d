"""Whether the arrays of a soft body fit each other: one from a file may say anything, and compiled loops trust it.

k control points, f frames, r regions, n voxels; m is the number of a region's control points.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import sparse

from mjframes.base.choices import COROTATIONAL, METRICS, MODES
from mjframes.elasticity.law_table import ALL_LAWS
from mjframes.kinematics.control import POINTS

if TYPE_CHECKING:
    from mjframes.body.fields import Fields
    from mjframes.body.soft_body import SoftBody

Shape = tuple[int | None, ...]  # None for any length
UNITY = 1e-6  # [-] that control weights may sum to more or less than 1: rounding leaves 1e-14
LARGEST_WEIGHT = 1e4  # [-] of control weights: those of points near a body are below 10


def check_body(body: SoftBody) -> None:
    """Raise ValueError, which names an array, where shapes, indices or numbers are not as `SoftBody` says."""
    _require("types", bool(body.types) and all(name in POINTS for name in body.types))
    frames, control = len(body.types), body.control
    _indices("parent", body.parent, (frames,), frames, least=-1)
    _require("parent", bool((body.parent < np.arange(frames)).all()))
    _require("links", len(body.links) <= frames)
    expected = np.repeat(np.arange(frames), [POINTS[name] for name in body.types])
    _require("control.frame", np.array_equal(control.frame, expected))
    k = len(expected)
    for name, shape in (("rest", (k, 3)), ("basis", (k, 10)), ("center", (k, 3)), ("axes", (3, 3))):
        _numbers(f"control.{name}", getattr(control, name), shape)
    _numbers("control.mass", control.mass, (k,), least=0)
    _numbers("control.scale", control.scale, (k,), least=0)
    _require("mode", body.mode in MODES)
    _require("damping", len(body.damping) == 2 and all(np.isfinite(some) and some >= 0 for some in body.damping))
    _require("error", body.error is None or all(map(np.isfinite, body.error.parts.values())))
    sizes = _check_regions(body, k)
    _check_law(body, sizes)
    _check_surfaces(body, k)
    _check_fields(body.fields, frames, k, sizes)


def _check_regions(body: SoftBody, k: int) -> list[int]:
    """Return m of each region."""
    stiffness = body.stiffness
    _require("stiffness.points", len(stiffness.points) > 0)
    for points in stiffness.points:
        _indices("stiffness.points", points, (None,), k)
        _require("stiffness.points", 0 < len(points) == len(np.unique(points)))
    sizes = [len(points) for points in stiffness.points]
    _numbers("stiffness.volume", stiffness.volume, (len(sizes),), least=0)
    _each("stiffness.gradient", stiffness.gradient, [(m, 3) for m in sizes])
    _each("stiffness.matrix", stiffness.matrix, [(3 * m, 3 * m) for m in sizes])
    if stiffness.shares:
        _check_shares("stiffness.shares", body, stiffness.shares, sizes)
    if body.mass_difference:
        _each("mass_difference", body.mass_difference, [(m, m) for m in sizes])
    return sizes


def _check_shares(name: str, body: SoftBody, shares: Sequence[np.ndarray], sizes: Sequence[int]) -> None:
    materials = len(body.deformable)
    _each(name, shares, [(materials - 1, None, 3 * m) for m in sizes])
    _require(name, all(some.shape[1] % 3 == 0 and some.shape[1] <= some.shape[2] for some in shares))


def _check_law(body: SoftBody, sizes: Sequence[int]) -> None:
    _require("law", body.law in ALL_LAWS)
    materials = 0 if body.law == COROTATIONAL else len(body.factor_of)
    _numbers("law_constants", body.law_constants, (materials, 3))
    _require("law", body.law == COROTATIONAL or (body.cells is None) != (body.quadrature is None))
    if body.cells is not None:
        cells, counts = body.cells, [len(some) for some in body.cells.volume]
        _each("cells.volume", cells.volume, [(None,)] * len(sizes))
        _each_index("cells.material", cells.material, counts, materials)
        _each("cells.slope", cells.slope, [(q, 9, 3 * m) for q, m in zip(counts, sizes, strict=True)])
        _each("cells.remainder", cells.remainder, [(3 * m, 3 * m) for m in sizes])
        _check_shares("cells.shares", body, cells.shares, sizes)
    if body.quadrature is not None:
        quadrature, counts = body.quadrature, [len(some) for some in body.quadrature.volume]
        _each("quadrature.volume", quadrature.volume, [(None,)] * len(sizes))
        _each("quadrature.position", quadrature.position, [(q, 3) for q in counts])
        _each("quadrature.gradient", quadrature.gradient, [(q, m, 3) for q, m in zip(counts, sizes, strict=True)])
        _each_index("quadrature.material", quadrature.material, counts, materials)
        pairs = zip(quadrature.points, body.stiffness.points, strict=True)
        _require("quadrature.points", all(np.array_equal(own, of_region) for own, of_region in pairs))


def _check_surfaces(body: SoftBody, k: int) -> None:
    skin, contact, field = body.skin, body.contact, body.distance_field
    _numbers("skin.vertices", skin.vertices, (None, 3))
    _require("skin.vertices", bool(np.ptp(skin.vertices, axis=0).max() > 0))
    _indices("skin.faces", skin.faces, (None, 3), len(skin.vertices))
    _indices("skin.label", skin.label, (len(skin.faces),), max(body.materials) + 1)
    _require("skin.label", set(np.unique(skin.label).tolist()) <= set(body.materials))
    _control_weights("skin.weights", skin.weights, len(skin.vertices), k)
    vertices = len(contact.patch)
    _numbers("contact.positions", contact.positions, (vertices, 3))
    _numbers("contact.normals", contact.normals, (vertices, 3))
    _require("contact.reach", np.isfinite(contact.reach) and contact.reach > 0)
    for name, number in (("patch", contact.patch), ("cluster", contact.cluster)):
        _indices(f"contact.{name}", number, (vertices,), vertices)
    order = contact.patch * (vertices + 1) + contact.cluster
    _require("contact.patch", bool((np.diff(order) >= 0).all()) and _counts_on(contact.patch))
    _control_weights("contact.weights", contact.weights, vertices, k)
    for name in ("width", "softness", "thickness"):
        _numbers(f"contact.dents.{name}", getattr(contact.dents, name), (vertices,), least=0)
    _indices("contact.dents.material", contact.dents.material, (vertices,), len(body.factor_of))
    nodes = len(field.node)
    _require("distance_field.spacing", np.isfinite(field.spacing) and field.spacing > 0)
    _numbers("distance_field.origin", field.origin, (3,))
    _indices("distance_field.shape", field.shape, (3,), np.iinfo(np.int32).max)
    cells = int(np.prod(field.shape.astype(object)))
    _indices("distance_field.node", field.node, (nodes,), cells)
    _require("distance_field.node", bool((np.diff(field.node) > 0).all()))
    _numbers("distance_field.distance", field.distance, (nodes,))
    _indices("distance_field.patch", field.patch, (nodes,), int(contact.patch.max(initial=-1)) + 1)
    _control_weights("distance_field.weights", field.weights, nodes, k)
    _numbers("distance_field.vertices", field.vertices, (vertices, 3))


def _check_fields(fields: Fields, frames: int, k: int, sizes: Sequence[int]) -> None:
    n = int(np.count_nonzero(fields.volume.labels))
    _rows("fields.weights", fields.weights, n, frames)
    filled = np.diff(fields.weights.indptr) > 0
    _require("fields.weights", bool(filled.all()) and bool((fields.weights.sum(axis=1) > 0).all()))
    if fields.correction is not None:
        _rows("fields.correction", fields.correction, n, k)
    for name, some, entries in (("lifting", fields.lifting, 3), ("strains", fields.strains, 6)):
        if some is not None:
            modes = some.mode.shape[-1] if some.mode.ndim else 0
            _numbers(f"fields.{name}.mode", some.mode, (n, entries, modes))
            _each(f"fields.{name}.share", some.share, [(None, 3 * m) for m in sizes])
            _require(f"fields.{name}.share", all(len(share) <= modes for share in some.share))
    if fields.error is not None:
        _numbers("fields.error", fields.error, (n,))
    _indices("fields.region", fields.region, (n,), len(sizes))
    _require("fields.seeds", len(fields.seeds) == frames)
    for seeds in fields.seeds:
        _indices("fields.seeds", seeds, (None,), n)
        _require("fields.seeds", len(seeds) > 0)
    _require("fields.metric", fields.metric in METRICS)


def _require(name: str, right: bool) -> None:
    if not right:
        raise ValueError(f"{name} does not fit the other arrays")


def _shaped(name: str, array: np.ndarray, shape: Shape) -> None:
    fits = array.ndim == len(shape) and all(
        want is None or have == want for have, want in zip(array.shape, shape, strict=True)
    )
    if not fits:
        wanted = " × ".join("any" if length is None else str(length) for length in shape)
        raise ValueError(f"{name} has shape {array.shape}, not {wanted}")


def _numbers(name: str, array: np.ndarray, shape: Shape, least: float = -np.inf) -> None:
    """Raise unless it has that shape, and finite numbers from `least` on."""
    _shaped(name, array, shape)
    if array.dtype.kind not in "fiu" or not np.isfinite(array).all() or not (array >= least).all():
        raise ValueError(f"{name} has values that are not finite, or negative ones")


def _indices(name: str, array: np.ndarray, shape: Shape, below: int, least: int = 0) -> None:
    """Raise unless it has that shape, and whole numbers from `least` up to `below`."""
    _shaped(name, array, shape)
    if array.dtype.kind not in "iu" or (array.size and (array.min() < least or array.max() >= below)):
        raise ValueError(f"{name} has values outside of {least} … {below - 1}")


def _each(name: str, arrays: Sequence[np.ndarray], shapes: Sequence[Shape]) -> None:
    _require(name, len(arrays) == len(shapes))
    for array, shape in zip(arrays, shapes, strict=True):
        _numbers(name, array, shape)


def _each_index(name: str, arrays: Sequence[np.ndarray], counts: Sequence[int], below: int) -> None:
    _require(name, len(arrays) == len(counts))
    for array, count in zip(arrays, counts, strict=True):
        _indices(name, array, (count,), below)


def _rows(name: str, matrix: sparse.csr_array, rows: int, columns: int) -> None:
    """Raise unless it is a sparse matrix of that shape, of finite numbers."""
    start: Any = matrix.indptr
    _require(name, matrix.shape == (rows, columns))
    _require(name, start.ndim == 1 and start[0] == 0 and bool((np.diff(start) >= 0).all()))
    _indices(f"{name}.indices", matrix.indices, (int(start[-1]),), columns)
    _numbers(f"{name}.data", matrix.data, (int(start[-1]),))


def _control_weights(name: str, matrix: sparse.csr_array, rows: int, columns: int) -> None:
    """Raise unless its rows are control weights of points: what moves as one moves them so, and none is huge."""
    _rows(name, matrix, rows, columns)
    if not (abs(matrix.sum(axis=1) - 1) < UNITY).all() or abs(matrix.data).max(initial=0) > LARGEST_WEIGHT:
        raise ValueError(f"{name} has rows that do not sum to 1, or huge weights")


def _counts_on(number: np.ndarray) -> bool:
    """Whether ascending numbers begin at 0 and leave none out."""
    return not len(number) or (number[0] == 0 and bool((np.diff(number) <= 1).all()))
