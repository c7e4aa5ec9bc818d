"""The rest shape's signed distance on a coarse lattice: what a point in a deformed body has to know (the paper, §5.4).

At each node n the signed distance φ_n to the surface at rest, negative inside, and the control weights W_j(n); between
nodes both are trilinear. The deformed nodes x(n) = Σ_j W_j(n) x_j then give x at any material point, and inverting that
map gives the material point at any place: its φ, ∇φ are its depth and, by F⁻ᵀ, its way out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.spatial import KDTree

from mjframes.kinematics.shape_functions import ShapeFunctions
from mjframes.surface.closest import closest_weights
from mjframes.surface.contact_points import ContactPoints
from mjframes.surface.isosurface import Surface
from mjframes.volume.grid import Grid

NODES = 8000  # at most: 0.1 MB of distances and indices, and half a megabyte of weights …
THIN_NODES = 32000  # … but where they are so far apart that what is thin would fall between them
THIN = 0.5  # [-] of the thickness 2V/A
GROWTH = 1.15  # [-] of the spacing, until the nodes are few enough
BAND = 2.5  # [cells] outside the surface that nodes reach, so that all cells within half a one of it are complete
OPPOSITE = 1.5  # [cells] below a vertex: what is so much deeper than below the surface belongs to another side
COVERED = 0.9  # [-] share of a node's weight that the control points of its patch must have, if any patch's do


@dataclass(frozen=True, eq=False)
class DistanceField:
    """n nodes of a cubic lattice along the volume's axes, those inside and near the surface.

    spacing: [m].
    origin: (3,) of the first node, in volume coordinates [m].
    shape: (3,) nodes along each axis.
    node: (n,) their places in the whole lattice, ascending.
    distance: (n,) φ [m].
    patch: (n,) the patch whose contact vertex is nearest.
    weights: (n, k) W_j.
    vertices: (s, 3) the contact vertices, in cells from the first node.
    """

    spacing: float
    origin: np.ndarray
    shape: np.ndarray
    node: np.ndarray
    distance: np.ndarray
    patch: np.ndarray
    weights: sparse.csr_array
    vertices: np.ndarray


def rest_distance_field(
    grid: Grid,
    shapes: ShapeFunctions,
    surface: Surface,
    vertices: ContactPoints,
    patch: np.ndarray,
    vertex_weights: sparse.csr_array,
) -> DistanceField:
    """Return the field of a soft body, its lattice as fine as its voxels if its nodes are not too many.

    shapes: of the body.  vertices: s contact vertices.  patch: (s,) of each.  vertex_weights: (s, k).
    """
    spacing = float(np.min(grid.spacing))
    mesh = surface.mesh
    far_apart = THIN * 2 * mesh.volume / mesh.area

    def most(spacing: float) -> int:
        return THIN_NODES if spacing > far_apart else NODES

    # the volume grown by the band, roughly, has to hold no more nodes than that
    while mesh.volume + BAND * spacing * mesh.area > most(spacing) * spacing**3:
        spacing *= GROWTH
    while True:
        first, shape, index, nodes = _candidates(grid, surface, spacing)
        distance = signed_distance(surface, nodes, spacing)
        active = distance < BAND * spacing
        nodes, index, distance = nodes[active], index[active], distance[active]
        if len(index) <= most(spacing):
            break
        spacing *= GROWTH
    node_weights = shapes.at(grid, nodes)
    nearest = _nearest_vertices(nodes, distance, vertices, OPPOSITE * spacing)
    return DistanceField(
        spacing=spacing,
        origin=grid.axes @ first,
        shape=shape,
        node=index,
        distance=distance,
        patch=_nearest_patch(patch[nearest], node_weights, patch, vertex_weights, shapes.control.frame),
        weights=node_weights,
        vertices=(vertices.positions @ grid.axes - first) / spacing,
    )


def _candidates(grid: Grid, surface: Surface, spacing: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The first node (3,) along the volume's axes and the lattice's shape (3,); of the nodes that may be near or inside
    their places in it (n,) and in volume coordinates (n, 3).
    """
    corners = surface.vertices @ grid.axes
    low, high = corners.min(axis=0), corners.max(axis=0)
    # at corners of voxels if as fine as these: flat sides and their edges are then on nodes, up to where they end
    corner = grid.origin @ grid.axes
    first = corner + np.floor((low - corner) / spacing - BAND) * spacing
    shape = np.ceil((high - first) / spacing + BAND + 1).astype(np.int64)
    index = np.arange(np.prod(shape))
    nodes = (first + spacing * np.stack(np.unravel_index(index, shape), axis=1)) @ grid.axes.T
    longest = float(np.linalg.norm(grid.spacing)) + spacing
    cell = np.floor((nodes - grid.origin) @ grid.axes / grid.spacing).astype(np.int64)
    near = grid.padded[tuple(np.clip(cell + 1, 0, np.array(grid.padded.shape) - 1).T)] >= 0
    skin = KDTree(grid.points(grid.outermost))
    near[~near] = skin.query(nodes[~near], distance_upper_bound=BAND * spacing + longest)[0] < np.inf
    return first, shape, index[near], nodes[near]


