"""A soft fingertip for a gripper as a labelled volume: a soft skin over a firmer core on a rigid plate.

The plate lies in z < 0, its back at −PLATE; the pad bulges along +z, which is to point at what is grasped, and y runs
along the finger to its tip. Run it to write fingertip.npz beside this file.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

SKIN, CORE, PLATE = 1, 2, 3
SPACING = 1e-3  # [m]
HALF_WIDTH, HALF_LENGTH = 0.011, 0.017  # [m] of the plate, along x and y
BACK, BULGE = 0.003, 0.010  # [m] thickness of the plate, height of the pad above it
THICK = 0.003  # [m] of the skin at the top; the sides are as steep as the pad's
MATERIALS = {
    SKIN: Material(young=1e5, poisson=0.45, density=1070, name="skin", rgba=(0.93, 0.60, 0.48, 1.0)),
    CORE: Material(young=6e5, poisson=0.45, density=1080, name="core", rgba=(0.85, 0.80, 0.72, 1.0)),
    PLATE: Material.rigid(density=1240, name="plate", rgba=(0.22, 0.23, 0.26, 1.0)),
}


def make_fingertip() -> Volume:
    """The volume; x = y = 0 is the middle of the plate, z = 0 where the pad is glued to it."""
    sides = [
        np.arange(-round(half / SPACING), round(half / SPACING), dtype=np.float64) + 0.5
        for half in (HALF_WIDTH, HALF_LENGTH)
    ]
    height = np.arange(-round(BACK / SPACING), round(BULGE / SPACING), dtype=np.float64) + 0.5
    x, y, z = (SPACING * np.asarray(some, np.float64) for some in np.meshgrid(*sides, height, indexing="ij"))
    # a superellipse in the plane, so that the pad fills the plate, and rounded upwards
    plan = ((np.abs(x) / HALF_WIDTH) ** 3 + (np.abs(y) / HALF_LENGTH) ** 3) ** (1 / 3)
    outside = _dome(plan, z, BULGE)
    inside = _dome(plan * HALF_WIDTH / (HALF_WIDTH - THICK), z, BULGE - THICK)
    labels = np.where(z < 0, np.where(plan < 1, PLATE, 0), np.where(outside < 1, np.where(inside < 1, CORE, SKIN), 0))
    return Volume.from_labels(labels, SPACING, MATERIALS, (-HALF_WIDTH, -HALF_LENGTH, -BACK))


def _dome(plan: NDArray[np.float64], z: NDArray[np.float64], top: float) -> NDArray[np.float64]:
    """Below 1 inside a dome of height `top` over plan < 1."""
    return (plan**2.5 + (np.maximum(z, 0) / top) ** 2.5) ** (1 / 2.5)


if __name__ == "__main__":
    path = Path(__file__).with_name("fingertip.npz")
    fingertip = make_fingertip()
    fingertip.save(path)
    counts = {m.name: int((fingertip.labels == label).sum()) for label, m in fingertip.materials.items()}
    print(f"{path}: {sum(counts.values())} voxels, {counts}")
