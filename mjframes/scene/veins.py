"""Veins drawn on a skin, as fat in meat: where a smooth pattern of space crosses zero.

The texture is one of MuJoCo's built-in gradients, so that scenes are saved without files: in its middle row the colour
goes from the veins' at u = ½ to the material's at 0 and 1. A vertex has u = ½ + ½ g(p̄), g the pattern at its place at
rest; between vertices it is linear, and veins are sharper than triangles are small.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjframes.volume.material import Material

Array = NDArray[np.float64]

TEXELS = (256, 3)  # a gradient is round its middle, which only an odd number of rows has
DIGITS = 3  # of texture coordinates in XML: finer than texels
GLOSS = {"specular": 0.3, "shininess": 0.4}  # [-] what has veins is moist
SHARPNESS = 5.0  # [-] of |pattern| = 1 at the edge of a vein of mean width
UNEVEN = 1.3  # [-] natural logarithm of the ratio of the widest veins to the mean ones
COARSE, ASIDE = 2.3, 0.013  # [-], [m] the pattern that tells how wide veins are is larger, and lies elsewhere
# of four waves that bend each other: directions (4, 3), phases, and how often a wave turns while it bends another
DIRECTIONS = np.array([(0.64, 0.43, 0.64), (-0.51, 0.78, 0.36), (0.29, -0.56, 0.78), (0.84, -0.39, -0.38)])
PHASES, BENDS = np.array([0.3, 1.7, 4.1, 2.6]), np.array([0.7, 1.3, 0.4, 2.1])
BEND, TURNS = 1.6, np.array([1.2, 1.1, 0.9, 1.0])


def add_veined_material(spec: mujoco.MjSpec, material: Material, name: str) -> None:
    """Add a texture and a MuJoCo material of that name, for skins with `vein_coordinates`."""
    assert material.veins is not None
    spec.add_texture(
        name=name,
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=material.veins[:3],
        rgb2=material.rgba[:3],
        width=TEXELS[0],
        height=TEXELS[1],
    )
    made = spec.add_material(name=name, rgba=(1, 1, 1, material.rgba[3]), **GLOSS)
    textures = list(made.textures)
    textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name
    made.textures = textures


def vein_coordinates(points: Array, spacing: float) -> Array:
    """Return texture coordinates (s, 2) of points (s, 3) at rest [m], where veins are about `spacing` [m] apart."""
    wide = _pattern(points[:, [1, 2, 0]] + ASIDE, COARSE * spacing)
    across = SHARPNESS * _pattern(points, spacing) * np.exp(-UNEVEN * wide)
    along = np.round(0.5 + 0.5 * np.clip(across, -1, 1), DIGITS)
    return np.stack([along, np.full(len(points), 0.5)], axis=1)


def _pattern(points: Array, spacing: float) -> Array:
    """Smooth irregularity (s,) between −2 and 2: a fixed sum of waves instead of random numbers."""
    phase = 2 * np.pi / spacing * (points @ DIRECTIONS.T)
    bend = np.sin(TURNS * phase + BENDS)
    return np.sin(phase + BEND * np.roll(bend, -1, axis=1) + PHASES).sum(axis=1) / 2
