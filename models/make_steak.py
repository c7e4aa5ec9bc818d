"""The T-bone steak of the paper's Figure 1 as a labelled volume: 1 flesh, 2 bone (rigid), 3 fat.

Drawn from closed curves in the plane (x to the strip loin, y to the cross bar of the T) and a thickness
h(x, y) along z; about 67,000 voxels, as in the paper's table of timings. Run it to write `mjframes/dm/steak.npz`,
to which steak.npz beside this file is a link.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

Array = NDArray[np.float64]

FLESH, BONE, FAT = 1, 2, 3
SPACING = 2.28e-3  # [m] what gives the paper's number of voxels
MATERIALS = {
    FLESH: Material(1.2e4, 0.45, 1050, name="flesh", rgba=(0.58, 0.09, 0.11, 1.0)),
    BONE: Material.rigid(1900, name="bone", rgba=(0.93, 0.89, 0.77, 1.0)),
    FAT: Material(1e4, 0.45, 920, name="fat", rgba=(0.96, 0.89, 0.75, 1.0)),
}

# All lengths below in centimetres. The outline runs clockwise from the left end of the cross bar.
OUTLINE = np.array([
    (-6.9, 7.5), (-5.0, 8.0), (-2.6, 8.0), (0.4, 8.35), (3.6, 8.35), (6.6, 8.3), (9.4, 7.2), (11.5, 4.9), (12.5, 1.6),
    (12.3, -1.9), (11.0, -5.2), (8.6, -7.9), (5.4, -9.5), (2.2, -10.1), (-0.5, -9.6), (-1.9, -8.0), (-2.7, -6.1),
    (-4.2, -5.2), (-6.6, -5.1), (-8.8, -4.0), (-10.6, -1.8), (-11.4, 1.1), (-10.7, 4.1), (-9.0, 6.3),
])  # fmt: skip
# x, y, radius: balls strung together; the knobs at the ends are what makes a bone look like one.
CROSS_BAR = np.array([
    (-7.0, 6.5, 1.3), (-5.9, 7.1, 0.95), (-4.3, 7.35, 0.75), (-2.6, 7.3, 0.95), (-0.6, 7.1, 1.3), (1.4, 7.45, 0.95),
    (3.2, 7.65, 0.75), (5.0, 7.35, 0.9), (6.2, 6.9, 1.25),
])  # fmt: skip
SHAFT = np.array([
    (-0.7, 7.2, 1.5), (-0.69, 5.6, 1.1), (-0.51, 3.8, 0.85), (-0.9, 1.9, 0.72), (-1.55, 0.1, 0.64), (-1.9, -1.5, 0.57),
    (-1.95, -3.0, 0.55), (-1.7, -4.5, 0.55), (-1.3, -5.9, 0.58), (-0.95, -6.8, 0.85),
])  # fmt: skip
# Below the tip of the shaft: a seam of fat to the edge, widening.
SEAM = np.array([(-0.95, -7.0, 0.7), (-0.8, -7.8, 1.1), (-0.6, -8.4, 1.2)])
# Fat that fills the corners between the cross bar and the muscles.
CORNERS = np.array([[(0.4, 5.6, 0.75), (2.8, 6.6, 0.45)], [(-2.0, 5.5, 0.7), (-4.2, 6.5, 0.4)]])
# x, y, thickness of the rim of fat at places on the edge: most at the tail of the strip loin, none at the tenderloin.
RIM = np.array([
    (7.0, 8.2, 0.6), (9.6, 7.0, 0.75), (12.5, 1.0, 0.7), (11.3, -4.6, 0.95), (8.0, -8.2, 1.0), (4.0, -9.8, 1.1),
    (0.5, -10.0, 1.2), (-1.8, -8.0, 0.9), (-3.4, -5.6, 0.5), (-6.6, -5.1, 0.0), (-11.4, 1.0, -1.0), (-8.4, 7.0, -1.0),
    (0.0, 8.4, -1.0),
])  # fmt: skip


def make_steak() -> Volume:
    """The volume, its centroid at 0, z its thickness; bone and fat part the flesh in two."""
    h = 100 * SPACING
    x, y, z = (h * (np.arange(n, dtype=np.float64) - (n - 1) / 2) for n in (124, 104, 20))  # with room to spare
    at: Array = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
    at = at + 0.12 * _ripple(at, 1.9) + 0.05 * _ripple(at[..., ::-1] + 3.0, 5.3)  # no edge of meat is a spline

    bone = _union(_string(at, CROSS_BAR), _string(at, SHAFT), 0.5)
    edge = np.minimum(_inside(at, _smooth(OUTLINE)), bone)  # < 0 inside the steak

    fat = np.minimum(_string(at, SEAM), np.minimum(_string(at, CORNERS[0]), _string(at, CORNERS[1])))
    fat = np.minimum(fat, -edge - _rim_thickness(at))

    flat = np.where(bone < 0, BONE, np.where(fat < 0, FAT, FLESH)) * ndimage.binary_opening(edge < 0)
    top, bottom = _surfaces(at, flat != 0)
    labels = np.where((z < top[..., None]) & (z > -bottom[..., None]), flat[..., None], 0)
    labels = labels[ndimage.find_objects((labels != 0).astype(int))[0]]
    corner = -SPACING * (np.array(ndimage.center_of_mass(labels != 0)) + 0.5)
    return Volume.from_labels(labels, SPACING, MATERIALS, corner)


def _surfaces(at: Array, steak: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Heights of the upper and lower surface: domed in the middle, rounded at the rim, uneven."""
    depth = np.minimum(100 * SPACING * np.asarray(ndimage.distance_transform_edt(steak)), 2.0) / 2.0
    rounding = 0.55 + 0.45 * np.sqrt(1 - (1 - depth) ** 2)
    dome = 1 - 0.0022 * (at**2).sum(-1)
    uneven = 0.05 * _ripple(at, 0.7)[..., 0]
    return rounding * (1.42 * dome + uneven), rounding * (1.34 * dome - 0.5 * uneven)


