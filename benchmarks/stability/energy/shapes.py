"""Shapes that nobody tuned a body for, drawn from a seed: thin trays, brackets, necks, forks, foams, trees, shells.

A shape is a function (rng, n) → bool (a, b, c), n voxels along its longest side. The voxels are chosen so that there
are a few thousand of them; walls are one, two or three voxels thick whatever n is.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial.transform import Rotation

Inside = NDArray[np.bool_]
Shape = Callable[[np.random.Generator, int], Inside]

VOXELS = (3000, 7000)  # wanted at least and at most; a longest side of four voxels more can be 1.7 times as many
LONGEST = range(20, 141, 4)  # [voxels] that are tried


def drawn(name: str, seed: int) -> Inside:
    """Return a shape by its name, of about as many voxels as the seed says."""
    wanted = np.random.default_rng(seed).uniform(*VOXELS)
    inside = np.ones((1, 1, 1), bool)
    for n in LONGEST:
        inside = _largest(SHAPES[name](np.random.default_rng(seed), n))
        if inside.sum() >= wanted:
            break
    return inside


def _largest(inside: Inside) -> Inside:
    """The largest piece, cropped; voxels hang together by their faces."""
    pieces = np.zeros(inside.shape, np.int32)
    ndimage.label(inside, output=pieces)
    sizes = np.bincount(pieces.ravel(), minlength=2)
    sizes[0] = 0
    inside = pieces == sizes.argmax()
    where = np.argwhere(inside)
    low, high = where.min(axis=0), where.max(axis=0) + 1
    return inside[low[0] : high[0], low[1] : high[1], low[2] : high[2]]


def tray(rng: np.random.Generator, n: int) -> Inside:
    """Return a tray open above."""
    wall, width, height = int(rng.integers(1, 3)), int(n * rng.uniform(0.5, 1)), max(4, int(n * rng.uniform(0.12, 0.3)))
    inside = np.ones((n, width, height), bool)
    inside[wall:-wall, wall:-wall, wall:] = False
    return inside


def bracket(rng: np.random.Generator, n: int) -> Inside:
    """Return an L of two plates, now and then with a rib."""
    wall, width, height = int(rng.integers(2, 4)), int(n * rng.uniform(0.3, 0.8)), int(n * rng.uniform(0.5, 1))
    inside = np.zeros((n, width, height), bool)
    inside[:wall] = inside[..., :wall] = True
    if rng.random() < 0.5:
        x, z = np.ogrid[:n, :height]
        middle = width // 2
        inside[:, middle : middle + wall] |= (x / n + z / height < 0.5)[:, None]
    return inside


def neck(rng: np.random.Generator, n: int) -> Inside:
    """Return two lumps on a thin neck."""
    big, small = rng.uniform(0.16, 0.24, 2)
    ends = np.array([[big, 0.5, 0.5], [1 - small, 0.5, 0.5]])
    balls = _capsules(n, ends, ends, np.array([big, small]))
    return balls | _capsules(n, ends[:1], ends[1:], np.array([rng.uniform(1.1, 2.2) / n]))


def fork(rng: np.random.Generator, n: int) -> Inside:
    """Return a handle with thin tines."""
    tines, thick = int(rng.integers(2, 6)), rng.uniform(1.1, 2.5) / n
    y = np.linspace(0.3, 0.7, tines)
    base = np.stack([np.full(tines, 0.5), y, np.full(tines, 0.5)], axis=1)
    handle = _capsules(n, np.array([[0.06, 0.5, 0.5]]), np.array([[0.45, 0.5, 0.5]]), np.array([0.05]))
    bridge = _capsules(n, base[:1], base[-1:], np.array([0.05]))
    return handle | bridge | _capsules(n, base, base + np.array([0.46, 0, 0]), np.full(tines, thick))


def foam(rng: np.random.Generator, n: int) -> Inside:
    """Return a block full of holes."""
    inside = np.ones((n, int(n * 0.8), int(n * 0.6)), bool)
    for _ in range(40):
        centre, radius = rng.uniform(0, inside.shape), n * rng.uniform(0.08, 0.17)
        x, y, z = np.ogrid[: inside.shape[0], : inside.shape[1], : inside.shape[2]]
        inside &= (x - centre[0]) ** 2 + (y - centre[1]) ** 2 + (z - centre[2]) ** 2 > radius**2
    return inside


def tree(rng: np.random.Generator, n: int) -> Inside:
    """Return branches that fork in two, thinner at each fork."""
    starts, ends, radii = [np.array([0.5, 0.5, 0.05])], [np.array([0.5, 0.5, 0.35])], [0.05]
    tips = [(ends[0], np.array([0.0, 0, 1]), 0.05)]
    for _ in range(3):
        grown = []
        for at, along, radius in tips:
            for side in (-1, 1):
                way = Rotation.from_rotvec(side * rng.uniform(0.3, 0.8) * _direction(rng)).apply(along)
                tip = np.clip(at + rng.uniform(0.14, 0.24) * way, 0.03, 0.97)
                thin = max(0.7 * radius, 1.1 / n)
                starts.append(at)
                ends.append(tip)
                radii.append(thin)
                grown.append((tip, way, thin))
        tips = grown
    return _capsules(n, np.array(starts), np.array(ends), np.array(radii))


def helix(rng: np.random.Generator, n: int) -> Inside:
    """Return a coil of wire."""
    turns, radius = rng.uniform(1.5, 3.5), rng.uniform(0.15, 0.3)
    t = np.linspace(0, 1, 80)
    angle = 2 * np.pi * turns * t
    curve = np.stack([0.5 + radius * np.cos(angle), 0.5 + radius * np.sin(angle), 0.1 + 0.8 * t], axis=1)
    return _capsules(n, curve[:-1], curve[1:], np.full(79, rng.uniform(1.4, 3) / n))


def plate(rng: np.random.Generator, n: int) -> Inside:
    """Return a plate of one voxel."""
    return np.ones((n, int(n * rng.uniform(0.6, 1)), 1), bool)


def double_plate(rng: np.random.Generator, n: int) -> Inside:
    """Return a plate of two voxels."""
    return np.ones((n, int(n * rng.uniform(0.4, 1)), 2), bool)


def shell(rng: np.random.Generator, n: int) -> Inside:
    """Return a closed thin-walled egg."""
    half = 0.5 * n * np.array([1, rng.uniform(0.5, 1), rng.uniform(0.4, 1)])
    solid = _ellipsoid(half)
    whole = np.ones((3, 3, 3), bool)  # so that what is left hangs together by faces
    inner = np.asarray(ndimage.binary_erosion(solid, whole, iterations=int(rng.integers(1, 3))), bool)
    return solid & ~inner


def box(rng: np.random.Generator, n: int) -> Inside:
    """Return a closed thin-walled box."""
    wall = int(rng.integers(1, 3))
    inside = np.ones((n, int(n * rng.uniform(0.4, 0.9)), int(n * rng.uniform(0.3, 0.7))), bool)
    inside[wall:-wall, wall:-wall, wall:-wall] = False
    return inside


def star(rng: np.random.Generator, n: int) -> Inside:
    """Return spikes in random directions from a lump."""
    count = int(rng.integers(4, 9))
    centre = np.full((count, 3), 0.5)
    tips = centre + np.array([_direction(rng) for _ in range(count)]) * rng.uniform(0.25, 0.46, (count, 1))
    spikes = _capsules(n, centre, tips, np.full(count, rng.uniform(1.1, 2.5) / n))
    return spikes | _capsules(n, centre[:1], centre[:1], np.array([rng.uniform(0.08, 0.15)]))


def ribbon(rng: np.random.Generator, n: int) -> Inside:
    """Return a twisted strip."""
    twist, half, wall = rng.uniform(1, 4), 0.12 * n, rng.uniform(0.8, 1.4)
    x, y, z = np.mgrid[:n, : int(0.3 * n), : int(0.3 * n)].astype(float)
    y, z = y - y.mean(), z - z.mean()
    angle = twist * x / n
    across, up = np.cos(angle) * y + np.sin(angle) * z, np.cos(angle) * z - np.sin(angle) * y
    return (np.abs(across) < half) & (np.abs(up) < wall)


def blob(rng: np.random.Generator, n: int) -> Inside:
    """Return a lump with bays, from noise."""
    noise = np.asarray(ndimage.gaussian_filter(rng.normal(size=(24, 24, 24)), 2.5))
    noise = np.asarray(ndimage.zoom(noise / noise.std(), n / 24, order=1))
    axis = np.linspace(-1, 1, n)
    distance = np.linalg.norm(np.stack(np.meshgrid(axis, axis, axis, indexing="ij")), axis=0)
    return (noise > -0.4 + 3 * (distance - 0.7)) & (distance < 1)


SHAPES: dict[str, Shape] = {
    shape.__name__.replace("_", " "): shape
    for shape in (
        *(tray, bracket, neck, fork, foam, tree, helix),
        *(plate, double_plate, shell, box, star, ribbon, blob),
    )
}


def _capsules(n: int, starts: NDArray[np.float64], ends: NDArray[np.float64], radii: NDArray[np.float64]) -> Inside:
    """What is near segments (s, 3) within the unit cube of n³ voxels."""
    points = (np.stack(np.meshgrid(*[np.arange(n)] * 3, indexing="ij"), axis=-1) + 0.5) / n
    inside = np.zeros((n, n, n), bool)
    for a, b, radius in zip(starts, ends, radii, strict=True):
        low = np.maximum(0, np.floor(n * (np.minimum(a, b) - radius)).astype(int))
        high = np.ceil(n * (np.maximum(a, b) + radius)).astype(int) + 1
        part = tuple(slice(i, j) for i, j in zip(low, high, strict=True))
        along, arm = b - a, points[part] - a
        share = np.clip(arm @ along / max(float(along @ along), 1e-12), 0, 1)
        inside[part] |= np.linalg.norm(arm - share[..., None] * along, axis=-1) < radius
    return inside


def _ellipsoid(half: NDArray[np.float64]) -> Inside:
    axes = [np.linspace(-1, 1, max(3, int(2 * h))) for h in half]
    return np.linalg.norm(np.stack(np.meshgrid(*axes, indexing="ij")), axis=0) <= 1


def _direction(rng: np.random.Generator) -> NDArray[np.float64]:
    way = rng.normal(size=3)
    return way / np.linalg.norm(way)
