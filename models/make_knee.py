"""A right knee bent by 75 degrees as a labelled volume: rigid bones, stiff tendons and ligaments, soft flesh.

Nothing in it is a joint: pulling the quadriceps has to extend the leg, as in the paper's Figure 10. Volume coordinates
are those of someone sitting: x forward, y to the left, z up, 0 the middle of the axis through the femoral condyles.
Drawn as balls strung together, later tissues over earlier ones. Run it to write knee.npz beside this file.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

Array = NDArray[np.float64]

FEMUR, TIBIA, PATELLA, CARTILAGE, TENDON, LIGAMENT, MUSCLE, FLESH = range(1, 9)
SPACING = 2.5e-3  # [m]
BONE_COLOR, FIBER_COLOR = (0.93, 0.89, 0.77, 1.0), (0.96, 0.94, 0.88, 1.0)
MATERIALS = {
    FEMUR: Material.rigid(density=1900, name="femur", rgba=BONE_COLOR),
    TIBIA: Material.rigid(density=1900, name="tibia and fibula", rgba=BONE_COLOR),
    PATELLA: Material.rigid(density=1900, name="patella", rgba=BONE_COLOR),
    CARTILAGE: Material(young=4e5, poisson=0.45, density=1100, name="cartilage", rgba=(0.75, 0.85, 0.9, 1.0)),
    TENDON: Material(young=3e8, poisson=0.4, density=1120, name="tendon", rgba=FIBER_COLOR),
    LIGAMENT: Material(young=2e7, poisson=0.4, density=1120, name="ligament", rgba=FIBER_COLOR),
    MUSCLE: Material(young=3e4, poisson=0.45, density=1060, name="muscle", rgba=(0.62, 0.12, 0.13, 1.0)),
    FLESH: Material(young=6e3, poisson=0.45, density=1000, name="flesh", rgba=(0.9, 0.68, 0.58, 1.0)),
}

# All lengths below in centimetres: x, y, z, radius of balls joined by cones.
Balls = list[tuple[float, float, float, float]]
SHAPES: list[tuple[int, Balls]] = [
    (FLESH, [(-11, 0, 3.6, 4.6), (-4, 0, 1.9, 4.8), (0, 0, 0, 5.0)]),
    (FLESH, [(0, 0, 0, 5.0), (0.2, 0, -4, 4.7), (-1.2, 0, -9, 4.6), (-1.4, 0, -13, 4.2)]),
    (FLESH, [(0, 0, 0, 5.0), (2.0, 0, 0.6, 4.2)]),
    (MUSCLE, [(-12, 0, 5.6, 1.8), (-6, 0, 4.9, 1.8), (-2.5, 0, 4.4, 1.0)]),  # quadriceps
    (MUSCLE, [(-12, 1.6, 1.2, 1.4), (-7, 1.9, 0.2, 1.3), (-3, 2.2, -1.8, 0.8)]),  # hamstrings
    (MUSCLE, [(-12, -1.6, 1.2, 1.4), (-7, -1.9, 0.2, 1.3), (-3, -2.2, -1.8, 0.8)]),
    (MUSCLE, [(-2.6, 1.4, -2, 0.8), (-3.4, 1.2, -8, 1.6), (-3.2, 1.0, -13, 1.3)]),  # gastrocnemius
    (MUSCLE, [(-2.6, -1.4, -2, 0.8), (-3.4, -1.2, -8, 1.6), (-3.2, -1.0, -13, 1.3)]),
    (CARTILAGE, [(0.4, 1.7, -2.4, 0.9), (-0.5, 1.7, -2.4, 0.9)]),
    (CARTILAGE, [(0.4, -1.7, -2.4, 0.9), (-0.5, -1.7, -2.4, 0.9)]),
    (CARTILAGE, [(3.0, 1.6, 1.2, 1.0), (3.0, -1.6, 1.2, 1.0)]),  # behind the patella
    (CARTILAGE, [(2.8, 0, 2.4, 1.0), (3.2, 0, -0.1, 0.9)]),
    (LIGAMENT, [(0, 3.5, 0, 0.35), (0.2, 2.9, -5.5, 0.35)]),  # medial collateral
    (LIGAMENT, [(0, -3.5, 0, 0.35), (-1.2, -2.9, -5.2, 0.35)]),  # lateral collateral
    (LIGAMENT, [(-0.6, 0.3, 0, 0.3), (1.2, 0.2, -3.1, 0.35)]),  # anterior cruciate
    (LIGAMENT, [(0.5, -0.3, 0, 0.3), (-1.5, -0.2, -3.2, 0.35)]),  # posterior cruciate
    (TENDON, [(4.6, 0, -0.5, 0.5), (2.6, 0, -5.6, 0.5)]),  # patellar ligament
    (TENDON, [(4.4, 0, 2.2, 0.5), (2.9, 0, 4.2, 0.5), (-0.5, 0, 4.6, 0.5), (-4.0, 0, 4.7, 0.4)]),  # of the quadriceps
    (FEMUR, [(0, 1.7, 0, 2.0), (0, -1.7, 0, 2.0)]),
    (FEMUR, [(0, 1.5, 0, 1.9), (1.0, 0.8, 0.8, 1.5)]),
    (FEMUR, [(0, -1.5, 0, 1.9), (1.0, -0.8, 0.8, 1.5)]),
    (FEMUR, [(0, 1.2, 0, 1.8), (-3.5, 0, 1.1, 1.6), (-13, 0, 3.6, 1.3)]),
    (FEMUR, [(0, -1.2, 0, 1.8), (-3.5, 0, 1.1, 1.6)]),
    (TIBIA, [(0, 1.5, -4.5, 1.8), (0, -1.5, -4.5, 1.8)]),
    (TIBIA, [(0, 1.2, -4.5, 1.8), (0.2, 0, -7, 1.5), (-0.2, 0, -14, 1.1)]),
    (TIBIA, [(0, -1.2, -4.5, 1.8), (0.2, 0, -7, 1.5)]),
    (TIBIA, [(1.2, 0, -5.2, 1.0), (2.2, 0, -5.7, 0.8), (0.8, 0, -8, 0.9)]),  # tuberosity
    (TIBIA, [(-1.0, -2.2, -5.0, 0.8), (-1.6, -2.4, -7, 0.5), (-1.6, -2.3, -14, 0.5)]),  # fibula
    (PATELLA, [(4.5, 1.0, 1.2, 0.7), (4.5, -1.0, 1.2, 0.7)]),
    (PATELLA, [(4.4, 0, 2.0, 0.7), (4.6, 0, -0.2, 0.6)]),
]  # fmt: skip


def make_knee() -> Volume:
    """The volume; what is cut off in x and z would be hip and foot."""
    h = 100 * SPACING
    low, high = np.array([-12.0, -5.4, -13.0]), np.array([6.6, 5.4, 9.0])
    shape = np.round((high - low) / h).astype(int)
    axes = [a + h * (np.arange(n) + 0.5) for a, n in zip(low, shape, strict=True)]
    at: Array = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    labels = np.zeros(shape, np.uint8)
    for label, balls in SHAPES:
        inside = _string(at, np.array(balls)) < 0
        labels[inside & ((label == FLESH) | (labels > 0))] = label
    return Volume.from_labels(labels, SPACING, MATERIALS, low / 100)


def _string(at: Array, balls: Array) -> Array:
    """Signed distance to balls (x, y, z, radius) joined by cones, negative inside: (…, 3) -> (…)."""
    distance = np.full(at.shape[:-1], np.inf)
    for a, b in pairwise(balls):
        along = b[:3] - a[:3]
        t = np.clip((at - a[:3]) @ along / (along @ along), 0, 1)
        to_axis = np.linalg.norm(at - a[:3] - t[..., None] * along, axis=-1)
        distance = np.minimum(distance, to_axis - a[3] - t * (b[3] - a[3]))
    return distance


if __name__ == "__main__":
    path = Path(__file__).with_name("knee.npz")
    knee = make_knee()
    knee.save(path)
    counts = {m.name: int((knee.labels == label).sum()) for label, m in knee.materials.items()}
    print(f"{path}: {sum(counts.values())} voxels, {counts}")
