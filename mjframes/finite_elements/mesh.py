"""Nodes and bricks of a body: one brick a voxel, its corners the nodes, and bridges where voxels hang by an edge.

A voxel of a held piece moves rigidly: it is no brick, and the nodes that it shares with others are held. Voxels that
touch at an edge or a corner only would turn about it freely. So wherever face-connected parts of a body touch in that
way alone, the cell beside the edge is filled with a brick of the softer neighbour's material; for a corner, which needs
two cells, only where no edge joins the parts. Bridges have stiffness but no mass, and no load acts on them.

Nodes are numbered along z first, then y, then x, and bricks likewise: a brick's corners are four runs of two nodes, and
the bricks between two planes of nodes, and the nodes of a plane, follow each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, sparse
from scipy.sparse.csgraph import connected_components

from mjframes.base.errors import MjframesError
from mjframes.finite_elements.element import CORNERS
from mjframes.volume.grid import Grid

Ints = NDArray[np.int32]

# towards the neighbours after a voxel that share only an edge or a corner with it
_SLANTED = [np.array(step) for step in product((-1, 0, 1), repeat=3) if step > (0, 0, 0) and np.count_nonzero(step) > 1]


@dataclass(frozen=True, eq=False)
class Mesh:
    """e bricks with N nodes.

    corner: (e, 4) the first nodes of each brick's runs along z, at (x, y) = (0, 0), (0, 1), (1, 0), (1, 1).
    material: (e,) its row of the grid's table.
    voxel: (e,) −1 for a bridge.
    place: (e, 3) [voxels] index of the cell.
    position: (N, 3) [voxels].
    held_by: (N,) the piece that holds each node, −1 for none.
    brick_planes: (p + 1,), node_planes: (p + 2,) where the bricks and the nodes of each plane along x begin.
    """

    corner: Ints
    material: Ints
    voxel: Ints
    place: Ints
    position: Ints
    held_by: Ints
    brick_planes: NDArray[np.int64]
    node_planes: NDArray[np.int64]

    @property
    def nodes(self) -> Ints:
        """Return the nodes (e, 8) of each brick, by corner 4x + 2y + z."""
        return np.stack([self.corner, self.corner + 1], axis=2).reshape(-1, 8)


def body_mesh(grid: Grid, held: Sequence[NDArray[np.integer]]) -> Mesh:
    """Return the mesh of a grid with held pieces, lists of voxel numbers. A node that two pieces share is the first's.

    Raise MjframesError for a body in several parts, for an empty piece, for pieces that overlap or leave nothing free.
    """
    piece = _pieces(len(grid.index), held)
    free = np.flatnonzero(piece < 0)
    bridges, bridge_material = _bridges(grid, piece)
    voxel = np.concatenate([free, np.full(len(bridges), -1)]).astype(np.int32)
    place = np.concatenate([grid.index[free], bridges])
    material = np.concatenate([grid.material[free], bridge_material]).astype(np.int32)
    if len(place) == 0:
        raise MjframesError("the held pieces leave no voxel free; hold fewer.")
    if len(bridges):
        order = np.lexsort(place.T[::-1])
        voxel, place, material = voxel[order], place[order], material[order]
    low = place.min(axis=0)
    number = np.full(place.max(axis=0) - low + 2, -1, np.int32)
    for corner in CORNERS:
        number[tuple((place - low + corner).T)] = 0
    position = np.argwhere(number == 0).astype(np.int32, order="C")
    number[tuple(position.T)] = np.arange(len(position))
    runs = [number[tuple((place - low + (x, y, 0)).T)] for x, y in product((0, 1), repeat=2)]
    held_by = _holders(position + low, grid.padded, piece)
    if (held_by >= 0).all():
        raise MjframesError("the held pieces leave no node of the voxels free; hold fewer.")
    planes = np.arange(position[-1, 0] + 2)
    return Mesh(
        corner=np.stack(runs, axis=1),
        material=material,
        voxel=voxel,
        place=place,
        position=position + low,
        held_by=held_by,
        brick_planes=np.searchsorted(place[:, 0] - low[0], planes[:-1]),
        node_planes=np.searchsorted(position[:, 0], planes),
    )


def _pieces(n: int, held: Sequence[NDArray[np.integer]]) -> Ints:
    """(n,) the held piece of each voxel, −1 for none."""
    piece = np.full(n, -1, np.int32)
    for h, voxels in enumerate(held):
        if len(voxels) == 0:
            raise MjframesError(f"held[{h}] is empty; it must have the numbers of one or more voxels.")
        if (piece[voxels] >= 0).any():
            raise MjframesError(f"held[{h}] overlaps an earlier piece; a voxel can be in one only.")
        piece[voxels] = h
    return piece


def _holders(position: Ints, padded: Ints, piece: Ints) -> Ints:
    """(N,) the first piece among those of the eight voxels around each node."""
    none = len(piece)
    piece_or_none = np.append(np.where(piece < 0, none, piece), none)  # a voxel −1, outside, is the last
    around = [piece_or_none[padded[tuple((position + corner).T)]] for corner in CORNERS]
    first = np.minimum.reduce(around)
    return np.where(first == none, -1, first).astype(np.int32)


def _bridges(grid: Grid, piece: Ints) -> tuple[Ints, Ints]:
    """Cells (b, 3) to fill and their materials (b,), so that faces connect all voxels."""
    labels, _ = ndimage.label(grid.lookup >= 0)  # pyright: ignore[reportGeneralTypeIssues]  an image and a number
    part = np.asarray(labels, np.int64)[tuple(grid.index.T)] - 1
    young = grid.per_material("young")
    cells: dict[tuple[int, ...], int] = {}
    for axes in (2, 3):
        if not part.any():
            break
        touching = [np.zeros((0, 2), np.int64)]
        for step in _SLANTED:
            if np.count_nonzero(step) != axes:
                continue
            other = grid.beside(step)
            first = np.flatnonzero((other >= 0) & (part != part[other]))
            second = other[first]
            touching.append(np.stack([part[first], part[second]], axis=1))
            apart = (piece[first] < 0) | (piece[first] != piece[second])  # what one piece holds needs no bridge
            along = np.flatnonzero(step)[:-1]  # the cells on the way from face to face
            way = np.cumsum(step * (np.arange(3) == along[:, None]), axis=0)
            for v, u in zip(first[apart], second[apart], strict=True):
                for cell in map(tuple, (grid.index[v] + way).tolist()):
                    materials = (int(grid.material[v]), int(grid.material[u]), cells.get(cell, int(grid.material[v])))
                    cells[cell] = min(materials, key=lambda m: young[m])
        part = _merged(part, np.concatenate(touching))
    if part.any():
        raise MjframesError("the voxels are in several parts that touch nowhere; keep one of them, or connect them.")
    return np.array(list(cells), np.int32).reshape(-1, 3), np.array(list(cells.values()), np.int32)


def _merged(part: NDArray[np.int64], touching: NDArray[np.int64]) -> NDArray[np.int64]:
    """The parts (n,) after pairs of them (t, 2) became one, numbered from 0 on."""
    count = int(part.max()) + 1
    pairs = sparse.coo_array((np.ones(len(touching), bool), tuple(touching.T)), shape=(count, count))
    return connected_components(pairs, directed=False)[1][part].astype(np.int64)
