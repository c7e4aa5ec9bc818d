"""Boxes, balls and cylinders as voxels, centred on the origin: a voxel is inside if its centre is.

Flat sides fall between voxels, so a box, and the length of a cylinder, are exact. Curved sides are sampled.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjframes.base.errors import MjframesError
from mjframes.base.numbers import is_number
from mjframes.volume.spacing import require_room, spacing_or_voxels, three_lengths

Array = NDArray[np.float64]
Solid = tuple[NDArray[np.uint8], Array, Array]  # labels (nx, ny, nz), 0 or 1; spacing (3,) and origin (3,) [m]

OFF = 0.25  # [-] by which the voxels' volume may differ from the body's: at a spacing of radius / 3 it does by 0.2 …
FINE = 0.3  # [radii] … and with this spacing or less by less


def box(size: ArrayLike, spacing: ArrayLike | None, voxels: int | None) -> Solid:
    """Return a box with edges `size`, one length or three [m]."""
    lengths = three_lengths("size", size)
    return _sampled(lengths, (True, True, True), float(np.prod(lengths)), lambda *_: True, spacing, voxels)


def ball(radius: float, spacing: ArrayLike | None, voxels: int | None) -> Solid:
    """Return a ball. radius: [m]."""
    _require_length("radius", radius)
    content = 4 / 3 * np.pi * radius**3

    def inside(x: Array, y: Array, z: Array) -> NDArray[np.bool_]:
        return x**2 + y**2 + z**2 < radius**2

    return _sampled(np.full(3, 2.0 * radius), (False, False, False), content, inside, spacing, voxels)


def cylinder(radius: float, length: float, spacing: ArrayLike | None, voxels: int | None) -> Solid:
    """Return a cylinder along z. radius, length: [m]."""
    _require_length("radius", radius)
    _require_length("length", length)
    lengths, content = np.array([2.0 * radius, 2.0 * radius, length]), np.pi * radius**2 * length

    def inside(x: Array, y: Array, z: Array) -> NDArray[np.bool_]:
        return x**2 + y**2 < radius**2

    return _sampled(lengths, (False, False, True), content, inside, spacing, voxels)


def _require_length(name: str, value: float) -> None:
    if not (is_number(value) and value > 0):
        raise MjframesError(f"{name} is {value!r}; it must be a positive length in metres.")


def _sampled(
    lengths: Array,
    is_flat: tuple[bool, bool, bool],
    content: float,
    inside: Callable[[Array, Array, Array], NDArray[np.bool_] | bool],
    spacing: ArrayLike | None,
    voxels: int | None,
) -> Solid:
    """The voxels whose centres are inside.

    lengths: (3,) of the body's box [m].  is_flat: along which axes it ends in flat sides, between which the nearest
    whole number of voxels fits.  content: its volume [m³].  inside: of coordinates x, y and z [m].
    """
    given, count = spacing_or_voxels(spacing, voxels)
    step = np.full(3, (content / count) ** (1 / 3)) if given is None else given
    cells = np.where(is_flat, np.rint(lengths / step), np.ceil(lengths / step - 1e-6))
    cells = np.maximum(cells, 1 if given is None else 0)
    step = np.where(is_flat, lengths / np.maximum(cells, 1), step)
    shape = require_room(cells, step)
    origin = -step * cells / 2
    labels = np.zeros(shape, np.uint8)
    labels[:] = inside(
        *np.ix_(*(low + (np.arange(n) + 0.5) * h for low, n, h in zip(origin, shape, step, strict=True)))
    )
    said = f"voxels is {voxels!r}" if given is None else f"spacing is {spacing!r}"
    if not labels.any():
        right = "more" if given is None else "less"
        across = " × ".join(f"{length:g}" for length in lengths)
        raise MjframesError(f"{said}, which leaves no voxel in a body of {across} m; take {right}.")
    ratio = np.count_nonzero(labels) * float(np.prod(step)) / content
    if abs(ratio - 1) > OFF:
        enough = FINE * float(np.min(lengths[~np.array(is_flat)])) / 2
        right = f"{np.ceil(content / enough**3):.0f} or more" if given is None else f"{enough:.2g} m or less"
        raise MjframesError(f"{said}, which makes voxels of {ratio:.2g} times the body's volume; take {right}.")
    return labels, step, origin
