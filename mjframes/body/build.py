"""Algorithm 1 of the paper, initialization: from a volume of materials to a soft body, a stage after the other.

volume → grid → frames (placement, weights, elimination tree, control points) → stiffness → masses → surfaces

The stiffness is that of the whole body (`whole_body`), or the paper's: sums over regions, its integration samples.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from mjframes.base.cache import cached
from mjframes.base.choices import COROTATIONAL, EVEN, WHOLE_BODY
from mjframes.base.errors import MjframesError, Notice, telling_memory
from mjframes.body.cost import announce
from mjframes.body.fewest import MOST, default_counts, fewest_frames, sufficiency, sufficient_frames
from mjframes.body.fields import Fields
from mjframes.body.frames import Frames, place
from mjframes.body.options import Options, Paper, checked
from mjframes.body.soft_body import ContactVertices, Skin, SoftBody
from mjframes.elasticity.laws import LawParameters
from mjframes.elasticity.mass import mass_difference
from mjframes.elasticity.null_modes import hold_null_modes
from mjframes.elasticity.quadrature import Quadrature, parameters, quadrature
from mjframes.elasticity.stiffness import Stiffness, region_stiffness
from mjframes.frames.supports import Support, held_cores
from mjframes.kinematics.shape_functions import ShapeFunctions
from mjframes.surface.contact_points import contact_points
from mjframes.surface.dents import dents
from mjframes.surface.distance_field import DistanceField, rest_distance_field
from mjframes.surface.isosurface import Surface, extract_surface
from mjframes.surface.patches import group_patches
from mjframes.volume.grid import Grid, evened, voxel_grid, with_materials
from mjframes.volume.volume import Volume, require_connected
from mjframes.weights.weights import Weights
from mjframes.whole_body.build import Condensed, finite_elements, whole_body
from mjframes.whole_body.cells import Cells
from mjframes.whole_body.contrast import firm_as_rigid

Progress = Callable[[str], None]

VOXELS = {"point": 2, "rigid": 3, "affine": 3, "quadratic": 5}  # a frame needs: fewer do not tell its motions apart


class TurnWarning(UserWarning):
    """A body that is free to turn has frames that cannot."""


@telling_memory
def build(
    volume: Volume | str | os.PathLike[str],
    frames: int | None = None,
    *,
    error: float | None = None,
    at: ArrayLike | None = None,
    supports: Support | Sequence[Support] = (),
    frame_type: str | Sequence[str] = "affine",
    method: str | Paper = WHOLE_BODY,
    metric: str | None = None,
    weights: str | Weights = "voronoi",
    law: str = COROTATIONAL,
    mass: str | None = None,
    mode: str = "implicit",
    damping: tuple[float, float] = (0.0, 0.0),
    contact_reach: float | None = None,
    seed: int = 0,
    progress: Progress = lambda stage: None,
) -> SoftBody:
    """Build a soft body from a volume, or from the file of one that has materials.

    frames: how many; or error: as many as it takes for `BodyError.largest` to be that small [-]; or at: (f, 3) where,
    in volume coordinates [m]. Without any of them, as many as `frame_type` has, or 3 by the paper's method, or the
    fewest of up to 20 that keep an error of 15 %, or come nearest to it, which a Notice tells.
    supports: pieces that stand still in the body that the soft body is attached to (`Fixed`), or move with a named one
    (`Attached`); each is a frame of its own, beside those asked for.
    frame_type: "affine" (12 degrees of freedom), "quadratic" (30), "rigid" (6) or "point" (3, translations only, for
    small rotations), for all frames or a sequence with one for each.
    method: "whole_body" gives the frames the stiffness that finite elements on all voxels show them, one region a
    frame; "paper" or `Paper(samples)` sums it over regions, the paper's integration samples.
    metric: frames are spread by distance inside the body, "even", or by the paper's "compliance" distance; that of the
    method unless given.
    weights: "voronoi", "harmonic" or "linear" ones, or `Voronoi(subdivisions)`, `Harmonic()`, `Linear(axis)`.
    law: "corotational", or one for large strains: "green_lagrange", "neo_hookean", "mooney_rivlin" or "arruda_boyce";
    its constants are those of `Material.law_constants`, the others follow from Young's modulus and Poisson's ratio.
    mass: "consistent" or "lumped"; unless given, consistent where all frames are affine ones or points.
    mode: "implicit", stable at any step, or "explicit", which does no stiffness work and needs steps shorter than the
    stiffest vibration.
    damping: Rayleigh's (α [1/s], β [s]).
    contact_reach: what is higher than the deepest point of a contact by this or more has no share in it [m], half a
    voxel unless given.
    progress: called with the name of each stage, and as "stage: 25%" within long ones.
    Raise MjframesError for a volume in several pieces, for values out of range and where memory will not do. Warn
    (TurnWarning) of free bodies of point frames, and (Notice) of builds of more than a minute.
    """
    if isinstance(volume, (str, os.PathLike)):
        volume = Volume.load(volume)
    options = checked(
        volume, frames, error, at, method, frame_type, metric, weights, law, mass, mode, damping, contact_reach,
        supports, seed,
    )  # fmt: skip
    require_connected(volume)

    if options.paper is None:
        count = (options.frames or MOST) + len(options.supports)
        announce(int(np.count_nonzero(volume.labels)), count, volume.spacing)
    progress("listing the voxels")
    if options.paper is None:
        volume = firm_as_rigid(volume)
    grid = voxel_grid(volume)
    metric_grid = evened(grid) if options.metric == EVEN else grid
    cores, links = held_cores(grid, options.supports)
    laws = parameters(law, grid)

    def placed(count: int | None) -> Frames:
        progress("placing the frames")
        chosen = place(grid, metric_grid, cores, count, at, seed, frame_type, options.weights, options.paper)
        _require_voxels(chosen.types, len(grid.index))
        return chosen

    if options.paper is None:
        most = _most_frames(frame_type, len(grid.index)) - len(cores)
        chosen, elastic = _whole_body(grid, cores, links, laws, options, most, placed, progress)
    else:
        chosen = placed(options.frames)
        elastic = _sums(grid, chosen, laws, progress)
    if not cores:
        elastic = _held(elastic, chosen.types)
        _warn_of_points(chosen.types)

    difference: tuple[NDArray[np.float64], ...] = ()
    if _is_consistent(mass, chosen.types[len(links) :]):
        difference = mass_difference(grid, metric_grid, elastic.shapes, elastic.region, elastic.stiffness)

    progress("attaching the surfaces")
    skin, contact, field = _surfaces(volume, grid, elastic, len(chosen.types), contact_reach)
    condensed = elastic.condensed
    return SoftBody(
        parent=chosen.tree.parent,
        types=chosen.types,
        links=links,
        control=elastic.shapes.control,
        stiffness=elastic.stiffness,
        law=law,
        law_constants=np.array([some.constants for some in laws]).reshape(-1, 3),
        cells=elastic.cells,
        quadrature=elastic.quadrature,
        mass_difference=difference,
        mode=mode,
        skin=skin,
        contact=contact,
        distance_field=field,
        damping=options.damping,
        error=condensed.error if condensed else None,
        fields=Fields(
            volume=volume,
            weights=elastic.shapes.weights,
            correction=elastic.shapes.correction,
            lifting=condensed.lifting if condensed else None,
            error=condensed.where if condensed else None,
            region=elastic.region,
            seeds=tuple(some.astype(np.int64) for some in chosen.seeds),
            metric=options.metric,
        ),
    )


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
    options: Options,
    most: int,
    placed: Callable[[int | None], Frames],
    progress: Progress,
) -> tuple[Frames, _Elastic]:
    """The frames of a number, or the fewest of up to `most` that keep an error, and what finite elements show them."""
    hookes = with_materials(grid, [some.hooke for some in laws]) if laws else grid
    finite = finite_elements(hookes, cores, progress)

    def condense(some: Frames) -> Condensed:
        return whole_body(hookes, finite, some.shapes, some.types, links, laws, progress)

    if options.error is not None:
        chosen, made = fewest_frames(options.error, grid, finite, most, placed, condense)
    elif options.is_open:
        chosen, made = sufficient_frames(grid, finite, default_counts(most), placed, condense)
        notice = sufficiency(len(chosen.types) - len(links), made.error)
        warnings.warn(notice, Notice, stacklevel=4)  # beyond telling_memory
    else:
        chosen = placed(options.frames)
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


def _warn_of_points(types: Sequence[str]) -> None:
    if "point" in types:
        warnings.warn(
            "frame_type has 'point' frames, which cannot turn, and nothing of the body is held: where it tumbles its "
            "energy may jump and it may stay crumpled; use 'affine' or 'rigid' frames, or hold a piece.",
            TurnWarning,
            stacklevel=4,  # beyond telling_memory
        )


def _is_consistent(mass: str | None, types: Sequence[str]) -> bool:
    """Whether free frames of these types have the consistent mass, unless told.

    Bodies that turn gain energy from mass that MuJoCo does not know of; that of several quadratic frames is singular.
    """
    return mass == "consistent" or (mass is None and all(name in ("affine", "point") for name in types))


def _surfaces(
    volume: Volume, grid: Grid, elastic: _Elastic, frames: int, contact_reach: float | None
) -> tuple[Skin, ContactVertices, DistanceField]:
    """What is seen, what touches, and the signed distance of the rest shape, all moved by the control points."""
    shapes, condensed = elastic.shapes, elastic.condensed
    shape = (volume.labels, volume.spacing, volume.origin, volume.axes)
    surface = Surface(**cached("surface", shape, lambda: vars(extract_surface(volume))))
    vertices = contact_points(surface)
    weights = shapes.at(grid, vertices.positions)
    patches = group_patches(vertices.positions, vertices.normals, weights, shapes.control)
    vertices, weights = vertices.sorted(patches.order), sparse.csr_array(weights[patches.order])
    field = rest_distance_field(grid, shapes, surface, vertices, patches.patch, weights)
    skin = Skin(surface.vertices, surface.faces, surface.label, shapes.at(grid, surface.vertices))
    pushed, missing = (condensed.pushed, condensed.missing) if condensed else ((), None)
    below = dents(grid, vertices.positions, vertices.normals, frames, pushed, missing)
    reach = float(np.min(volume.spacing)) / 2 if contact_reach is None else float(contact_reach)
    contact = ContactVertices(vertices.positions, reach, patches.patch, patches.cluster, weights, below)
    return skin, contact, field


def _most_frames(frame_type: str | Sequence[str], voxels: int) -> int:
    """As many as `_require_voxels` allows, if all are of the type that needs most."""
    kinds = [frame_type] if isinstance(frame_type, str) else frame_type
    return voxels // max((VOXELS.get(kind, 1) for kind in kinds), default=1)


def _require_voxels(types: Sequence[str], voxels: int) -> None:
    needed = sum(VOXELS[name] for name in types)
    if len(types) > 1 and needed > voxels:
        raise MjframesError(
            f"frames is {len(types)}, held ones included, but the volume has {voxels} voxels: too few to tell them "
            f"apart; use at most {max(1, voxels * len(types) // needed)}, or smaller voxels."
        )
