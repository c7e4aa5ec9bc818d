"""Triangles of one material each: a surface cut along the lines where the indicators of two materials are equal."""

from __future__ import annotations

import numpy as np

SEAM_MARGIN = 0.1  # [-] of an edge: seams keep that distance from vertices, so that no cut triangle is a sliver


def cut_seams(
    vertices: np.ndarray, faces: np.ndarray, indicator: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cut the triangles whose corners have different materials; both sides of an edge cut it at one shared vertex.

    vertices: (s, 3) [m].  faces: (t, 3).  indicator: (s, m) of each material.  Return vertices, faces, and the material
    (t,) of each, counted from 0.
    """
    material = indicator.argmax(axis=1)
    corner = material[faces]
    whole = (corner == corner[:, :1]).all(axis=1)
    mixed = faces[~whole]
    if len(mixed) == 0:
        return vertices, faces, corner[:, 0]
    edges = np.sort(np.stack([mixed, np.roll(mixed, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    edges, inverse = np.unique(edges, axis=0, return_inverse=True)
    cut = np.where(material[edges[:, 0]] != material[edges[:, 1]])[0]
    a, b = edges[cut].T
    lead_a = indicator[a, material[a]] - indicator[a, material[b]]
    lead_b = indicator[b, material[b]] - indicator[b, material[a]]
    t = np.clip(lead_a / np.maximum(lead_a + lead_b, 1e-12), SEAM_MARGIN, 1 - SEAM_MARGIN)[:, None]
    number = np.full(len(edges), -1)
    number[cut] = len(vertices) + np.arange(len(cut))
    vertices = np.vstack([vertices, (1 - t) * vertices[a] + t * vertices[b]])
    middle = number[inverse].reshape(-1, 3)  # vertex on the edge from corner c to corner c + 1, or -1

    # two materials: turn the triangle so that corner 0 is the one on its own
    alone = np.argmax(middle < 0, axis=1)
    turn = (alone[:, None] + 2 + np.arange(3)) % 3
    three = (middle >= 0).all(axis=1)
    turn[three] = np.arange(3)
    p, q, r = np.take_along_axis(mixed, turn, axis=1).T
    pq, qr, rp = np.take_along_axis(middle, turn, axis=1).T
    two = ~three
    centre = np.full(len(mixed), -1)
    centre[three] = len(vertices) + np.arange(three.sum())
    vertices = np.vstack([vertices, vertices[mixed[three]].mean(axis=1)])
    pieces = [
        np.stack(triangle, axis=1)[of]
        for of, triangle in (
            (two, (p, pq, rp)),
            (two, (q, r, pq)),
            (two, (r, rp, pq)),
            (three, (p, pq, centre)),
            (three, (p, centre, rp)),
            (three, (q, qr, centre)),
            (three, (q, centre, pq)),
            (three, (r, rp, centre)),
            (three, (r, centre, qr)),
        )
    ]
    faces = np.vstack([faces[whole], *pieces])
    label = np.concatenate([corner[whole, 0], *(material[piece[:, 0]] for piece in pieces)])
    return vertices, faces, label
