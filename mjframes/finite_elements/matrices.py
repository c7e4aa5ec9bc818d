"""The stiffness A of a level's nodes, in the form that its kernels take. Vectors are flat, (N, 3, k); see `kernels`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mjframes.finite_elements import kernels
from mjframes.finite_elements.kernels import Floats, Lanes

Real = np.floating


class Bricks(NamedTuple):
    """The finest matrix, never assembled: arrays of `Mesh`, and the coefficients (m, 33) of each material's brick."""

    corner: NDArray[np.int32]
    material: NDArray[np.int32]
    coefficients: Floats
    brick_planes: NDArray[np.int64]
    node_planes: NDArray[np.int64]

    def scratch(self, k: int) -> Floats:
        """Return memory for the other two methods."""
        rows = kernels.SCRATCH + 2 * 3 * int(np.diff(self.node_planes).max())
        return np.zeros(rows * k, self.coefficients.dtype)

    def subtract(self, x: Floats, r: Floats, scratch: Floats, lanes: Lanes) -> None:
        """Compute r ← r − A x."""
        kernels.subtract_bricks(x, r, *self, scratch, lanes, None)

    def smooth(
        self, d: Floats, r: Floats, x: Floats, inverse: Floats, keep: Real, gain: Real, scratch: Floats, lanes: Lanes
    ) -> None:
        """Compute r ← r − A d,  d ← keep d + gain D⁻¹ r,  x ← x + d; inverse: (N, 3) of D."""
        kernels.subtract_bricks(d, r, *self, scratch, lanes, (x, inverse, keep, gain))


class BlockRows(NamedTuple):
    """A coarse matrix: 3 × 3 blocks in value (b, 9), those of row i from start[i] on. Methods as those of `Bricks`."""

    start: NDArray[np.int64]
    column: NDArray[np.int32]
    value: Floats

    def scratch(self, k: int) -> Floats:
        return np.zeros(0, self.value.dtype)

    def subtract(self, x: Floats, r: Floats, scratch: Floats, lanes: Lanes) -> None:
        kernels.subtract_blocks(x, r, *self, lanes)

    def smooth(
        self, d: Floats, r: Floats, x: Floats, inverse: Floats, keep: Real, gain: Real, scratch: Floats, lanes: Lanes
    ) -> None:
        kernels.subtract_blocks(d, r, *self, lanes)
        kernels.step(d, r, x, inverse, keep, gain, 0, len(inverse), lanes)


Matrix = Bricks | BlockRows
