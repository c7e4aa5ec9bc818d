"""Contact vertices grouped into patches (one geom each) and clusters (one contact each); the paper, §5.4.

A patch holds the vertices whose deepest frame in the tree is the same, because its geom's body must carry every degree
of freedom that moves it, and whose surface faces the same way (± one of the three axes), because a flat floor or a wall
then meets few patches. The few at a rim are no geom of their own: they join another patch of their frame. Each patch is
cut into at most CLUSTERS clusters. Those of a flat patch are what is nearest to each of its corners, and begin with the
corner: there the plugin puts the contact where flat lies on flat. All others are compact and begin with their middle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.cluster.vq import kmeans2

from mjframes.base.sampling import farthest_points
from mjframes.kinematics.control import ControlPoints

CLUSTERS = 4  # a patch: what MuJoCo 4 allows between a plane and one geom
FEW = 2 * CLUSTERS  # [vertices] fewer join another patch: a geom costs time whether it touches or not …
FLAT = 0.999  # [-] cosine between the normals of a patch, at least, if it is flat
THIN = 1e-3  # [-] of a patch's length: what is nearer to its diagonal is on it
SMALL = 0.5  # [-] of the frame's largest patch: … but not where all are alike, and such a face is what a foot stands on


@dataclass(frozen=True, eq=False)
class Patches:
    """The patches of s vertices, sorted by patch and cluster.

    order: (s,) the vertices in this order.
    patch, cluster: (s,) of each vertex in this order, from 0.
    """

    order: np.ndarray
    patch: np.ndarray
    cluster: np.ndarray


def group_patches(
    centers: np.ndarray, normals: np.ndarray, weights: sparse.csr_array, control: ControlPoints
) -> Patches:
    """Return the patches of vertices.

    centers: (s, 3) [m].  normals: (s, 3), outward.  weights: (s, k) of the control points; frames numbered depth first.
    """
    deepest = np.maximum.reduceat(control.frame[weights.indices], weights.indptr[:-1])
    axis = np.argmax(np.abs(normals), axis=1)
    facing = 2 * axis + (normals[np.arange(len(normals)), axis] > 0)
    kind = 6 * deepest + facing
    for frame in np.unique(deepest):
        kind[deepest == frame] = _joined(kind[deepest == frame])
    patch = np.unique(kind, return_inverse=True)[1]
    cluster, far = np.zeros(len(centers), int), np.zeros(len(centers))
    for number in range(patch.max() + 1):
        members = np.flatnonzero(patch == number)
        cluster[members], far[members] = _clusters(centers[members], normals[members])
    order = np.lexsort((far, cluster, patch))
    return Patches(order, patch[order], cluster[order])


def _joined(kind: np.ndarray) -> np.ndarray:
    """(s,) the kind of each vertex of a frame; the smallest joins the next one while it has few."""
    kind = kind.copy()
    few = min(FEW, SMALL * np.unique(kind, return_counts=True)[1].max())
    while True:
        kinds, counts = np.unique(kind, return_counts=True)
        order = np.argsort(counts, kind="stable")
        if len(kinds) == 1 or counts[order[0]] >= few:
            return kind
        kind[kind == kinds[order[0]]] = kinds[order[1]]


def _clusters(points: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(s,) cluster of each point, numbered without gaps, and (s,) how far it is from where its cluster begins."""
    corners = _corners(points, normals[0]) if (normals @ normals[0] > FLAT).all() else []
    if len(corners) < CLUSTERS:
        seeds = points[farthest_points(points, [0], CLUSTERS)]
        label = kmeans2(points, seeds, minit="matrix", missing="warn", iter=20)[1]
        label = np.unique(label, return_inverse=True)[1]
        begin = np.array([points[label == number].mean(axis=0) for number in range(label.max() + 1)])
    else:
        begin = points[corners]
        label = np.linalg.norm(points[:, None] - begin, axis=2).argmin(axis=1)
    return label, np.linalg.norm(points - begin[label], axis=1)


def _corners(points: np.ndarray, normal: np.ndarray) -> list[int]:
    """Four of the points that span most of a flat side: two far apart, and the farthest on each side of their line;
    fewer if all are on one side of it.
    """
    first = int(np.linalg.norm(points - points.mean(axis=0), axis=1).argmax())
    away = np.linalg.norm(points - points[first], axis=1)
    second = int(away.argmax())
    beside = (points - points[first]) @ np.cross(normal, points[second] - points[first]) / max(away[second], 1e-300)
    aside = [int(side) for side in (beside.argmax(), beside.argmin()) if abs(beside[side]) > THIN * away[second]]
    return [first, second, *aside]
