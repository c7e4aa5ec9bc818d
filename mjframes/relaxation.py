"""Which regions relax, on which points and cells (`condensation` has the formulas).

A region is taken apart into face-connected pieces, since each could move by itself. Where material and weights vary
little, the monomials are enough, and the weights are replaced by their linear least-squares fit w_i ≈ a_i + b_i · p
there: it sums to one as well, and bent weights lock by themselves. But linear weights make quadratic fields of affine
frames, ten of them, so that motions of many frames would cancel and cost nothing: those keep their weights. Elsewhere
cells are added, as fine as fits into an amount of work that grows with the number of voxels.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import sparse
from threadpoolctl import threadpool_limits

from mjframes.condensation import Products, add_points, empty_products, plain_matrix, relaxed_matrix
from mjframes.control import ControlPoints, points_of
from mjframes.cubature import POINTS, cubature
from mjframes.gradients import product_rule
from mjframes.grid import Grid
from mjframes.threads import in_parallel
from mjframes.voxel_fem import CellGrid, cell_grid, elimination_cost
from mjframes.weights import column_of, weight_gradients, weights_at

Array = NDArray[np.float64]

BLOCK = 1024  # [voxels] of one matrix product: its gradients fit the cache
SHARE = 1 << 14  # [voxels] that one thread sums up at a time
THIN = 10  # [voxels] mean thickness from which one point a voxel is enough, bending then right to 1/THIN²
FLAT = 1e-9  # [-] relative second moment below which a piece has no extent in a direction
GAUSS = (-0.5 / 3**0.5, 0.5 / 3**0.5)  # [voxels] from the centre; other rules may exceed exact integrals of v
# Across a single voxel y (z³ − 3 z g²) has no slope along z at Gauss's two points ±g: it cancels torsion.
CHEBYSHEV = (-0.5 / 2**0.5, 0.0, 0.5 / 2**0.5)  # [voxels]
MINOR = 0.01  # [-] share of a region's voxels below which a piece does not relax: it matters too little
HOMOGENEOUS = 3.0  # [-] largest to smallest E up to which a region's weights may be replaced by their linear fit …
NEARLY_LINEAR = 0.1  # [-] … if their rms residual is below this
MOST_STRAIGHT = 4  # [frames] whose weights may be: more have twice as many control points as there are quadratic fields
WORK, WORK_A_VOXEL = 2e9, 1e4  # [flop] that all eliminations together may take: about 0.1 s, and 0.5 µs a voxel
COARSEST = 3  # [cells] along a region's longest axis; fewer add nothing to the monomials


@dataclass(frozen=True, eq=False)
class Piece:
    """A face-connected piece of a region.

    region: its number.  relaxes: unless it is what is left of a region, too small to matter.  voxels: (n,).
    center: (3,) and length: origin and unit of the monomials [m].  offsets: (q, 3) of the points from their voxel's
    centre [voxels].  fit: (4, f) constant and slope of linear weights about `center`, or None for the weights as they
    are.  cells: or None for monomials only.
    """

    region: int
    relaxes: bool
    voxels: NDArray[np.int32]
    center: Array
    length: float
    offsets: Array
    fit: Array | None
    cells: CellGrid | None


def relaxed_regions(
    grid: Grid,
    weights: sparse.csr_array,
    control: ControlPoints,
    voxels: list[NDArray[np.int32]],
    frames: list[NDArray[np.int64]],
) -> list[tuple[Array, Array]]:
    """Σ E ∇W_j dV (m, 3) and K_e (3m, 3m) of regions; voxels, frames: of each, the frames with all their weight."""
    label = np.full(len(grid.index), -1, np.int32)
    for e, some in enumerate(voxels):
        label[some] = e
    component = _components(grid.index, grid.padded, label)
    pieces = _pieces(grid, weights, voxels, frames, component)
    shares = [
        (k, some[start : start + SHARE])
        for k, piece in enumerate(pieces)
        for some in _rows_of_one_material(grid, piece.voxels)
        for start in range(0, len(some), SHARE)
    ]

    def add_up(share: tuple[int, NDArray[np.int64]]) -> Products:
        piece = pieces[share[0]]
        return _products(grid, weights, control, frames[piece.region], piece, share[1], component)

    def condense(k: int) -> Array:
        piece = pieces[k]
        if not piece.relaxes:
            return plain_matrix(summed[k])
        lam, mu = (grid.cell_volume * grid.per_material(name)[grid.material[piece.voxels]] for name in ("lam", "mu"))
        return relaxed_matrix(summed[k], piece.length, piece.cells, lam, mu)

    sizes = [3 * len(points_of(control, members)[0]) for members in frames]
    results = [(np.zeros((size // 3, 3)), np.zeros((size, size))) for size in sizes]
    summed: list[list[Products]] = [[] for _ in pieces]
    with threadpool_limits(1, "blas"):  # the pieces are spread over the processors already
        for (k, _), products in zip(shares, in_parallel(add_up, shares), strict=True):
            summed[k].append(products)
            mean = results[pieces[k].region][0]
            mean += products.material[0] * products.mean[: mean.size].reshape(mean.shape)
        # the most laborious first, so that no thread has to wait long for another
        largest = sorted(range(len(pieces)), key=lambda k: -len(pieces[k].voxels))
        for k, matrix in zip(largest, in_parallel(condense, largest), strict=True):
            results[pieces[k].region][1][:] += matrix
    return results


def _products(
    grid: Grid,
    weights: sparse.csr_array,
    control: ControlPoints,
    frames: NDArray[np.int64],
    piece: Piece,
    rows: NDArray[np.int64],
    component: NDArray[np.int32],
) -> Products:
    """Sums over some voxels, `rows` of the piece's, of one material."""
    m = len(points_of(control, frames)[0])
    material = grid.table[grid.material[piece.voxels[rows[0]]]]
    total = empty_products((material.young, *material.lame), len(frames), m, piece.cells)
    if piece.fit is not None and len(rows) * len(piece.offsets) > POINTS:
        nodes, shares = cubature(grid.index[piece.voxels[rows]], piece.offsets)
        points = grid.origin + (nodes + 0.5) * grid.spacing @ grid.axes.T
        _add(total, control, frames, piece, grid.cell_volume * shares, points, *_linear(piece, points), None)
        return total
    for start in range(0, len(rows), BLOCK):
        some = rows[start : start + BLOCK]
        voxels = piece.voxels[some]
        centers = grid.points(voxels)
        if piece.fit is None:
            middle = weights_at(weights, voxels, frames)
            slope = weight_gradients(grid, weights, voxels, frames, component)
        else:
            middle, slope = _linear(piece, centers)
        for offset in piece.offsets:
            step = grid.axes @ (offset * grid.spacing)
            cells = piece.cells
            in_cells = None if cells is None else (cells.voxel_cell[some], cells.place[some] + offset / cells.factor)
            volume = grid.cell_volume / len(piece.offsets)
            _add(total, control, frames, piece, volume, centers + step, middle + slope @ step, slope, in_cells)
    return total


