"""The regions of the whole body's stiffness, one a frame: which points and voxels each has, and what turns it.

A voxel is of the region of that of its frames whose parents the others are (`families`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mjframes.base.constants import RIGID_RATIO
from mjframes.base.rigid import motion_basis
from mjframes.elasticity.rotations import with_rotations
from mjframes.elasticity.stiffness import Stiffness
from mjframes.kinematics.control import ControlPoints
from mjframes.volume.grid import Grid
from mjframes.whole_body.selection import Part

OWN = 0.999  # [-] weight that a frame has of a piece that is its own
STILL = 1e-12  # [-] stiffness, to the largest, that is rounding


def regions_of(
    grid: Grid,
    label: NDArray[np.integer],
    sets: Sequence[Sequence[int]],
    control: ControlPoints,
    parts: Sequence[Part],
    links: Sequence[str],
    bones: Sequence[int],
) -> tuple[Stiffness, NDArray[np.int32]]:
    """Return the regions' stiffness, and the region (n,) of each voxel.

    label: (n,) which of the `sets` of frames moves each voxel.  parts: (f,) what each frame adds.
    links: the bodies that hold the first frames; what only frames of one body would share needs no region, if others
    have its voxels, nor does a frame that nothing strains, as a rigid root.
    bones: frames that hold a rigid piece, each of which gets a region of its own besides, of no voxels, against strain.
    """
    firm = STILL * max(np.abs(part.matrix).max() for part in parts)
    kept = [part for part in parts if np.abs(part.matrix).max() > firm and not _on_one(links, part, control)]
    last = {part.frame: place for place, part in enumerate(parts)}
    children = [max(some, key=last.__getitem__) for some in sets]
    between = {i for i, some in zip(children, sets, strict=True) if not _regions_with(some, kept, control)}
    kept = [part for part in parts if part in kept or part.frame in between]  # between pieces of one body
    region = np.array([_region_of(i, some, kept, control) for i, some in zip(children, sets, strict=True)], np.int32)
    regions = kept + [_bone(parts[last[f]], control) for f in bones]
    stiffness = Stiffness(
        points=tuple(part.points for part in regions),
        gradient=(),
        matrix=tuple(part.matrix for part in regions),
        volume=np.bincount(region[label], minlength=len(regions)).astype(np.float64) * grid.cell_volume,
        shares=tuple(part.shares for part in regions),
    )
    return with_rotations(stiffness, control), region[label]


def _on_one(links: Sequence[str], part: Part, control: ControlPoints) -> bool:
    """Whether one body holds all frames of a region, the first of which are held."""
    frames = control.frame[part.points]
    return bool(frames.max() < len(links)) and len({links[i] for i in frames}) == 1


def bone_frames(grid: Grid, weights: sparse.csr_array, types: Sequence[str], held: int) -> list[int]:
    """Return the frames that have a rigid piece to themselves, but for the first `held` and those that cannot strain.

    The whole body lets such a frame move as a rigid one: its strain would be that of the little flesh that it has
    besides, many times larger than the frame's, and other frames would follow that wherever the bone turns. A body of
    one frame has nothing else to strain.
    """
    rigid = grid.piece >= 0
    if not rigid.any() or len(types) == 1:
        return []
    most = weights[rigid].max(axis=0).toarray().ravel()
    return [i for i in range(held, len(types)) if most[i] > OWN and types[i] not in ("point", "rigid")]


def _bone(part: Part, control: ControlPoints) -> Part:
    """What keeps the points of a region's own frame in shape."""
    own = control.frame[part.points] == part.frame
    points = part.points[own]
    rigid = motion_basis(control.rest[points])
    strain = np.eye(len(rigid)) - rigid @ rigid.T
    firmness = RIGID_RATIO * np.mean(np.diagonal(part.matrix)[np.repeat(own, 3)])
    shares = RIGID_RATIO * np.mean(np.diagonal(part.shares[:, :, -len(rigid) :], axis1=1, axis2=2), axis=1)
    return Part(part.frame, points, firmness * strain, shares[:, None, None] * strain)


def _region_of(child: int, frames: Sequence[int], kept: Sequence[Part], control: ControlPoints) -> int:
    """The place among `kept` of the child's own region, or of the first that has all of these frames."""
    own = [e for e, part in enumerate(kept) if part.frame == child]
    return (own or _regions_with(frames, kept, control))[0]


def _regions_with(frames: Sequence[int], kept: Sequence[Part], control: ControlPoints) -> list[int]:
    """The places among `kept` of the regions that have all of these frames."""
    return [e for e, part in enumerate(kept) if np.isin(frames, control.frame[part.points]).all()]
