"""Columns are solved for in batches, one thread each."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mjframes.base.threads import in_parallel, workers
from mjframes.finite_elements import kernels
from mjframes.finite_elements.cycle import Workspace
from mjframes.finite_elements.levels import Levels
from mjframes.finite_elements.matrices import Floats

MEMORY = 1.5e9  # [bytes] for the vectors of all batches at a time

Array = NDArray[np.float64]
Progress = Callable[[int, int], None]  # is called with the batches done and how many there are
R = TypeVar("R")


class LoadBatch(Workspace):
    """Memory to solve for k columns, flat (N, 3, k): the preconditioner's, a residual, a direction and a solution."""

    def __init__(self, levels: Levels) -> None:
        super().__init__(levels)
        self.residual, self.direction = np.zeros_like(self.r[0]), np.zeros_like(self.r[0])

    @cached_property
    def solution(self) -> Floats:
        """Return memory for the results of those who keep none of their own."""
        return np.zeros_like(self.r[0])


def in_rounds(
    levels: Levels, count: int, work: Callable[[LoadBatch, int], R], report: Callable[[], None]
) -> Iterator[list[tuple[LoadBatch, R]]]:
    """Do `work` on batches 0 to `count` − 1; yield the results, a list for those that ran at a time, with their memory.

    Which batches share a round does not change a result. report: is called after each batch.
    """
    room = max(1, int(MEMORY / levels.memory))
    batches = [LoadBatch(levels) for _ in range(min(workers(), room, count))]
    for start in range(0, count, max(len(batches), 1)):
        pairs = list(zip(batches, range(start, count), strict=False))
        results = []
        for result in in_parallel(lambda pair: work(*pair), pairs):
            results.append(result)
            report()
        yield [(batch, result) for (batch, _), result in zip(pairs, results, strict=True)]


def reporter(progress: Progress, of: int) -> Callable[[], None]:
    """Return a call that tells `progress` of one more batch done."""
    done = 0

    def report() -> None:
        nonlocal done
        done += 1
        progress(done, of)

    return report


def load(forces: sparse.csr_array, columns: Array, target: Floats) -> None:
    """Set target (N, 3, k) to sums of forces (N, m) by `columns` (3m, k), whose row 3b + d is force b along d."""
    weights = np.ascontiguousarray(columns.reshape(len(columns) // 3, -1), target.dtype)
    multiply(forces, weights, target)


def multiply(matrix: sparse.csr_array, source: Floats, target: Floats) -> None:
    """Set target to matrix source, for a sparse matrix (r, c), source (c, l) and target (r, l), of whatever shapes."""
    rows, columns = matrix.shape  # pyright: ignore[reportGeneralTypeIssues]  SciPy's own annotation allows None
    kernels.combine(matrix.indptr, matrix.indices, matrix.data, source.reshape(columns, -1), target.reshape(rows, -1))


def moments(forces: sparse.csr_array, x: Floats, k: int) -> Array:
    """Return (3m, k): what each force (N, m) along each axis does on displacements x (N, 3, k)."""
    _, count = forces.shape  # pyright: ignore[reportGeneralTypeIssues]  as above
    total = np.zeros((count, 3 * k))
    kernels.measure(forces.indptr, forces.indices, forces.data, x.reshape(-1, 3 * k), total)
    return total.reshape(-1, k)


def averages(blocks: NDArray[np.integer]) -> sparse.csr_array:
    """Return (r, n) the means over the voxels of each block (n,)."""
    size = np.bincount(blocks)
    return sparse.csr_array((1 / size[blocks], (blocks, np.arange(len(blocks)))))
