"""A ripe peach as a labelled volume: skin, a red cheek of the same skin, flesh, a rigid stone.

Its surface is r(θ, φ) around the middle, θ from the stem: nearly a ball, with a dent at the stem, a tip at the other
end and a groove down one side. Run it to write peach.npz beside this file.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

Array = NDArray[np.float64]

SKIN, CHEEK, FLESH, STONE = 1, 2, 3, 4
SPACING = 1.5e-3  # [m]
RADIUS = 0.0305  # [m]
PEEL = 1.6e-3  # [m] a layer of voxels: the skin is ten times as thick as a real one, and ten times as soft
HALF_STONE = (0.0095, 0.0120, 0.0155)  # [m] across its flat sides, across its edge, along the stem
MATERIALS = {
    SKIN: Material(young=1e6, poisson=0.4, density=1000, name="skin", rgba=(0.96, 0.69, 0.33, 1.0)),
    CHEEK: Material(young=1e6, poisson=0.4, density=1000, name="cheek", rgba=(0.82, 0.27, 0.18, 1.0)),
    FLESH: Material(young=2.5e5, poisson=0.45, density=1000, name="flesh", rgba=(0.99, 0.83, 0.48, 1.0)),
    STONE: Material.rigid(density=1200, name="stone", rgba=(0.45, 0.28, 0.17, 1.0)),
}


def make_peach() -> Volume:
    """The volume: z points to the stem, the groove lies towards x, the red cheek towards −y; the middle is at 0."""
    half = round(1.1 * RADIUS / SPACING)
    axis = SPACING * (np.arange(2 * half, dtype=np.float64) - half + 0.5)
    at: Array = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)
    distance = np.linalg.norm(at, axis=-1)
    depth = _radius(at / distance[..., None]) - distance  # > 0 inside, exact enough this near to a ball
    labels = np.where(_blush(at / RADIUS) > 0, CHEEK, SKIN)
    labels[depth > PEEL] = FLESH
    labels[_stone(at) < 1] = STONE
    labels[depth <= 0] = 0
    return Volume.from_labels(labels, SPACING, MATERIALS, (-half * SPACING,) * 3)


def _radius(direction: Array) -> Array:
    """Distance (…) of the surface from the middle along unit vectors (…, 3) [m]."""
    x, y, z = np.moveaxis(direction, -1, 0)
    across = np.hypot(x, y)
    stem = -0.20 * np.exp(-((across / 0.28) ** 2)) * (z > 0)
    tip = 0.05 * np.exp(-((across / 0.22) ** 2)) * (z < 0)
    groove = -0.045 * np.exp(-((y / 0.10) ** 2)) * np.clip(x, 0, 1)
    return RADIUS * (1 + 0.02 * across**2 + stem + tip + groove)


def _blush(at: Array) -> Array:
    """Positive (…) where the sun has reddened the skin, with an uneven edge; at: (…, 3) in radii."""
    x, y, z = np.moveaxis(at, -1, 0)
    uneven = 0.13 * np.sin(5 * x + 2 * np.sin(4 * z)) + 0.09 * np.sin(9 * z - 7 * x + 1.0)
    return -y + 0.35 * z + uneven - 0.25


def _stone(at: Array) -> Array:
    """Below 1 (…) in the stone: an ellipsoid, pointed at both ends and furrowed."""
    x, y, z = np.moveaxis(at / HALF_STONE, -1, 0)
    furrows = 0.06 * np.sin(9 * z) * np.sin(7 * np.arctan2(y, x))
    return np.hypot(x, y) * (1 + 0.35 * z**2) + z**2 * 0.9 + furrows * np.hypot(x, y)


if __name__ == "__main__":
    path = Path(__file__).with_name("peach.npz")
    peach = make_peach()
    peach.save(path)
    counts = {m.name: int((peach.labels == label).sum()) for label, m in peach.materials.items()}
    print(f"{path}: {sum(counts.values())} voxels, {counts}")
