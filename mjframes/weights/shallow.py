"""Weights of the frames of a shallow body (frames/shallow.py): its held piece is not one frame among others.

With ŵ_i the weights that the free frames have in the body without its held piece,

    w_0 = 1 − s,    w_i = s ŵ_i

s is 0 on the held piece and 1 wherever the body is as deep as at the seed of the frame's own Voronoi cell.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from mjframes.base.constants import NEGLIGIBLE_WEIGHT
from mjframes.frames.placement import placement_of
from mjframes.frames.shallow import Shallow
from mjframes.volume.grid import Grid
from mjframes.weights.kernels import Weights


def shallow_weights(kind: Weights, grid: Grid, shallow: Shallow) -> sparse.csr_array:
    """Return the weights at the voxels (n, f), with sorted indices; the first frame is the held piece."""
    risen = kind.at_voxels(grid, placement_of(grid, [shallow.placement.seeds[0], shallow.deep]))[:, [1]]
    own = kind.at_voxels(shallow.rest, shallow.free)
    count = len(shallow.number)
    scaled = (risen.toarray().ravel()[shallow.number], (shallow.number, np.arange(count)))
    free = sparse.csr_array(sparse.csr_array(scaled, shape=(len(grid.index), count)) @ own)
    free.data[free.data < NEGLIGIBLE_WEIGHT] = 0
    held = 1 - np.asarray(free.sum(axis=1))
    held[held <= NEGLIGIBLE_WEIGHT] = 0
    weights = sparse.csr_array(sparse.hstack([held[:, None], free]))
    weights.eliminate_zeros()
    weights = sparse.csr_array(sparse.diags_array(1 / np.asarray(weights.sum(axis=1))) @ weights)
    weights.sort_indices()
    return weights