def _linear(piece: Piece, points: Array) -> tuple[Array, Array]:
    """The linear weights (s, f) and their slopes (s, f, 3) [1/m] at points (s, 3) [m]."""
    assert piece.fit is not None
    slope = np.broadcast_to(piece.fit[1:].T, (len(points), *piece.fit[1:].T.shape))
    return piece.fit[0] + (points - piece.center) @ piece.fit[1:], slope.copy()


def _add(
    total: Products,
    control: ControlPoints,
    frames: NDArray[np.int64],
    piece: Piece,
    volume: float | Array,
    points: Array,
    value: Array,
    slope: Array,
    in_cells: tuple[NDArray[np.integer], Array] | None,
) -> None:
    """Add points (s, 3) [m] with weights `value` (s, f) and `slope` (s, f, 3)."""
    functions, gradients = product_rule(control, frames, value, slope, points)
    place = (points - piece.center) / piece.length
    add_points(total, volume, place, value, slope, functions, gradients, in_cells)


def _rows_of_one_material(grid: Grid, voxels: NDArray[np.int32]) -> list[NDArray[np.int64]]:
    material = grid.material[voxels]
    return [np.flatnonzero(material == m) for m in np.unique(material)]


def _pieces(
    grid: Grid,
    weights: sparse.csr_array,
    voxels: list[NDArray[np.int32]],
    frames: list[NDArray[np.int64]],
    component: NDArray[np.int32],
) -> list[Piece]:
    """The pieces of all regions; component: (n,) a number for each face-connected one."""
    split: list[tuple[int, NDArray[np.int32], bool]] = []
    for e, some in enumerate(voxels):
        ids = component[some]
        order = np.argsort(ids, kind="stable")
        sets = np.split(some[order], np.flatnonzero(np.diff(ids[order])) + 1)
        split += [(e, members, True) for members in sets if len(members) >= MINOR * len(some)]
        if minor := [members for members in sets if len(members) < MINOR * len(some)]:
            split.append((e, np.concatenate(minor), False))

    def fit(part: tuple[int, NDArray[np.int32], bool]) -> Array | None:
        return _linear_fit(grid, weights, part[1], frames[part[0]], component) if part[2] else None

    fits = list(in_parallel(fit, split))
    uneven = sum(len(part[1]) for part, even in zip(split, fits, strict=True) if part[2] and even is None)
    work = WORK / max(1, uneven) + WORK_A_VOXEL

    def piece(k: int) -> Piece:
        e, members, relaxes = split[k]
        return _piece(grid, e, relaxes, members, fits[k], component, work * len(members), 27 * len(frames[e]) + 114)

    return list(in_parallel(piece, range(len(split))))


