"""What the precomputation knew of every voxel: kept to be looked at, and to place material points afterwards.

x(p̄) = Σ_j W_j(p̄) x_j needs the frames' weights at p̄ (the paper, equation (3)), and those are known at the voxels
only; `inspect` draws the same fields. Moduli and compliance distances follow from the volume and the seeds.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mjframes.volume.grid import Grid
from mjframes.volume.volume import Volume
from mjframes.whole_body.modes import Lifting
from mjframes.whole_body.strains import Strains


@dataclass(frozen=True, eq=False)
class Fields:
    """n voxels inside, in C order as in `Grid`; f frames, numbered as in the body; r regions.

    volume: labels, spacing, origin, axes and materials.
    weights: (n, f), rows sum to 1; saving rounds them to float32.
    correction: (n, k) ΔW of the control weights, None for none; saving rounds it to float32.
    lifting: what the body moves beyond them, None where that is not known; saving rounds it to float16.
    strains: how it strains, None where that is not known; saving rounds it to float16.
    error: (n,) rms over some load cases of the error of displacements, to their own; None where it is not known.
    region: (n,) int32.
    seeds: f arrays, the voxels of each frame's core, where its weight is 1.
    metric: EVEN or COMPLIANCE, in which frames were placed and weights computed.
    """

    volume: Volume
    weights: sparse.csr_array = field(metadata={"kept": np.float32})
    correction: sparse.csr_array | None = field(metadata={"kept": np.float32})
    lifting: Lifting | None
    strains: Strains | None
    error: NDArray[np.float64] | None = field(metadata={"kept": np.float16})
    region: NDArray[np.int32]
    seeds: tuple[NDArray[np.int64], ...]
    metric: str

    def frame_centers(self, grid: Grid) -> NDArray[np.float64]:
        """Return centroids (f, 3) of the cores in volume coordinates [m]; `grid` is that of the volume."""
        return np.array([grid.centers[seeds].mean(axis=0) for seeds in self.seeds])

    def sample_centers(self, grid: Grid) -> NDArray[np.float64]:
        """Return centroids (r, 3) of the regions that have voxels, the paper's integration points [m].

        Coordinates are the volume's.
        """
        size = np.bincount(self.region)
        sums = np.stack([np.bincount(self.region, grid.centers[:, a]) for a in range(3)], axis=1)
        return sums[size > 0] / size[size > 0, None]

    def normalised(self) -> Fields:
        """Return the same with weights that sum to one to the last digit: those that were saved do to 1e-7."""
        weights, start = self.weights.copy(), self.weights.indptr
        weights.data /= np.repeat(np.add.reduceat(weights.data, start[:-1]), np.diff(start))
        return replace(self, weights=weights)