def signed_distance(surface: Surface, points: np.ndarray, spacing: float) -> np.ndarray:
    """Return the distance (n,) of points (n, 3) to a closed surface, negative inside [m].

    Exact where the nearest triangle holds one of the surface samples, `spacing` / 2 apart, nearest to the point.
    """
    a, b, c = (surface.vertices[surface.faces[:, i]] for i in range(3))
    longest = np.linalg.norm([b - a, c - b, a - c], axis=2).max(axis=0)
    pieces = np.maximum(1, np.ceil(2 * longest / spacing).astype(int))
    samples, owner = [], []
    for count in np.unique(pieces):
        some = np.flatnonzero(pieces == count)
        u, v = np.array([(i, j) for i in range(count + 1) for j in range(count + 1 - i)]).T / count
        samples.append(
            (a[some, None] + u[:, None] * (b - a)[some, None] + v[:, None] * (c - a)[some, None]).reshape(-1, 3)
        )
        owner.append(np.repeat(some, len(u)))
    near = np.asarray(KDTree(np.concatenate(samples)).query(points, k=8)[1])
    candidates = np.concatenate(owner)[near]
    normals = surface.vertex_normals[surface.faces]
    best, sign = np.full(len(points), np.inf), np.ones(len(points))
    for triangle in candidates.T:
        weight = closest_weights(points, a[triangle], b[triangle], c[triangle])
        offset = points - np.einsum("nc,nci->ni", weight, surface.vertices[surface.faces[triangle]])
        distance = np.linalg.norm(offset, axis=1)
        normal = np.einsum("nc,nci->ni", weight, normals[triangle])
        better = distance < best
        best[better] = distance[better]
        sign[better] = np.where((offset * normal).sum(axis=1) < 0, -1, 1)[better]
    return sign * best


def _nearest_vertices(nodes: np.ndarray, distance: np.ndarray, vertices: ContactPoints, below: float) -> np.ndarray:
    """(n, 8) the vertices nearest to each node, those last that are of another side than what is near the node."""
    centers = vertices.positions
    near = KDTree(centers).query(nodes, k=min(8, len(centers)))[1].reshape(len(nodes), -1)
    height = np.einsum("nvi,nvi->nv", nodes[:, None] - centers[near], vertices.normals[near])
    is_opposite = height < -np.abs(distance)[:, None] - below
    return np.take_along_axis(near, np.argsort(is_opposite, axis=1, kind="stable"), axis=1)


def _nearest_patch(
    near: np.ndarray,
    weights: sparse.csr_array,
    patch: np.ndarray,
    vertex_weights: sparse.csr_array,
    frame: np.ndarray,
) -> np.ndarray:
    """(n,) of the patches near each node (n, m) the first whose points move the node.

    patch (s,) and vertex_weights (s, k) of the vertices; frame (k,) of the control points.
    """
    moved_by = np.zeros((patch.max() + 1, frame.max() + 1))
    entries = vertex_weights.tocoo()
    moved_by[patch[entries.row], frame[entries.col]] = 1
    share = np.zeros((len(near), frame.max() + 1))
    entries = weights.tocoo()
    np.add.at(share, (entries.row, frame[entries.col]), entries.data)
    covered = (share @ moved_by.T)[np.arange(len(near))[:, None], near]
    good = covered > COVERED
    choice = np.where(good.any(axis=1), good.argmax(axis=1), covered.argmax(axis=1))
    return near[np.arange(len(near)), choice]
