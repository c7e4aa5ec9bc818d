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
from mjframes.whole_body.lifting import Lifting

EVEN, COMPLIANCE = "even", "compliance"  # geodesic distance within the body, and the paper's (5)


@dataclass(frozen=True, eq=False)
class Fields:
    """n voxels inside, in C order as in `Grid`; f frames, numbered as in the body; r regions.

    volume: labels, spacing, origin, axes and materials.  weights: (n, f), rows sum to 1; saving rounds them to float32.
    correction: (n, k) ΔW of the control weights, None for none; saving rounds it to float32.
    lifting: what the body moves beyond them, None where that is not known; saving rounds it to float16.
    error: (n,) rms over some load cases of the error of displacements, to their own; None where it is not known.
    region: (n,) int32.  seeds: f arrays, the voxels of each frame's core, where its weight is 1.
    metric: EVEN or COMPLIANCE, in which frames were placed and weights computed.
    """

    volume: Volume
    weights: sparse.csr_array
    correction: sparse.csr_array | None
    lifting: Lifting | None
    error: NDArray[np.float64] | None
    region: NDArray[np.int32]
    seeds: tuple[NDArray[np.int64], ...]
    metric: str

    def frame_centers(self, grid: Grid) -> NDArray[np.float64]:
        """(f, 3) centroids of the cores in volume coordinates [m]; `grid` is that of the volume."""
        return np.array([grid.centers[seeds].mean(axis=0) for seeds in self.seeds])

    def sample_centers(self, grid: Grid) -> NDArray[np.float64]:
        """(r, 3) centroids of the regions that have voxels, the paper's integration points, as the volume lies [m]."""
        size = np.bincount(self.region)
        sums = np.stack([np.bincount(self.region, grid.centers[:, a]) for a in range(3)], axis=1)
        return sums[size > 0] / size[size > 0, None]


def pack_fields(fields: Fields) -> dict[str, np.ndarray]:
    """The arrays that `unpack_fields` needs, in the smallest types: about 10 bytes a voxel, 60 more where weights are
    corrected, before compression.
    """
    volume, weights = fields.volume, fields.weights
    arrays = {
        "metric": np.array(fields.metric),
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
    if fields.correction is not None:
        arrays |= {
            "correction": fields.correction.data.astype(np.float32),
            "correction_point": _smallest(fields.correction.indices),
            "correction_count": _smallest(np.diff(fields.correction.indptr)),
        }
    if fields.lifting is not None:
        arrays |= {
            "lifting_mode": fields.lifting.mode.astype(np.float16),
            "lifting_count": np.array([len(share) for share in fields.lifting.share]),
            "lifting_share": np.concatenate([np.zeros(0), *(share.ravel() for share in fields.lifting.share)]),
        }
    if fields.error is not None:
        arrays["error"] = fields.error.astype(np.float16)
    return arrays


def unpack_fields(
    arrays: Mapping[str, np.ndarray], materials: Mapping[int, Material], points: int, sizes: np.ndarray
) -> Fields:
    """The fields in `arrays`, of which others are left alone.

    points: how many control points there are.  sizes: (r,) how many each region has.
    """
    row = _rows(arrays["weight_count"])
    frames = len(arrays["seed_count"])
    weight = arrays["weight"].astype(np.float64)
    weight /= np.repeat(np.add.reduceat(weight, row[:-1]), arrays["weight_count"])  # float32 sums to one to 1e-7 only
    entries = (weight, arrays["weight_frame"].astype(np.int32), row)
    correction = None
    if "correction" in arrays:
        entries_of = (arrays["correction"].astype(np.float64), arrays["correction_point"].astype(np.int32))
        rows = _rows(arrays["correction_count"])
        correction = sparse.csr_array((*entries_of, rows), shape=(len(rows) - 1, points))
    lifting = None
    if "lifting_mode" in arrays:
        count = arrays["lifting_count"]
        parts = np.split(arrays["lifting_share"], np.cumsum(3 * count * sizes)[:-1])
        share = tuple(part.reshape(q, 3 * m) for part, q, m in zip(parts, count.tolist(), sizes.tolist(), strict=True))
        lifting = Lifting(arrays["lifting_mode"].astype(np.float32), share)
    return Fields(
        volume=Volume(arrays["labels"], arrays["spacing"], arrays["origin"], arrays["axes"], dict(materials)),
        weights=sparse.csr_array(entries, shape=(len(row) - 1, frames)),
        correction=correction,
        lifting=lifting,
        error=arrays["error"].astype(np.float64) if "error" in arrays else None,
        region=arrays["region"].astype(np.int32),
        seeds=tuple(np.split(arrays["seed"].astype(np.int64), np.cumsum(arrays["seed_count"])[:-1])),
        metric=str(arrays["metric"]),
    )


def _rows(count: np.ndarray) -> np.ndarray:
    """Where each row of so many entries begins, and the end of the last."""
    return np.concatenate([[0], np.cumsum(count, dtype=np.int64)])


def _smallest(numbers: np.ndarray) -> np.ndarray:
    """Integers ≥ 0 in the smallest type that holds them."""
    return numbers.astype(np.min_scalar_type(int(numbers.max(initial=0))))
