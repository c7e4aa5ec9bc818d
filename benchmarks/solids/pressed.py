"""Bodies that an indenter presses from above, and the force that finite elements say.

The elements are bricks of order 2 on the voxels, linear, and the indenter touches their nodes without friction:

    A u = f,   u_z ≤ g − δ at the nodes below it,   f_z ≤ 0 there,   one of them equal

g is how far the indenter is above a node when it touches first, δ its depth. Nodes are tried until none pulls and none
is inside. A body whose surface is curved has stairs here, where the soft body's is smooth.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import LinearOperator

from benchmarks.solids import SOURCES
from benchmarks.solids.bodies import block, graded_plate, steak
from benchmarks.solids.bricks import Bricks, bricks, linear_stiffness
from benchmarks.solids.cases import STEAK, Array, Mask
from benchmarks.solids.reference import preconditioner, solve
from mjframes.app.press import Indenter
from mjframes.base.cache import cached
from mjframes.base.errors import MjframesError
from mjframes.volume.grid import Grid, voxel_grid
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

MESHES = Path(__file__).parents[3] / "shared" / "data" / "meshes"  # beside a checkout, as in tests/builders/data.py
DEPTH = 0.05  # [-] of the thickness below the indenter
PUNCHES = (4, 8)  # [voxels] how wide
BALL = 20  # [voxels] radius: it touches on four voxels or more
TOLERANCE = 1e-4  # [-] of linear systems
NEAR = 1e-6  # [-] of the depth, or of the largest force, that counts as none
MOST = 40  # times that the touching nodes are looked for
FLESH = Material(5e4, 0.45, 1000)  # of meshes
LENGTH, VOXELS = 0.15, 2000  # [m] of their longest side


@dataclass(frozen=True, eq=False)
class Pressed:
    """A body and where it is pressed, from above.

    fixed: (nx, ny, nz) voxels that do not move.
    at: (2,) [-] of the indenter's axis along x and y, from the body's low to its high end.
    """

    name: str
    volume: Volume
    fixed: Mask
    at: tuple[float, float] = (0.5, 0.5)

    @cached_property
    def grid(self) -> Grid:
        return voxel_grid(self.volume)

    @cached_property
    def held(self) -> Mask:
        """Return which voxels (n,) do not move."""
        return self.fixed[tuple(self.grid.index.T)]

    @cached_property
    def axis(self) -> Array:
        """Return where the indenter's axis is (2,) [m]: between voxels."""
        low, high = self.grid.index.min(axis=0)[:2], self.grid.index.max(axis=0)[:2] + 1
        return self.grid.origin[:2] + np.round(low + (high - low) * self.at) * self.grid.spacing[:2]

    @property
    def depth(self) -> float:
        """Return how deep it is pressed [m]: DEPTH of what is below, down to what is held or to its lower side."""
        column = np.floor((self.axis - self.grid.origin[:2]) / self.grid.spacing[:2] + 0.5).astype(int)
        soft = (self.volume.labels[tuple(column)] > 0) & ~self.fixed[tuple(column)]
        top = int(np.flatnonzero(soft)[-1])
        hard = np.flatnonzero(~soft[:top])
        return DEPTH * float(self.grid.spacing[2]) * (top - (int(hard[-1]) if len(hard) else -1))

    def indenters(self) -> list[Indenter]:
        """Return what is pressed into it."""
        size = float(self.volume.spacing[0])
        return [Indenter("punch", wide * size) for wide in PUNCHES] + [Indenter("ball", BALL * size)]


def pressed_bodies() -> Iterator[Pressed]:
    """Yield what is measured; the steak and meshes only where their files are."""
    soft, hard = Material(5e4, 0.45, 1000), Material(1e6, 0.3, 1000)
    for name, x in (("pad", 0.5), ("pad, near an edge", 0.75)):
        yield _glued(name, np.ones((24, 24, 6)), 0.1 / 24, {1: Material(1e5, 0.45, 1000)}, x)
    cube = block()
    yield Pressed("block, ν = 0.49", cube.volume, _required(cube.fixed))
    upper = np.broadcast_to(np.arange(12) >= 8, (20, 20, 12)) + 1
    yield _glued("soft layer on a hard one", upper, 0.005, {1: hard, 2: soft})
    upper = np.broadcast_to(np.arange(12) >= 9, (20, 20, 12)) + 1
    yield _glued("hard layer on a soft one", upper, 0.005, {1: soft, 2: hard})
    plate = graded_plate().volume
    yield _glued("graded plate", np.repeat(plate.labels, 2, axis=2), 0.01, dict(plate.materials))
    limb = np.ones((36, 10, 10), np.uint8)
    limb[:, 3:7, 3:7] = 2
    volume = Volume.from_labels(limb, 0.005, {1: Material(2e4, 0.45, 1000), 2: Material(1e8, 0.3, 1000)})
    yield Pressed("flesh on a held bone", volume, limb == 2, (0.3, 0.5))
    yield Pressed("limb with a bone, held at its end", volume, volume.side("-x"), (0.3, 0.5))
    if STEAK.is_file():
        meat = steak()
        yield Pressed("steak, held by its bone", meat.volume, _required(meat.fixed), (0.6, 0.4))
        yield _glued_volume("steak, glued below", meat.volume, (0.6, 0.4))
    for name in ("bunny_30k.obj", "rat_skin_closed_5k4.ply"):
        if (MESHES / name).is_file():
            yield _glued_volume(f"{name.partition('_')[0]}, glued below", _of_mesh(name))


