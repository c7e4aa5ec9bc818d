"""The places where a superelement knows how the body moves: voxels, or of a large body blocks of 2³ of them.

At 3 × 4 bytes for each of 3k fields, voxels of a large body would take more memory than all of the solver. Voxels of
one block have one material and the same frames, and are all held or all free. What is fitted to the mean over a block
holds for each of them; that costs a large body little, whose fields change over many voxels.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mjframes.volume.grid import Grid

FEW = 200_000  # [voxels] that are places each: ten frames keep 0.3 GB of displacements there


def blocks_of(grid: Grid, sets: NDArray[np.integer], held: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the place of each voxel (n,), numbered from 0 on.

    sets: (n,) number of each voxel's set of frames.  held: (n,) whether it is of a held piece.
    """
    if len(grid.index) <= FEW:
        return np.arange(len(grid.index))
    kind = np.ravel_multi_index((sets, grid.material, held), (int(sets.max()) + 1, len(grid.table), 2))
    half = np.ravel_multi_index(tuple(grid.index.T // 2), tuple(size // 2 + 1 for size in grid.lookup.shape))
    return np.unique(half * (int(kind.max()) + 1) + kind, return_inverse=True)[1].ravel()
