"""Contact spheres grouped into patches (one geom each) and clusters (one contact each); the paper, §5.4.

A patch holds the spheres whose deepest frame in the tree is the same, because its geom's body must carry every degree
of freedom that moves it, and whose surface faces the same way (± one of the three axes), because a flat floor or a wall
then meets few patches. The few at a rim are no geom of their own: they join another patch of their frame. Each patch is
cut into at most CLUSTERS compact clusters.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.cluster.vq import kmeans2

from mjframes.base.sampling import farthest_points
from mjframes.kinematics.control import ControlPoints

CLUSTERS = 4  # a patch: what MuJoCo 4 allows between a plane and one geom
FEW = 2 * CLUSTERS  # [spheres] fewer join another patch: a geom costs time whether it touches or not …
SMALL = 0.5  # [-] of the frame's largest patch: … but not where all are alike, and such a face is what a foot stands on


@dataclass(frozen=True, eq=False)
class Patches:
    """The patches of s spheres, sorted by patch and cluster.

    order: (s,) the spheres in this order.
    patch, cluster: (s,) of each sphere in this order, from 0.
    """

    order: np.ndarray
    patch: np.ndarray
    cluster: np.ndarray


def group_patches(
    centers: np.ndarray, normals: np.ndarray, weights: sparse.csr_array, control: ControlPoints
) -> Patches:
    """Return the patches of spheres.

    centers: (s, 3) [m].  normals: (s, 3), outward.  weights: (s, k) of the control points; frames numbered depth first.
    """
    deepest = np.maximum.reduceat(control.frame[weights.indices], weights.indptr[:-1])
    axis = np.argmax(np.abs(normals), axis=1)
    facing = 2 * axis + (normals[np.arange(len(normals)), axis] > 0)
    kind = 6 * deepest + facing
    for frame in np.unique(deepest):
        kind[deepest == frame] = _joined(kind[deepest == frame])
    patch = np.unique(kind, return_inverse=True)[1]
    cluster = np.zeros(len(centers), int)
    for number in range(patch.max() + 1):
        members = np.flatnonzero(patch == number)
        cluster[members] = _clusters(centers[members])
    order = np.lexsort((cluster, patch))
    return Patches(order, patch[order], cluster[order])


def _joined(kind: np.ndarray) -> np.ndarray:
    """(s,) the kind of each sphere of a frame; the smallest joins the next one while it has few."""
    kind = kind.copy()
    few = min(FEW, SMALL * np.unique(kind, return_counts=True)[1].max())
    while True:
        kinds, counts = np.unique(kind, return_counts=True)
        order = np.argsort(counts, kind="stable")
        if len(kinds) == 1 or counts[order[0]] >= few:
            return kind
        kind[kind == kinds[order[0]]] = kinds[order[1]]


def _clusters(points: np.ndarray) -> np.ndarray:
    """(s,) cluster of each point: k-means from farthest points, numbered without gaps."""
    seeds = farthest_points(points, [0], CLUSTERS)
    label = kmeans2(points, points[seeds], minit="matrix", missing="warn", iter=20)[1]
    return np.unique(label, return_inverse=True)[1]