def _of_mesh(name: str) -> Volume:
    import trimesh

    mesh = trimesh.load_mesh(MESHES / name)
    mesh.apply_scale(LENGTH / mesh.extents.max())
    volume = Volume.from_meshes([(mesh, FLESH)], voxels=VOXELS).largest_component()
    return replace(volume, outline=None)  # the finite elements end where the voxels do


def _glued(
    name: str, labels: NDArray[np.integer] | Array, size: float, materials: dict[int, Material], x: float = 0.5
) -> Pressed:
    return _glued_volume(name, Volume.from_labels(labels.astype(np.uint8), size, materials), (x, 0.5))


def _glued_volume(name: str, volume: Volume, at: tuple[float, float] = (0.5, 0.5)) -> Pressed:
    """Held at its lowest layer, or at the lowest quarter of one whose base is not flat."""
    layers = np.flatnonzero(volume.labels.any(axis=(0, 1)))
    fixed = np.zeros(volume.labels.shape, bool)
    fixed[:, :, layers[: 1 if volume.labels[:, :, layers[0]].all() else len(layers) // 4]] = True
    return Pressed(name, volume, fixed & (volume.labels > 0), at)


def _required(mask: Mask | None) -> Mask:
    assert mask is not None
    return mask


def exact_forces(some: Pressed) -> Array:
    """Return the forces (i,) of the indenters [N], computed once, then kept."""
    inputs = (SOURCES, some.volume, some.fixed, np.array(some.at), DEPTH, np.array(PUNCHES), BALL)
    return cached("touch", inputs, lambda: {"force": np.array(_forces(some))})["force"]


def _forces(some: Pressed) -> list[float]:
    mesh, low = (bricks(some.grid, some.held, order, split) for order, split in ((2, 1), (1, 2)))
    moving = mesh.moving
    matrix = linear_stiffness(mesh)[moving][:, moving]
    inverse = preconditioner(linear_stiffness(low)[moving][:, moving], mesh)
    surface = highest(mesh)
    place = mesh.nodes[surface, :2] + some.grid.origin[:2] + some.grid.index.min(axis=0)[:2] * some.grid.spacing[:2]
    number = np.cumsum(moving) - 1
    found = []
    for one in some.indenters():
        wider = replace(one, size=one.size * (1 + NEAR))  # nodes on its edges are below it
        gap = wider.profile(place - some.axis) - mesh.nodes[surface, 2]
        gap -= gap.min()
        below = (gap < some.depth) & mesh.free[surface]
        found.append(contact_force(matrix, inverse, number[3 * surface[below] + 2], gap[below] - some.depth))
    return found


def highest(mesh: Bricks) -> NDArray[np.int64]:
    """Return the highest node on each line along z."""
    line = np.round(mesh.nodes[:, :2] / (mesh.size[:2] / mesh.order)).astype(int)
    order = np.lexsort((-mesh.nodes[:, 2], line[:, 1], line[:, 0]))
    first = np.ones(len(order), bool)
    first[1:] = (np.diff(line[order], axis=0) != 0).any(axis=1)
    return order[first]


def contact_force(matrix: sparse.csr_array, inverse: LinearOperator, dof: NDArray[np.integer], push: Array) -> float:
    """Return the force [N] of what pushes some degrees of freedom (c,) down to `push` (c,) [m], negative, or lower.

    inverse: a preconditioner of the matrix.  Raise MjframesError if no nodes are found that touch.
    """
    touches, moved = np.ones(len(dof), bool), np.zeros(matrix.shape[0])  # pyright: ignore[reportOptionalSubscript]
    size = 0.0
    for _ in range(MOST):
        moves = np.ones(len(moved), bool)
        moves[dof[touches]] = False
        free = np.flatnonzero(moves)
        moved[dof[touches]] = push[touches]
        right = -(matrix @ moved)[free]
        size = size or float(np.linalg.norm(right))
        near = TOLERANCE * size / float(np.linalg.norm(right))  # most moved so the last time, too
        moved[free] += solve(matrix[free][:, free], _restricted(inverse, free), right, near)
        force = (matrix @ moved)[dof]
        inside = moved[dof] > push - NEAR * push.min()
        wrong = np.where(touches, force > NEAR * np.abs(force).max(), inside)
        if not wrong.any():
            return float(-force[touches].sum())
        touches ^= wrong
    raise MjframesError("the finite elements found no nodes that touch the indenter.")


def _restricted(inverse: LinearOperator, free: NDArray[np.integer]) -> LinearOperator:
    """A preconditioner of the free degrees of freedom."""

    def applied(values: Array) -> Array:
        whole = np.zeros(inverse.shape[0])
        whole[free] = values.ravel()
        return np.asarray(inverse.matvec(whole))[free]

    return LinearOperator((len(free),) * 2, applied)  # pyright: ignore[reportCallIssue]
