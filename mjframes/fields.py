"""What the precomputation knew of every voxel: kept to be looked at, and to place material points afterwards.

x(p̄) = Σ_j W_j(p̄) x_j needs the frames' weights at p̄ (the paper, equation (3)), and those are known at the voxels
only; `inspect` draws the same fields. Moduli and compliance distances follow from the volume and the seeds.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mjframes.grid import Grid
from mjframes.material import Material
from mjframes.volume import Volume


@dataclass(frozen=True, eq=False)
class Fields:
    """n voxels inside, in C order as in `Grid`; f frames, numbered as in the body; r regions.

    volume: labels, spacing, origin, axes and materials.  weights: (n, f), rows sum to 1; saving rounds them to float32.
    region: (n,) int32.  seeds: f arrays, the voxels of each frame's core, where its weight is 1.
    """

    volume: Volume
    weights: sparse.csr_array
    region: NDArray[np.int32]
    seeds: tuple[NDArray[np.int64], ...]

    def frame_centers(self, grid: Grid) -> NDArray[np.float64]:
        """(f, 3) centroids of the cores in volume coordinates [m]; `grid` is that of the volume."""
        return np.array([grid.centers[seeds].mean(axis=0) for seeds in self.seeds])

    def sample_centers(self, grid: Grid) -> NDArray[np.float64]:
        """(r, 3) centroids of the regions, the paper's integration points, in volume coordinates [m]."""
        size = np.bincount(self.region)
        return np.stack([np.bincount(self.region, grid.centers[:, a]) / size for a in range(3)], axis=1)


def pack_fields(fields: Fields) -> dict[str, np.ndarray]:
    """The arrays that `unpack_fields` needs, in the smallest types: about 10 bytes a voxel before compression."""
    volume, weights = fields.volume, fields.weights
    return {
        "labels": volume.labels,
        "spacing": volume.spacing,
        "origin": volume.origin,
        "axes": volume.axes,
        "weight": weights.data.astype(np.float32),
        "weight_frame": _smallest(weights.indices),
        "weight_count": _smallest(np.diff(weights.indptr)),
        "region": _smallest(fields.region),
        "seed": np.concatenate(fields.seeds).astype(np.int32),
        "seed_count": np.array([len(seeds) for seeds in fields.seeds]),
    }


def unpack_fields(arrays: Mapping[str, np.ndarray], materials: Mapping[int, Material]) -> Fields:
    """The fields in `arrays`, of which others are left alone."""
    row = np.concatenate([[0], np.cumsum(arrays["weight_count"], dtype=np.int64)])
    frames = len(arrays["seed_count"])
    weight = arrays["weight"].astype(np.float64)
    weight /= np.repeat(np.add.reduceat(weight, row[:-1]), arrays["weight_count"])  # float32 sums to one to 1e-7 only
    entries = (weight, arrays["weight_frame"].astype(np.int32), row)
    return Fields(
        volume=Volume(arrays["labels"], arrays["spacing"], arrays["origin"], arrays["axes"], dict(materials)),
        weights=sparse.csr_array(entries, shape=(len(row) - 1, frames)),
        region=arrays["region"].astype(np.int32),
        seeds=tuple(np.split(arrays["seed"].astype(np.int64), np.cumsum(arrays["seed_count"])[:-1])),
    )


def _smallest(numbers: np.ndarray) -> np.ndarray:
    """Integers ≥ 0 in the smallest type that holds them."""
    return numbers.astype(np.min_scalar_type(int(numbers.max())))
