"""Pictures of what taxels feel, for logs and pages: black, red, yellow, white, the more the brighter.

The brightest is the most that the map has had so far, so that pictures of different times compare from then on.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjframes.scene.taxels import TaxelMap

SIZE = 128  # [pixels] of the longer side of a picture, about


class TaxelPicture:
    """Pictures of one map: of pressures, or of the lengths of its vectors."""

    def __init__(self, taxels: TaxelMap) -> None:
        self.taxels, self._most = taxels, 0.0
        self._pixels = max(1, SIZE // max(taxels.shape))

    def draw(self, data: mujoco.MjData) -> NDArray[np.uint8]:
        """Return the present picture (height, width, 3); the first row is at its bottom."""
        values = self.taxels.of(data)
        felt = abs(values[..., 0]) if self.taxels.quantity == "traction" else np.linalg.norm(values, axis=-1)
        self._most = max(self._most, float(np.nan_to_num(felt).max()))
        share = np.nan_to_num(felt[::-1] / self._most) if self._most > 0 else np.zeros_like(felt)
        colors = np.clip(3 * share[..., None] - np.arange(3), 0, 1)
        return np.rint(255 * colors).astype(np.uint8).repeat(self._pixels, axis=0).repeat(self._pixels, axis=1)
