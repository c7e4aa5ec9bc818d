"""Algorithm 1 of the paper, initialization: from a volume of materials to a soft body, a stage after the other.

volume → grid → frames (placement, weights, elimination tree, control points) → stiffness → masses → surfaces

The stiffness is that of the whole body (`whole_body`), or the paper's: sums over regions, its integration samples.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from threadpoolctl import threadpool_limits

from mjframes.base.cache import cached
from mjframes.base.choices import EVEN
from mjframes.base.errors import Notice, telling_memory
from mjframes.base.options import taking
from mjframes.base.packing import packed, restored
from mjframes.body.adaptive import MOST, default_counts, fewest_frames, sufficiency, sufficient_frames
from mjframes.body.cost import announce
from mjframes.body.fields import Fields
from mjframes.body.frames import Frames, most_frames, place
from mjframes.body.options import BuildOptions, Progress
from mjframes.body.soft_body import ContactVertices, Skin, SoftBody
from mjframes.elasticity.laws import LawParameters
from mjframes.elasticity.mass import mass_difference
from mjframes.elasticity.null_modes import hold_null_modes
from mjframes.elasticity.quadrature import Quadrature, parameters, quadrature
from mjframes.elasticity.stiffness import Stiffness, region_stiffness
from mjframes.frames.supports import held_cores, supports_of
from mjframes.kinematics.shape_functions import ShapeFunctions
from mjframes.surface.contact_points import contact_points
from mjframes.surface.dents import dents
from mjframes.surface.distance_field import DistanceField, rest_distance_field
from mjframes.surface.isosurface import extract_surface, kept_surface
from mjframes.surface.patches import group_patches
from mjframes.volume.grid import Grid, evened, voxel_grid, with_materials
from mjframes.volume.volume import Volume, require_connected
from mjframes.whole_body.build import Condensed, finite_elements, whole_body
from mjframes.whole_body.cells import Cells
from mjframes.whole_body.contrast import nearly_rigid_as_rigid


class TurnWarning(UserWarning):
    """A body that nothing holds has frames that cannot turn."""


@taking(BuildOptions)
@telling_memory
def build(options: BuildOptions) -> SoftBody:
    """Build a soft body from a volume.

    Raises
    ------
    MjframesError
        For a volume in several pieces, for values out of range, and if the memory does not suffice.

    Warns
    -----
    TurnWarning
        If a body that nothing holds has frames that cannot turn.
    Notice
        If the build takes more than a minute, and how many frames were taken if nothing says how many.
    """
    if options.paper is None:
        assert isinstance(options.volume, Volume)
        options = replace(options, volume=nearly_rigid_as_rigid(options.volume))
    silent, progress = replace(options, progress=None), options.progress or (lambda stage: None)
    with threadpool_limits(1, "blas"):  # stages that pay spread themselves over the processors
        arrays = cached("body", (silent,), lambda: packed(_built(silent, progress), exact=True))
    body = restored(SoftBody, arrays, exact=True)
    if options.is_open:
        assert body.error is not None
        warnings.warn(sufficiency(len(body.types) - body.held, body.error), Notice, stacklevel=4)
    if "point" in body.types and not body.held:
        warnings.warn(
            "frame_type has 'point' frames, which cannot turn, and nothing of the body is held: where it tumbles its "
            "energy may jump and it may stay crumpled; use 'affine' or 'rigid' frames, or hold a piece.",
            TurnWarning,
            stacklevel=4,  # beyond telling_memory and taking
        )
    return body


def _built(options: BuildOptions, progress: Progress) -> SoftBody:
    volume = _announced(options)
    progress("listing the voxels")
    grid = voxel_grid(volume)
    metric_grid = evened(grid) if options.metric_of_frames == EVEN else grid
    cores, links = held_cores(grid, supports_of(options.supports))
    laws = parameters(options.law, grid)

    def placed(count: int | None) -> Frames:
        progress("placing the frames")
        return place(grid, metric_grid, cores, options, count)

    if options.paper is None:
        chosen, elastic = _whole_body(grid, cores, links, laws, options, placed, progress)
    else:
        chosen = placed(options.number)
        elastic = _sums(grid, chosen, laws, progress)
    if not cores:
        elastic = _held(elastic, chosen.types)

    difference: tuple[NDArray[np.float64], ...] = ()
    if _is_consistent(options.mass, chosen.types[len(links) :]):
        difference = mass_difference(grid, metric_grid, elastic.shapes, elastic.region, elastic.stiffness)

    progress("attaching the surfaces")
    skin, contact, field = _surfaces(volume, grid, elastic, len(chosen.types), options)
    return SoftBody(
        parent=chosen.tree.parent,
        types=chosen.types,
        links=links,
        control=elastic.shapes.control,
        stiffness=elastic.stiffness,
        law=options.law,
        law_constants=np.array([some.constants for some in laws]).reshape(-1, 3),
        cells=elastic.cells,
        quadrature=elastic.quadrature,
        mass_difference=difference,
        mode=options.mode,
        skin=skin,
        contact=contact,
        distance_field=field,
        damping=options.damping,
        error=elastic.condensed.error if elastic.condensed else None,
        fields=_fields(volume, chosen, elastic, options.metric_of_frames),
    )


def _announced(options: BuildOptions) -> Volume:
    """The volume, in one piece. Warn where it takes long, and raise MjframesError where it takes too much memory."""
    volume = options.volume
    assert isinstance(volume, Volume)
    require_connected(volume)
    if options.paper is None:
        count = (options.number or MOST) + len(supports_of(options.supports))
        announce(int(np.count_nonzero(volume.labels)), count, volume.spacing)
    return volume


@dataclass(frozen=True, eq=False)
class _Elastic:
    """The elasticity of the frames.

    shapes: their weights, corrected where the whole body is condensed.
    stiffness: of the regions at rest.
    region: (n,) of each voxel.
    cells, quadrature: where a law for large strains is evaluated, by the whole body and by the paper's method.
    condensed: the whole body, None by the paper's.
    """

    shapes: ShapeFunctions
    stiffness: Stiffness
    region: NDArray[np.int32]
    cells: Cells | None = None
    quadrature: Quadrature | None = None
    condensed: Condensed | None = None


def _whole_body(
    grid: Grid,
    cores: Sequence[NDArray[np.integer]],
    links: Sequence[str],
    laws: Sequence[LawParameters],
    options: BuildOptions,
    placed: Callable[[int | None], Frames],
    progress: Progress,
) -> tuple[Frames, _Elastic]:
    """The frames of a number, or the fewest that keep an error, and what finite elements show them."""
    most = most_frames(options.frame_type, len(grid.index)) - len(cores)
    hookes = with_materials(grid, [some.hooke for some in laws]) if laws else grid
    finite = finite_elements(hookes, cores, progress)

    def condense(some: Frames) -> Condensed:
        assert some.parents is not None
        return whole_body(hookes, finite, some.shapes, some.parents, some.types, links, laws, progress)

    if options.error is not None:
        chosen, made = fewest_frames(options.error, grid, finite, most, placed, condense)
    elif options.is_open:
        chosen, made = sufficient_frames(grid, finite, default_counts(most), placed, condense)
    else:
        chosen = placed(options.number)
        made = condense(chosen)
    return chosen, _Elastic(made.shapes, made.stiffness, made.region, made.cells, None, made)


def _sums(grid: Grid, frames: Frames, laws: Sequence[LawParameters], progress: Progress) -> _Elastic:
    """The paper's: sums over the voxels of each region, or over quadrature points for a law for large strains."""
    assert frames.regions is not None
    progress("summing the stiffness")
    stiffness = region_stiffness(grid, frames.shapes, frames.regions, frames.tree)
    points = None
    if laws:
        progress("placing the quadrature points")
        points = quadrature(grid, frames.shapes, frames.regions, frames.tree)
    return _Elastic(frames.shapes, stiffness, frames.regions.label, None, points)