def _linear_fit(
    grid: Grid,
    weights: sparse.csr_array,
    voxels: NDArray[np.int32],
    frames: NDArray[np.int64],
    component: NDArray[np.int32],
) -> Array | None:
    """Constant and slope (4, f) [1, 1/m] of the weights' least-squares fit about the mean centre.

    Across a layer of one voxel no fit can see a slope: there it is the mean of the voxels' own.
    None where material or weights vary so much that neither the fit nor monomials are enough, and for many frames.
    """
    if len(frames) > MOST_STRAIGHT:
        return None
    young = grid.per_material("young")[np.unique(grid.material[voxels])]
    if young.max() >= HOMOGENEOUS * young.min():
        return None
    n = len(voxels)
    mean, square, total, moment, norm = _fit_moments(
        grid.index, voxels, weights.indptr, weights.indices, weights.data, column_of(weights, frames), len(frames)
    )
    square = (square - np.outer(mean, mean) / n) * np.outer(grid.spacing, grid.spacing)
    moment = (moment - np.outer(mean, total) / n) * grid.spacing[:, None]
    slope = np.linalg.pinv(square, rcond=FLAT, hermitian=True) @ moment
    extent, axes = np.linalg.eigh(square)
    flat = axes[:, extent <= FLAT * extent[-1]]
    if flat.size:  # across a layer of one voxel nothing can be fitted
        own = weight_gradients(grid, weights, voxels, frames, component).mean(axis=0) @ grid.axes
        slope += flat @ flat.T @ own.T
    residual = norm - total @ total / n - np.sum(slope * moment)
    return np.vstack([total / n, grid.axes @ slope]) if residual < n * NEARLY_LINEAR**2 else None


