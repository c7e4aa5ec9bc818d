"""What a body will cost to build, told before it is built: memory and time by its voxels and frames.

Measured on blocks and spheres of 54,000 to 2,500,000 voxels with 1 to 20 frames, on two cores of a virtual machine
(AMD EPYC): estimates are within a third of what was taken. The paper's method takes a twentieth, and is not asked.
"""

from __future__ import annotations

import warnings

import numpy as np
from numpy.typing import NDArray

from mjframes.base.errors import MjframesError, Notice
from mjframes.base.memory import available_memory

BYTES = (3900, 90)  # a voxel, and a voxel and frame
SECONDS = (25e-6, 6e-6)  # a voxel, and a voxel and frame
LONG = 60.0  # [s] a build that takes longer is announced


def announce(voxels: int, frames: int, spacing: NDArray[np.floating]) -> None:
    """Warn (Notice) of a build of more than LONG. spacing: (3,) of the voxels [m].

    Raise MjframesError for one that needs more memory than there is.
    """
    bytes_each, seconds_each = (base + frames * more for base, more in (BYTES, SECONDS))
    needed, available = voxels * bytes_each, available_memory()
    if needed > available:
        most = int(available / bytes_each)
        coarser = float(np.max(spacing)) * (voxels / max(most, 1)) ** (1 / 3)
        raise MjframesError(
            f"the volume has {voxels} voxels, for which a body of {frames} frames takes about {_size(needed)}, but "
            f"{_size(available)} of memory are free; take at most {_rounded(most)} voxels, as with --voxels or a "
            f"spacing of {coarser:.2g} m."
        )
    seconds = voxels * seconds_each
    if seconds > LONG:
        warnings.warn(
            f"the volume has {voxels} voxels: the build takes about {seconds / 60:.0f} min and {_size(needed)}; fewer "
            "voxels, as with --voxels, take less.",
            Notice,
            stacklevel=9,  # beyond what builds, what keeps that, build, telling_memory and taking
        )


def _size(memory: float) -> str:
    return f"{memory / 1e9:.1f} GB"


def _rounded(count: int) -> int:
    """Two digits of a number, rounded down."""
    step = 10 ** max(len(str(count)) - 2, 0)
    return count // step * step
