"""The regions of the whole body's stiffness, one a frame: which points and voxels each has, and what turns it.

A voxel is of the region of its deepest frame: the others that move it are that one's parents (`selection.families`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mjframes.control import ControlPoints
from mjframes.grid import Grid
from mjframes.regions import frame_sets
from mjframes.rotations import with_rotations
from mjframes.stiffness import Stiffness
from mjframes.whole_body.selection import Part

STILL = 1e-12  # [-] stiffness, to the largest, that is rounding


def regions_of(
    grid: Grid,
    weights: sparse.csr_array,
    control: ControlPoints,
    parts: Sequence[Part],
    links: Sequence[str],
) -> tuple[Stiffness, NDArray[np.int32]]:
    """Return the regions' stiffness, and the region (n,) of each voxel.

    weights: (n, f) at the voxels.  parts: (f,) what each frame adds.  links: the bodies that hold the first frames;
    what only frames of one body would share needs no region, nor does a frame that nothing strains, as a rigid root.
    """
    held = [{links[i] for i in control.frame[part.points]} if f < len(links) else set() for f, part in enumerate(parts)]
    firm = STILL * max(np.abs(part.matrix).max() for part in parts)
    kept = [
        f for f, part in enumerate(parts) if np.abs(part.matrix).max() > firm and (f >= len(links) or len(held[f]) > 1)
    ]
    label, sets = frame_sets(weights)
    region = np.array([_region_of(np.flatnonzero(row), parts, control, kept) for row in sets], np.int32)[label]
    stiffness = Stiffness(
        points=tuple(parts[f].points for f in kept),
        gradient=(),
        matrix=tuple(parts[f].matrix for f in kept),
        volume=np.bincount(region, minlength=len(kept)).astype(np.float64) * grid.cell_volume,
    )
    return with_rotations(stiffness, control), region


def _region_of(frames: NDArray[np.integer], parts: Sequence[Part], control: ControlPoints, kept: Sequence[int]) -> int:
    """The place among `kept` of the region that has all of these frames."""
    if frames.max() in kept:
        return kept.index(int(frames.max()))
    return next(e for e, f in enumerate(kept) if np.isin(frames, control.frame[parts[f].points]).all())