def _piece(
    grid: Grid,
    region: int,
    relaxes: bool,
    voxels: NDArray[np.int32],
    fit: Array | None,
    component: NDArray[np.int32],
    work: float,
    columns: int,
) -> Piece:
    """One piece; work: [flop] that eliminating its cells' nodes may take, for so many right-hand sides."""
    index = grid.index[voxels]
    center = grid.origin + (index.mean(axis=0) + 0.5) * grid.spacing @ grid.axes.T
    length = 0.5 * float(np.linalg.norm((np.ptp(index, axis=0) + 1) * grid.spacing))
    young = grid.per_material("young")
    thickness = _thickness(grid.index, grid.padded, component, grid.material, young, voxels)
    thin = (thickness < THIN) & (np.argsort(np.argsort(thickness, kind="stable")) < 2)
    several = [CHEBYSHEV if layers < 2 else GAUSS for layers in thickness]
    along = [points if few else (0.0,) for few, points in zip(thin, several, strict=True)]
    cells = _cells(grid, index, work, columns) if relaxes and fit is None else None
    return Piece(region, relaxes, voxels, center, length, np.array(list(product(*along))), fit, cells)


def _cells(grid: Grid, index: NDArray[np.int32], work: float, columns: int) -> CellGrid | None:
    """The finest cells around the voxels at `index` that fit into the work, None if that is too little."""
    size = np.ptp(index, axis=0) + 1
    for factor in range(1, 1 + int(size.max()) // COARSEST):
        if elimination_cost(size, factor, columns) <= work:
            return cell_grid(index, grid.spacing, grid.axes, factor)
    return None


@njit(cache=True, nogil=True)
def _components(index, padded, label):
    """(n,) a number for each set of voxels of one label that hang together by faces."""
    root = np.arange(len(index), dtype=np.int32)
    for v in range(len(index)):
        if label[v] < 0:
            continue
        for axis in range(3):
            x, y, z = index[v, 0] + 1, index[v, 1] + 1, index[v, 2] + 1
            n = padded[x - (axis == 0), y - (axis == 1), z - (axis == 2)]
            if n >= 0 and label[n] == label[v]:
                a, b = v, n
                while root[a] != a:
                    root[a] = root[root[a]]
                    a = root[a]
                while root[b] != b:
                    root[b] = root[root[b]]
                    b = root[b]
                root[max(a, b)] = min(a, b)
    for v in range(len(index)):
        root[v] = root[root[v]]  # roots come first
    return root


@njit(cache=True, nogil=True)
def _thickness(index, padded, component, material, young, voxels):
    """(3,) mean number of voxels, weighted by E, in a row along each axis that E does not vary much in [voxels]."""
    total, ends = 0.0, np.zeros(3)
    for v in voxels:
        e = young[material[v]]
        total += e
        for axis in range(3):
            x, y, z = index[v, 0] + 1, index[v, 1] + 1, index[v, 2] + 1
            n = padded[x + (axis == 0), y + (axis == 1), z + (axis == 2)]
            if n < 0 or component[n] != component[v] or young[material[n]] * HOMOGENEOUS <= e:
                ends[axis] += e
    return total / ends


@njit(cache=True, nogil=True)
def _fit_moments(index, voxels, indptr, indices, data, column, frames):
    """Σ x (3,), Σ x xᵀ (3, 3), Σ w (f,), Σ x wᵀ (3, f), Σ w · w, x the index from that of the first voxel: integers."""
    first, second, total, product, norm = np.zeros(3), np.zeros((3, 3)), np.zeros(frames), np.zeros((3, frames)), 0.0
    x = np.empty(3)
    for v in voxels:
        for a in range(3):
            x[a] = index[v, a] - index[voxels[0], a]
            first[a] += x[a]
            for b in range(a + 1):
                second[a, b] += x[a] * x[b]
        for k in range(indptr[v], indptr[v + 1]):
            i, w = column[indices[k]], data[k]
            if i < 0:
                continue
            norm += w * w
            total[i] += w
            for a in range(3):
                product[a, i] += x[a] * w
    for a in range(3):
        for b in range(a):
            second[b, a] = second[a, b]
    return first, second, total, product, norm