def _smooth(points: Array, steps: int = 24) -> Array:
    """Closed Catmull-Rom curve through the points, (n, 2) -> (n * steps, 2)."""
    t = np.linspace(0, 1, steps, endpoint=False)[:, None]
    before, after, beyond = (np.roll(points, -k, axis=0)[:, None] for k in (-1, 1, 2))
    here = points[:, None]
    cubic = (3 * (here - after) + beyond - before) * t**3 + (2 * before - 5 * here + 4 * after - beyond) * t**2
    return (here + (cubic + (after - before) * t) / 2).reshape(-1, 2)


def _inside(at: Array, curve: Array) -> Array:
    """Signed distance to a closed polygon with narrow sides, negative inside: (…, 2) -> (…)."""
    p, q = curve, np.roll(curve, -1, axis=0)
    distance = np.full(at.shape[:-1], np.inf)
    crossings = np.zeros(at.shape[:-1], int)
    for (px, py), (qx, qy) in zip(p, q, strict=True):
        distance = np.minimum(distance, np.hypot(at[..., 0] - px, at[..., 1] - py))
        spans = (at[..., 1] < py) != (at[..., 1] < qy)
        crossings += spans & (at[..., 0] < px + (at[..., 1] - py) * (qx - px) / (qy - py if qy != py else 1.0))
    return np.where(crossings % 2 == 1, -distance, distance)


def _string(at: Array, balls: Array) -> Array:
    """Signed distance to balls (x, y, radius) joined by cones, negative inside."""
    distance = np.full(at.shape[:-1], np.inf)
    for a, b in pairwise(balls):
        along = b[:2] - a[:2]
        t = np.clip((at - a[:2]) @ along / (along @ along), 0, 1)
        to_axis = np.linalg.norm(at - a[:2] - t[..., None] * along, axis=-1)
        distance = np.minimum(distance, to_axis - a[2] - t * (b[2] - a[2]))
    return distance


def _union(a: Array, b: Array, fillet: float) -> Array:
    """Signed distance to the union of two shapes with a rounded inner corner."""
    blend = np.clip(0.5 + 0.5 * (b - a) / fillet, 0, 1)
    return b + blend * (a - b) - fillet * blend * (1 - blend)


def _rim_thickness(at: Array) -> Array:
    """Thickness of the rim of fat: the places of RIM, each counting with the inverse fourth power of its distance."""
    weight = 1 / (0.5 + ((at[..., None, :] - RIM[:, :2]) ** 2).sum(-1)) ** 2
    return (weight * RIM[:, 2]).sum(-1) / weight.sum(-1)


def _ripple(at: Array, wave: float) -> Array:
    """Smooth irregularity of size 1, `wave` radians per centimetre: a fixed sum of sines instead of random numbers."""
    x, y = wave * at[..., 0], wave * at[..., 1]
    u = np.sin(x + 1.7 * np.sin(0.6 * y + 0.4)) * np.cos(0.8 * y - 0.3 * x + 1.1)
    v = np.sin(0.9 * y + 1.3 * np.sin(0.7 * x + 2.0)) * np.cos(0.7 * x + 0.4 * y + 0.2)
    return np.stack((u, v), axis=-1)


if __name__ == "__main__":
    path = Path(__file__).with_name("steak.npz").resolve()  # a link to the file that is installed
    steak = make_steak()
    steak.save(path)
    counts = {m.name: int((steak.labels == label).sum()) for label, m in steak.materials.items()}
    print(f"{path}: {sum(counts.values())} voxels, {counts}")
