"""Weights of the frames of a shallow body (frames/shallow.py): its held piece is not one frame among others.

With ŵ_i the weights that the free frames have in the body without its held piece,

    w_0 = 1 − s,    w_i = s ŵ_i

s is 0 on the held piece and 1 wherever the body is as deep as at the seed of the frame's own Voronoi cell.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mjframes.base.constants import NEGLIGIBLE_WEIGHT
from mjframes.frames.distance import compliance_distance, voxel_graph
from mjframes.frames.placement import Placement
from mjframes.volume.grid import Grid, without
from mjframes.weights.kernels import Weights


def shallow_weights(kind: Weights, grid: Grid, placement: Placement) -> sparse.csr_array:
    """Return the weights at the voxels (n, f), with sorted indices.  The first frame of `placement` is held."""
    core, free = placement.seeds[0], placement.seeds[1:]
    rest, number = without(grid, core)
    among = np.full(len(grid.index), -1, np.int64)
    among[number] = np.arange(len(number))
    own = kind.at_voxels(rest, Placement(placement.centers[1:], tuple(among[s] for s in free)))
    risen = _risen(kind, grid, core, free, rest, among)[number]
    weights = sparse.csr_array(sparse.diags_array(risen) @ own)
    weights.data[weights.data < NEGLIGIBLE_WEIGHT] = 0
    weights.eliminate_zeros()
    rows = sparse.coo_array(weights)
    held = np.ones(len(grid.index))
    held[number] -= np.asarray(weights.sum(axis=1))
    of_held = np.flatnonzero(held > NEGLIGIBLE_WEIGHT)
    whole = sparse.csr_array(
        (
            np.concatenate([held[of_held], rows.data]),
            (np.concatenate([of_held, number[rows.row]]), np.concatenate([np.zeros_like(of_held), rows.col + 1])),
        ),
        shape=(len(grid.index), len(placement.seeds)),
    )
    whole = sparse.csr_array(sparse.diags_array(1 / np.asarray(whole.sum(axis=1))) @ whole)
    whole.sort_indices()
    return whole


def _risen(
    kind: Weights,
    grid: Grid,
    core: NDArray[np.integer],
    free: tuple[NDArray[np.integer], ...],
    rest: Grid,
    among: NDArray[np.int64],
) -> NDArray[np.float64]:
    """s (n,)."""
    depth = compliance_distance(voxel_graph(grid), core, np.zeros(len(core), np.int64)).distance
    owner = np.repeat(np.arange(len(free)), [len(s) for s in free])
    cell = compliance_distance(voxel_graph(rest), among[np.concatenate(free)], owner).label
    enough = np.array([depth[s].min() for s in free])
    stays = np.flatnonzero(among >= 0)
    deep = stays[(cell >= 0) & (depth[stays] >= enough[cell])]
    middles = np.array([grid.points(some).mean(axis=0) for some in (core, deep)])
    return kind.at_voxels(grid, Placement(middles, (core, deep)))[:, [1]].toarray().ravel()