def _held(elastic: _Elastic, types: Sequence[str]) -> _Elastic:
    """Hold null modes; each moves all frames of its chain, so that a body with a held piece has none."""
    rigid = [i for i, name in enumerate(types) if name == "rigid"]
    stiffness = hold_null_modes(elastic.stiffness, elastic.shapes.control, rigid)
    cells = elastic.cells and elastic.cells.stiffened(elastic.stiffness, stiffness)
    return replace(elastic, stiffness=stiffness, cells=cells)


def _is_consistent(mass: str | None, types: Sequence[str]) -> bool:
    """Whether free frames of these types have the consistent mass, unless told.

    Bodies that turn gain energy from mass that MuJoCo does not know of; that of several quadratic frames is singular.
    """
    return mass == "consistent" or (mass is None and all(name in ("affine", "point") for name in types))


def _fields(volume: Volume, frames: Frames, elastic: _Elastic, metric: str) -> Fields:
    """The values at the voxels."""
    condensed = elastic.condensed
    return Fields(
        volume=replace(volume, outline=None),  # which the surfaces have
        weights=elastic.shapes.weights,
        correction=elastic.shapes.correction,
        lifting=condensed.lifting if condensed else None,
        strains=condensed.strains if condensed else None,
        error=condensed.where if condensed else None,
        region=elastic.region,
        seeds=tuple(some.astype(np.int64) for some in frames.seeds),
        metric=metric,
    )


def _surfaces(
    volume: Volume, grid: Grid, elastic: _Elastic, frames: int, options: BuildOptions
) -> tuple[Skin, ContactVertices, DistanceField]:
    """What is seen, what touches, and the signed distance of the rest shape, all moved by the control points."""
    shapes, condensed = elastic.shapes, elastic.condensed
    surface = kept_surface(volume)
    vertices = contact_points(surface, float(np.min(volume.spacing)), volume.axes)
    weights = shapes.at(grid, vertices.positions)
    along_axes = vertices.normals @ volume.axes
    patches = group_patches(vertices.positions, along_axes, weights, shapes.control)
    vertices, weights = vertices.sorted(patches.order), sparse.csr_array(weights[patches.order])
    field = rest_distance_field(grid, shapes, surface, vertices, patches.patch, weights)
    drawn = extract_surface(volume, int(options.skin_vertices)) if options.skin_vertices else surface
    skin = Skin(drawn.vertices, drawn.faces, drawn.label, shapes.at(grid, drawn.vertices))
    answers = condensed.answers if condensed else None
    below = dents(grid, vertices.positions, vertices.normals, frames, answers)
    reach = float(np.min(volume.spacing)) / 2 if options.contact_reach is None else float(options.contact_reach)
    contact = ContactVertices(
        vertices.positions, along_axes[patches.order], reach, patches.patch, patches.cluster, weights, below
    )
    return skin, contact, field
