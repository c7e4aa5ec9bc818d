"""How far a body with a factor of one material's modulus is from one that was built with that modulus.

Of displacements under the load cases of `whole_body/error.py`, the body's own weight along each axis and pushes on its
surface, at rest: û of the body as it was built with scaled stiffness (elasticity/shares.py), u of the other one, both
with their own control weights. The largest |û − u| / |u| over the cases is told, and in brackets what it would be if
nothing were scaled.

    python -m benchmarks.accuracy.factors models/steak.npz
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mjframes.body.build import build
from mjframes.body.soft_body import SoftBody
from mjframes.cli.arguments import Parser
from mjframes.cli.commands import exit_code
from mjframes.elasticity.shares import scaled
from mjframes.frames.supports import Fixed
from mjframes.kinematics.shape_functions import ShapeFunctions
from mjframes.volume.grid import voxel_grid
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume
from mjframes.whole_body.error import coordinates, load_cases
from mjframes.whole_body.pushes import free_surface
from mjframes.whole_body.weight_correction import assembled, compliance

Array = NDArray[np.float64]

FACTORS = (0.25, 0.5, 2.0, 4.0)
SPACING = 0.01  # [m]
FRAMES = 5


def sandwich() -> Volume:
    """Return a soft core between skins a hundred times as stiff."""
    labels = np.ones((40, 10, 9), int)
    labels[:, :, [0, -1]] = 2
    return Volume.from_labels(
        labels, SPACING, {1: Material(1e4, 0.3, 1000, "core"), 2: Material(1e6, 0.3, 1000, "skin")}
    )


def bar() -> Volume:
    """Return a bar of two materials, one behind the other, with a third below the second."""
    labels = np.ones((32, 8, 8), int)
    labels[16:] = 2
    labels[16:, :, :2] = 3
    materials = {
        1: Material(2e4, 0.45, 1000, "root"),
        2: Material(6e4, 0.4, 1000, "end"),
        3: Material(2e5, 0.3, 1000, "sole"),
    }
    return Volume.from_labels(labels, SPACING, materials)


def limb() -> Volume:
    """Return flesh around two bones with a tendon along it."""
    labels = np.ones((36, 12, 12), int)
    labels[:14, 5:7, 5:7] = labels[22:, 5:7, 5:7] = 3
    labels[4:32, 8:10, 4:8] = 2
    flesh, tendon = Material(1e4, 0.45, 1000, "flesh"), Material(2e5, 0.4, 1100, "tendon")
    return Volume.from_labels(labels, SPACING, {1: flesh, 2: tendon, 3: Material.rigid(1900, name="bone")})


def displacements(body: SoftBody, factors: Array | None = None) -> Array:
    """Return u (n, 3, c) [m] of the voxels under the load cases, with factors (M,) of the materials' moduli."""
    grid = voxel_grid(body.fields.volume)
    cores = body.fields.seeds[: body.held]
    cases = load_cases(grid, cores, free_surface(grid, cores))
    stiffness, k = body.stiffness, len(body.control.frame)
    if factors is not None:
        pairs = zip(stiffness.matrix, stiffness.shares, strict=True)
        stiffness = replace(stiffness, matrix=tuple(scaled(matrix, shares, factors) for matrix, shares in pairs))
    covariance = compliance(assembled(stiffness, k), body.control, body.types, body.held)
    plain = ShapeFunctions(body.fields.weights, body.control, None).at_voxels(grid)
    corrected = body.shapes.at_voxels(grid)
    x = coordinates(plain, corrected, covariance, cases)
    return (corrected @ x.reshape(k, -1)).reshape(len(grid.index), 3, -1)


def off(found: Array, wanted: Array) -> float:
    """Return the largest relative difference over the load cases."""
    return float((np.linalg.norm(found - wanted, axis=(0, 1)) / np.linalg.norm(wanted, axis=(0, 1))).max())


def compare(name: str, volume: Volume, frames: int) -> None:
    """Print a line a factor and material. The layer of voxels at the lower end of the first axis is held."""
    end = np.flatnonzero((volume.labels > 0).any(axis=(1, 2)))[0]
    held = np.zeros(volume.labels.shape, bool)
    held[end] = volume.labels[end] > 0
    body = build(volume, frames, supports=Fixed(held))
    as_built = displacements(body)
    for number, (label, material) in enumerate(body.deformable.items()):
        errors = []
        for factor in FACTORS:
            stiffer = replace(volume.materials[label], young=factor * volume.materials[label].young)
            other = build(replace(volume, materials={**volume.materials, label: stiffer}), frames, supports=Fixed(held))
            factors = np.ones(len(body.deformable))
            factors[number] = factor
            wanted = displacements(other)
            errors.append(f"{off(displacements(body, factors), wanted):6.1%} ({off(as_built, wanted):4.0%})")
        print(f"{name:9} {material or label:8}" + "  ".join(errors), flush=True)


def main(argv: Sequence[str] | None = None) -> int:
    """Print the table; return the exit code."""
    parser = Parser(
        prog="python -m benchmarks.accuracy.factors", description="Compare bodies whose stiffness is scaled."
    )
    parser.add_argument("volume", nargs="*", help="files of volumes besides the three built-in bodies")
    paths = parser.parse_args(argv).volume
    print(f"{'body':9} {'material':8}" + "  ".join(f"times {factor:<8g}" for factor in FACTORS))
    for name, volume in (("sandwich", sandwich()), ("bar", bar()), ("limb", limb())):
        compare(name, volume, FRAMES)
    for path in paths:
        compare(path, Volume.load(path), 3)
    return 0


if __name__ == "__main__":
    raise SystemExit(exit_code(main))
