"""The preconditioner z = M r: one multigrid cycle, symmetric and positive definite.

Every level smooths before and after it is corrected by the next. A thin part is too stiff on coarser levels, the more
the coarser, so the next level is visited twice, but for the first of them, which costs most.
"""

from __future__ import annotations

import numpy as np

from mjframes.finite_elements import kernels
from mjframes.finite_elements.levels import Levels
from mjframes.finite_elements.matrices import Floats
from mjframes.finite_elements.smoother import polynomial

DEGREE = (2, 3)  # of the smoothing polynomials, on the finest level and on the others: the least time in all
VISITS = (1, 2)  # from the finest level to the next, and from there on


class Workspace:
    """Memory to apply the preconditioner to k columns: r, x and d on every level, flat (N, 3, k)."""

    def __init__(self, levels: Levels) -> None:
        k = levels.columns
        sizes = [len(level.inverse) for level in levels.above] + [len(levels.last) // 3]
        self.lanes = (0,) * k
        self.r, self.x, self.d = ([np.zeros(size * 3 * k, levels.dtype) for size in sizes] for _ in range(3))
        self.scratch = [matrix.scratch(k) for matrix in (levels.finest, *(level.matrix for level in levels.above[1:]))]


def precondition(levels: Levels, work: Workspace) -> Floats:
    """Return M r, which lies in `work.x[0]`, of the r in `work.r[0]`, which is lost."""
    work.x[0][:] = 0
    _cycle(levels, work, 0)
    return work.x[0]


def _cycle(levels: Levels, work: Workspace, number: int) -> None:
    """Improve x on a level. r: the residual of x as it comes in, and in the end that of the new x but for A d."""
    r, x, d, lanes = work.r[number], work.x[number], work.d[number], work.lanes
    if number == len(levels.above):
        x += (levels.last @ r.reshape(-1, len(lanes))).ravel()
        return
    level, scratch, late = levels.above[number], work.scratch[number], min(number, 1)
    steps = polynomial(level.bound, DEGREE[late], levels.dtype)
    kernels.step(d, r, x, level.inverse, *steps[0], 0, len(level.inverse), lanes)
    for keep, gain in steps[1:]:
        level.matrix.smooth(d, r, x, level.inverse, keep, gain, scratch, lanes)
    level.matrix.subtract(d, r, scratch, lanes)
    _correct(levels, work, number + 1, VISITS[late])
    kernels.prolong(*level.parent, level.weight, work.x[number + 1], d, x, lanes)
    for keep, gain in steps:
        level.matrix.smooth(d, r, x, level.inverse, keep, gain, scratch, lanes)


def _correct(levels: Levels, work: Workspace, number: int, visits: int) -> None:
    """x on a level from the residual of the finer one."""
    finer = levels.above[number - 1]
    kernels.restrict(*finer.parent, finer.weight, work.r[number - 1], work.r[number], work.lanes)
    work.x[number][:] = 0
    _cycle(levels, work, number)
    if number < len(levels.above):  # the last is exact at once
        for _ in range(visits - 1):
            levels.above[number].matrix.subtract(work.d[number], work.r[number], work.scratch[number], work.lanes)
            _cycle(levels, work, number)
