"""Loops over nodes and bricks, for k columns at once.

A vector is a flat array of N × 3 × k numbers: the k values of a degree of freedom lie side by side and are worked on by
the same vector instructions. `lanes` is a tuple of k entries, so that k is known when a loop is compiled. Slices tell
the compiler that their indices are in range. Each sum has one order: results do not depend on the number of threads.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.floating]
Ints = NDArray[np.int32]
Lanes = tuple[int, ...]

OPTIONS = {"cache": True, "nogil": True, "fastmath": {"arcp", "contract", "nsz", "reassoc"}}

COEFFICIENTS = 33  # of a brick, see `element`
SCRATCH = 24 + COEFFICIENTS  # [rows of k] for the displacements or forces of a brick's corners and its coefficients


@njit(**OPTIONS)
def subtract_bricks(
    d: Floats,
    r: Floats,
    corner: Ints,
    material: Ints,
    coefficients: Floats,
    brick_planes: NDArray[np.int64],
    node_planes: NDArray[np.int64],
    scratch: Floats,
    lanes: Lanes,
    smoothing: tuple[Floats, Floats, np.floating, np.floating] | None,
) -> None:
    """Compute r ← r − A d, then as `step`, with (x, inverse, keep, gain) in `smoothing`, or nothing if that is None.

    Plane after plane, as what lies behind a plane is not needed any more.
    corner, material, brick_planes, node_planes: see `Mesh`.  coefficients: (m, 33) of each material's brick.
    scratch: SCRATCH rows of k, then the forces at two planes of nodes.
    """
    k = len(lanes)
    width = (len(scratch) - SCRATCH * k) // 2
    s, here, beyond = scratch[: SCRATCH * k], scratch[SCRATCH * k :][:width], scratch[SCRATCH * k :][width:]
    here[:] = 0
    planes = len(node_planes) - 1
    for p in range(planes):
        begin, end = node_planes[p], node_planes[p + 1]
        if p < planes - 1:
            beyond[: (node_planes[p + 2] - end) * 3 * k] = 0
            bricks = (brick_planes[p], brick_planes[p + 1])
            _add_bricks(d, corner, material, coefficients, bricks, (begin, end), s, here, beyond, lanes)
        forces, rs = here[: (end - begin) * 3 * k], r[begin * 3 * k : end * 3 * k]
        for j in range(len(rs)):
            rs[j] -= forces[j]
        if smoothing is not None:
            x, inverse, keep, gain = smoothing
            step(d, r, x, inverse, keep, gain, begin, end, lanes)
        here, beyond = beyond, here


@njit(**OPTIONS)
def _add_bricks(
    x: Floats,
    corner: Ints,
    material: Ints,
    coefficients: Floats,
    bricks: tuple[int, int],
    planes: tuple[int, int],
    s: Floats,
    here: Floats,
    beyond: Floats,
    lanes: Lanes,
) -> None:
    """Add A x of a layer of bricks, from the first to before the last, to the forces at the planes of nodes around it.

    planes: the first node of each.
    """
    k = len(lanes)
    loaded = -1
    for e in range(bricks[0], bricks[1]):
        m = material[e]
        if m != loaded:
            loaded = m
            for t in range(COEFFICIENTS):
                for j in range(k):
                    s[(24 + t) * k + j] = coefficients[m, t]
        for run in range(4):
            at = np.int64(corner[e, run]) * (3 * k)
            xs, us = x[at : at + 6 * k], s[run * 6 * k : (run + 1) * 6 * k]
            for j in range(len(xs)):
                us[j] = xs[j]
        for j in range(k):
            _, x1, x2, x3, x4, x5, x6, x7 = _modes(s, j, 3 * k)
            _, y1, y2, y3, y4, y5, y6, y7 = _modes(s, j + k, 3 * k)
            _, z1, z2, z3, z4, z5, z6, z7 = _modes(s, j + 2 * k, 3 * k)
            c = 24 * k + j  # the coefficients are those of `COUPLED`, in that order
            fx4 = s[c] * x4 + s[c + k] * y2 + s[c + 2 * k] * z1
            fy2 = s[c + k] * x4 + s[c + 3 * k] * y2 + s[c + 4 * k] * z1
            fz1 = s[c + 2 * k] * x4 + s[c + 4 * k] * y2 + s[c + 5 * k] * z1
            fy6 = s[c + 6 * k] * y6 + s[c + 7 * k] * z5
            fz5 = s[c + 7 * k] * y6 + s[c + 8 * k] * z5
            fx6 = s[c + 9 * k] * x6 + s[c + 10 * k] * z3
            fz3 = s[c + 10 * k] * x6 + s[c + 11 * k] * z3
            fx5 = s[c + 12 * k] * x5 + s[c + 13 * k] * y3
            fy3 = s[c + 13 * k] * x5 + s[c + 14 * k] * y3
            fx2 = s[c + 15 * k] * x2 + s[c + 16 * k] * y4
            fy4 = s[c + 16 * k] * x2 + s[c + 17 * k] * y4
            fz7 = s[c + 18 * k] * z7
            fx1 = s[c + 19 * k] * x1 + s[c + 20 * k] * z4
            fz4 = s[c + 20 * k] * x1 + s[c + 21 * k] * z4
            fy7 = s[c + 22 * k] * y7
            fy1 = s[c + 23 * k] * y1 + s[c + 24 * k] * z2
            fz2 = s[c + 24 * k] * y1 + s[c + 25 * k] * z2
            fx7 = s[c + 26 * k] * x7
            fx3 = s[c + 27 * k] * x3 + s[c + 28 * k] * y5 + s[c + 29 * k] * z6
            fy5 = s[c + 28 * k] * x3 + s[c + 30 * k] * y5 + s[c + 31 * k] * z6
            fz6 = s[c + 29 * k] * x3 + s[c + 31 * k] * y5 + s[c + 32 * k] * z6
            _corners(s, j, 3 * k, fx1, fx2, fx3, fx4, fx5, fx6, fx7)
            _corners(s, j + k, 3 * k, fy1, fy2, fy3, fy4, fy5, fy6, fy7)
            _corners(s, j + 2 * k, 3 * k, fz1, fz2, fz3, fz4, fz5, fz6, fz7)
        for run in range(4):
            at = (np.int64(corner[e, run]) - planes[run // 2]) * (3 * k)
            forces = here[at : at + 6 * k] if run < 2 else beyond[at : at + 6 * k]
            fs = s[run * 6 * k : (run + 1) * 6 * k]
            for j in range(len(forces)):
                forces[j] += fs[j]


@njit(**OPTIONS)
def _modes(s: Floats, at: int, stride: int) -> tuple[float, ...]:
    """Return the modes of one component from its values at the eight corners."""
    a, b, c, d = s[at], s[at + stride], s[at + 2 * stride], s[at + 3 * stride]
    e, f, g, h = s[at + 4 * stride], s[at + 5 * stride], s[at + 6 * stride], s[at + 7 * stride]
    a, b, c, d, e, f, g, h = a + b, a - b, c + d, c - d, e + f, e - f, g + h, g - h
    a, b, c, d, e, f, g, h = a + c, b + d, a - c, b - d, e + g, f + h, e - g, f - h
    return a + e, b + f, c + g, d + h, a - e, b - f, c - g, d - h


@njit(**OPTIONS)
def _corners(
    s: Floats, at: int, stride: int, b: float, c: float, d: float, e: float, f: float, g: float, h: float
) -> None:
    """One component of the forces at the eight corners from those of the modes 1 to 7: a translation has none."""
    a, b, c, d, e, f, g, h = b, -b, c + d, c - d, e + f, e - f, g + h, g - h
    a, b, c, d, e, f, g, h = a + c, b + d, a - c, b - d, e + g, f + h, e - g, f - h
    s[at], s[at + stride], s[at + 2 * stride], s[at + 3 * stride] = a + e, b + f, c + g, d + h
    s[at + 4 * stride], s[at + 5 * stride], s[at + 6 * stride], s[at + 7 * stride] = a - e, b - f, c - g, d - h


@njit(**OPTIONS)
def subtract_blocks(x: Floats, r: Floats, start: NDArray[np.int64], column: Ints, value: Floats, lanes: Lanes) -> None:
    """Compute r ← r − A x for 3 × 3 blocks: value (b, 9), those of row i from start[i] on."""
    k = len(lanes)
    for i in range(len(start) - 1):
        rs = r[i * 3 * k : (i + 1) * 3 * k]
        for t in range(start[i], start[i + 1]):
            at = np.int64(column[t]) * (3 * k)
            xs = x[at : at + 3 * k]
            v0, v1, v2 = value[t, 0], value[t, 1], value[t, 2]
            v3, v4, v5 = value[t, 3], value[t, 4], value[t, 5]
            v6, v7, v8 = value[t, 6], value[t, 7], value[t, 8]
            for j in range(len(xs) // 3):
                a, b, c = xs[j], xs[k + j], xs[2 * k + j]
                rs[j] -= v0 * a + v1 * b + v2 * c
                rs[k + j] -= v3 * a + v4 * b + v5 * c
                rs[2 * k + j] -= v6 * a + v7 * b + v8 * c


@njit(**OPTIONS)
def step(
    d: Floats,
    r: Floats,
    x: Floats,
    inverse: Floats,
    keep: np.floating,
    gain: np.floating,
    begin: int,
    end: int,
    lanes: Lanes,
) -> None:
    """Compute d ← keep d + gain D⁻¹ r,  x ← x + d at the nodes from `begin` to before `end`; inverse: (N, 3) of D."""
    k = len(lanes)
    for i in range(begin, end):
        g0, g1, g2 = gain * inverse[i, 0], gain * inverse[i, 1], gain * inverse[i, 2]
        ds, rs, xs = d[i * 3 * k : (i + 1) * 3 * k], r[i * 3 * k : (i + 1) * 3 * k], x[i * 3 * k : (i + 1) * 3 * k]
        for j in range(len(rs) // 3):
            a = keep * ds[j] + g0 * rs[j]
            b = keep * ds[k + j] + g1 * rs[k + j]
            c = keep * ds[2 * k + j] + g2 * rs[2 * k + j]
            ds[j], ds[k + j], ds[2 * k + j] = a, b, c
            xs[j] += a
            xs[k + j] += b
            xs[2 * k + j] += c


@njit(**OPTIONS)
def restrict(start: NDArray[np.int64], parent: Ints, weight: Floats, r: Floats, coarse: Floats, lanes: Lanes) -> None:
    """Compute coarse ← Pᵀ r. parent, weight: those of node i from start[i] on."""
    k = len(lanes)
    coarse[:] = 0
    for i in range(len(start) - 1):
        rs = r[i * 3 * k : (i + 1) * 3 * k]
        for t in range(start[i], start[i + 1]):
            at = np.int64(parent[t]) * (3 * k)
            w, cs = weight[t], coarse[at : at + 3 * k]
            for j in range(len(cs)):
                cs[j] += w * rs[j]


@njit(**OPTIONS)
def prolong(
    start: NDArray[np.int64], parent: Ints, weight: Floats, coarse: Floats, d: Floats, x: Floats, lanes: Lanes
) -> None:
    """Compute d ← P coarse,  x ← x + d."""
    k = len(lanes)
    for i in range(len(start) - 1):
        ds, xs = d[i * 3 * k : (i + 1) * 3 * k], x[i * 3 * k : (i + 1) * 3 * k]
        ds[:] = 0
        for t in range(start[i], start[i + 1]):
            at = np.int64(parent[t]) * (3 * k)
            w, cs = weight[t], coarse[at : at + 3 * k]
            for j in range(len(cs)):
                ds[j] += w * cs[j]
        for j in range(len(ds)):
            xs[j] += ds[j]


@njit(**OPTIONS)
def products(a: Floats, b: Floats, total: NDArray[np.float64], lanes: Lanes) -> None:
    """Compute total (k,) ← a · b of each column, summed in double precision."""
    k = len(lanes)
    total[:] = 0
    for i in range(len(a) // k):
        first, second = a[i * k : (i + 1) * k], b[i * k : (i + 1) * k]
        for j in range(len(first)):
            total[j] += np.float64(first[j]) * np.float64(second[j])


@njit(**OPTIONS)
def advance(alpha: Floats, p: Floats, q: Floats, x: Floats, r: Floats, copy: Floats, lanes: Lanes) -> None:
    """Compute x ← x + α p,  r ← r + α q,  copy ← r, with an α of each column (k,)."""
    k = len(lanes)
    for i in range(len(x) // k):
        ps, qs, xs = p[i * k : (i + 1) * k], q[i * k : (i + 1) * k], x[i * k : (i + 1) * k]
        rs, cs = r[i * k : (i + 1) * k], copy[i * k : (i + 1) * k]
        for j in range(len(ps)):
            xs[j] += alpha[j] * ps[j]
            rs[j] += alpha[j] * qs[j]
            cs[j] = rs[j]


@njit(**OPTIONS)
def turn(beta: Floats, z: Floats, p: Floats, lanes: Lanes) -> None:
    """Compute p ← z + β p, with a β of each column (k,)."""
    k = len(lanes)
    for i in range(len(p) // k):
        zs, ps = z[i * k : (i + 1) * k], p[i * k : (i + 1) * k]
        for j in range(len(ps)):
            ps[j] = zs[j] + beta[j] * ps[j]


@njit(**OPTIONS)
def combine(
    start: NDArray[np.integer], column: NDArray[np.integer], value: NDArray, source: Floats, target: Floats
) -> None:
    """Compute target (r, l) ← M source for a sparse M (r, c) and a dense source (c, l)."""
    for i in range(len(start) - 1):
        to = target[i]
        to[:] = 0
        for t in range(start[i], start[i + 1]):
            v, xs = value[t], source[column[t]]
            for j in range(len(to)):
                to[j] += v * xs[j]


@njit(**OPTIONS)
def measure(
    start: NDArray[np.integer], column: NDArray[np.integer], value: NDArray, source: Floats, target: Floats
) -> None:
    """Compute target (c, l) ← Mᵀ source for a sparse M (r, c) and a dense source (r, l)."""
    target[:] = 0
    for i in range(len(start) - 1):
        xs = source[i]
        for t in range(start[i], start[i + 1]):
            v, to = value[t], target[column[t]]
            for j in range(len(xs)):
                to[j] += v * xs[j]
