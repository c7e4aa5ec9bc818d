"""From a volume of materials to a soft body: the stages of the paper's Algorithm 1, initialization, in order.

volume → grid → frame placement → weights → elimination tree → control points → stiffness → masses → surfaces

The stiffness is that of the whole body (`whole_body`), or the paper's: sums over regions, its integration samples.
"""

from __future__ import annotations

import os
import warnings
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from mjframes.cache import cached
from mjframes.control import ControlPoints
from mjframes.errors import MjframesError, telling_memory
from mjframes.fields import COMPLIANCE, EVEN, Fields
from mjframes.frames import Frames, place
from mjframes.grid import evened, voxel_grid, with_materials
from mjframes.lattice import Lattice, rest_lattice
from mjframes.laws import LAWS
from mjframes.mass import mass_difference
from mjframes.material import Material
from mjframes.null_modes import hold_null_modes
from mjframes.patches import group_patches
from mjframes.quadrature import Quadrature, parameters, quadrature
from mjframes.shape_functions import ShapeFunctions
from mjframes.stiffness import Stiffness, region_stiffness
from mjframes.supports import Attached, Fixed, held_cores, pieces
from mjframes.surfaces import Surface, contact_points, extract_surface
from mjframes.volume import Volume, require_connected
from mjframes.weights import Kind
from mjframes.whole_body.build import WholeBody, finite_elements, whole_body
from mjframes.whole_body.cells import Cells
from mjframes.whole_body.contrast import firm_as_rigid
from mjframes.whole_body.count import fewest_frames
from mjframes.whole_body.error import BodyError

WHOLE_BODY, PAPER = "whole_body", "paper"
METHODS = {WHOLE_BODY: EVEN, PAPER: COMPLIANCE}  # and the metric that goes with each
COROTATIONAL = "corotational"
MASSES = ("lumped", "consistent")
MODES = ("implicit", "explicit")
SAMPLES = 10  # of the paper's method, unless given
VOXELS = {"point": 2, "rigid": 3, "affine": 3, "quadratic": 5}  # a frame needs: fewer do not tell its motions apart
RADIUS_LIMIT = 10.0  # [voxels] larger contact spheres no longer follow the surface


class TurnWarning(UserWarning):
    """A body that is free to turn has frames that cannot."""


@dataclass(frozen=True, eq=False)
class Skin:
    """The visible surface, moved by the control points.

    vertices: (s, 3) volume coordinates [m].  faces: (t, 3).  label: (t,) material label of each triangle.
    weights: (s, k) control weights W_j(s).
    """

    vertices: np.ndarray
    faces: np.ndarray
    label: np.ndarray
    weights: sparse.csr_array


@dataclass(frozen=True, eq=False)
class ContactSpheres:
    """Spheres just under the surface, moved by the control points, sorted by patch and cluster.

    centers: (s, 3) volume coordinates [m].  radius: [m].  patch: (s,) and cluster: (s,) within it, see `patches`.
    weights: (s, k) control weights W_j(s).
    """

    centers: np.ndarray
    radius: float
    patch: np.ndarray
    cluster: np.ndarray
    weights: sparse.csr_array


@dataclass(frozen=True, eq=False)
class SoftBody:
    """Everything a scene needs of a soft body. k control points, f frames, r regions.

    parent: (f,) parent frame in the elimination tree, −1 for the root; frames are numbered depth first.  types:
    (f,) of the frames.  links: names of the bodies that hold the first so many frames, "" for the one that the soft
    body is attached to.  control: its points.  stiffness: of its regions, at rest.  law: of its elasticity;
    law_constants: (t, 3) of each material, and cells, or quadrature points with the paper's method: where it is
    evaluated, for a law other than "corotational".  mass_difference: consistent minus lumped mass matrix of each
    region (m, m) [kg], none for lumped mass.  mode: "implicit" or "explicit".  skin, contact: its surfaces.
    lattice: its rest shape, for contact.  materials: by label.  damping: Rayleigh's (α [1/s], β [s]).  voxels: how
    many.  error: against finite elements, None for the paper's method.  fields: what is known at each voxel.
    """

    parent: np.ndarray
    types: tuple[str, ...]
    links: tuple[str, ...]
    control: ControlPoints
    stiffness: Stiffness
    law: str
    law_constants: np.ndarray
    cells: Cells | None
    quadrature: Quadrature | None
    mass_difference: tuple[np.ndarray, ...]
    mode: str
    skin: Skin
    contact: ContactSpheres
    lattice: Lattice
    materials: dict[int, Material]
    damping: tuple[float, float]
    voxels: int
    error: BodyError | None
    fields: Fields

    def __repr__(self) -> str:
        types = ", ".join(f"{count} {name}" for name, count in Counter(self.types).items())
        held = f", {self.held} of them held" if self.held else ""
        error = f"; error: {self.error}" if self.error else ""
        return (
            f"<SoftBody of {len(self.parent)} frames ({types}{held}), {len(self.stiffness.points)} regions, "
            f"{self.voxels} voxels, {self.control.mass.sum():.3g} kg; {self.law}, {self.mode}{error}>"
        )

    @property
    def shapes(self) -> ShapeFunctions:
        """The control weights anywhere in the material."""
        return ShapeFunctions(self.fields.weights, self.control, self.fields.correction)

    @property
    def held(self) -> int:
        """How many frames, the first ones, are held by bodies that are there already."""
        return len(self.links)

    def save(self, path: str) -> None:
        """Write an .npz; an existing file is replaced only by a complete one."""
        from mjframes.asset import save

        save(self, path)

    @staticmethod
    def load(path: str) -> SoftBody:
        """Read what `save` wrote. Raises MjframesError for anything else."""
        from mjframes.asset import load

        return load(path)


@telling_memory
def build(
    volume: Volume | str | os.PathLike[str],
    frames: int | None = None,
    samples: int | None = None,
    *,
    error: float | None = None,
    at: ArrayLike | None = None,
    method: str = WHOLE_BODY,
    frame_type: str | Sequence[str] = "affine",
    metric: str | None = None,
    weights: Kind = "voronoi",
    subdivisions: int = 1,
    law: str = COROTATIONAL,
    law_constants: Mapping[int, Mapping[str, float]] | None = None,
    mass: str | None = None,
    mode: str = "implicit",
    damping: tuple[float, float] = (0.0, 0.0),
    contact_radius: float | None = None,
    fixed: Fixed | Sequence[Fixed] = (),
    attached: Attached | Sequence[Attached] = (),
    seed: int = 0,
    progress: Callable[[str], None] = lambda stage: None,
) -> SoftBody:
    """Build a soft body from a volume, or from the file of one that has materials.

    frames: how many; or error: as many as it takes for `BodyError.largest` to be that small [-]; or at: (f, 3) where,
    in volume coordinates [m].
    method: "whole_body" gives the frames the stiffness that finite elements on all voxels show them, one region a
    frame; "paper" sums it over at most `samples` regions, the paper's integration samples.
    frame_type: "affine" (12 degrees of freedom), "quadratic" (30), "rigid" (6) or "point" (3, translations only, for
    small rotations), for all frames or a sequence with one for each.
    metric: frames are spread by distance inside the body, "even", or by the paper's "compliance" distance; that of the
    method unless given.
    weights: "voronoi" kernels with `subdivisions` ≥ 1, "harmonic" or "linear" ones.
    law: "corotational", or one for large strains: "green_lagrange", "neo_hookean", "mooney_rivlin" or "arruda_boyce",
    with their constants by label where those of Young's modulus and Poisson's ratio will not do.
    mass: "consistent" or "lumped"; unless given, consistent where all frames are affine ones or points.
    mode: "implicit", stable at any step, or "explicit", which does no stiffness work and needs steps shorter than the
    stiffest vibration.
    damping: Rayleigh's (α [1/s], β [s]).  contact_radius: of the contact spheres [m], half a voxel unless given.
    fixed, attached: one or more pieces that do not move in the body that the soft body is attached to, or that move
    with a named one; each is a frame of its own, beside those asked for.
    progress: called with the name of each stage, and as "stage: 25%" within long ones.
    Raises MjframesError for a volume in several pieces and for values out of range. Warns (TurnWarning) of free bodies
    of point frames.
    """
    if isinstance(volume, (str, os.PathLike)):
        volume = Volume.from_labels(volume)
    if not isinstance(volume, Volume):
        raise MjframesError(
            f"volume is a {type(volume).__name__}; give a Volume, as Volume.from_labels(labels, spacing, materials)."
        )
    if not (isinstance(seed, (int, np.integer)) and seed >= 0):
        raise MjframesError(f"seed is {seed!r}; it must be a whole number from 0 on.")
    fixed = pieces("fixed", fixed, Fixed)
    attached = pieces("attached", attached, Attached)
    try:
        alpha, beta = map(float, damping)
    except (TypeError, ValueError):
        alpha = beta = np.nan
    if not (np.isfinite([alpha, beta]).all() and min(alpha, beta) >= 0):
        raise MjframesError(f"damping is {damping!r}; it must be two rates (alpha [1/s], beta [s]), both ≥ 0.")
    for name, value, choices in (
        ("method", method, tuple(METHODS)),
        ("metric", metric, (None, EVEN, COMPLIANCE)),
        ("mass", mass, (None, *MASSES)),
        ("law", law, (COROTATIONAL, *LAWS)),
        ("mode", mode, MODES),
    ):
        if value not in choices:
            raise MjframesError(f"{name} is {value!r}; it must be one of {', '.join(map(repr, choices))}.")
    if error is not None and not (isinstance(error, (int, float)) and 0 < error < 1):
        raise MjframesError(f"error is {error!r}; it must be a number between 0 and 1, as 0.05 for 5 %.")
    if sum(given is not None for given in (frames, at, error)) > 1 and (error is not None or at is None):
        raise MjframesError("more than one of frames, at and error is given; give one of them.")
    if frames is None and at is None and error is None:
        raise MjframesError("none of frames, at and error is given; give a number of frames, as frames=5.")
    if frames == 0:
        raise MjframesError("frames is 0; a body needs one or more besides what holds it.")
    if law == COROTATIONAL and law_constants:
        raise MjframesError(
            f"law_constants is {law_constants!r}, but the corotational law has none but those of the materials; leave "
            f"it out, or choose law={LAWS[1]!r} or another."
        )
    metric = metric or METHODS[method]
    if method == PAPER:
        samples = SAMPLES if samples is None else samples
        if error is not None:
            raise MjframesError(f"error is {error!r}, but only the whole body knows its error; give frames.")
    elif samples is not None:
        raise MjframesError(
            f"samples is {samples!r}, but the whole body's stiffness has one region a frame; leave it out, or choose "
            f"method={PAPER!r}."
        )
    if contact_radius is not None and not 0 < contact_radius <= RADIUS_LIMIT * np.min(volume.spacing):
        raise MjframesError(
            f"contact_radius is {contact_radius!r}; it must be positive and at most {RADIUS_LIMIT:g} voxels, "
            f"{RADIUS_LIMIT * np.min(volume.spacing):g} m."
        )
    if law != COROTATIONAL and "point" in frame_type:
        raise MjframesError(
            f"frame_type has 'point' frames, which cannot turn: the law {law!r} would take a rotation for a "
            "strain; use other frames, or the corotational law."
        )
    require_connected(volume)
    progress("listing the voxels")
    if method == WHOLE_BODY:
        volume = firm_as_rigid(volume)
    grid = voxel_grid(volume)
    shaped = evened(grid) if metric == EVEN else grid
    cores, links = held_cores(grid, fixed, attached)
    laws = () if law == COROTATIONAL else parameters(law, grid, law_constants or {})

    def placed(count: int | None) -> Frames:
        progress("placing the frames")
        found = place(grid, shaped, cores, count, at, seed, frame_type, weights, subdivisions, samples)
        _require_voxels(found.types, len(grid.index))
        return found

    made, cells = None, None
    if samples is None:
        hookes = with_materials(grid, [some.hooke for some in laws]) if laws else grid
        finite = finite_elements(hookes, cores, progress)

        def condensed(some: Frames) -> WholeBody:
            return whole_body(hookes, finite, some.shapes, some.types, links, laws, progress)

        if error is not None:
            most = _most_frames(frame_type, len(grid.index)) - len(cores)
            placement, made = fewest_frames(error, grid, finite, most, placed, condensed)
        else:
            placement = placed(frames)
            made = condensed(placement)
        stiffness, region, shapes, cells = made.stiffness, made.region, made.shapes, made.cells
    else:
        placement = placed(frames)
        shapes, regions = placement.shapes, placement.regions
        progress("summing the stiffness")
        assert regions is not None
        stiffness, region = region_stiffness(grid, shapes, regions, placement.tree), regions.label
    if not cores:  # a null mode moves all frames of its chain, so a fixed one holds it
        rigid = [i for i, name in enumerate(placement.types) if name == "rigid"]
        before, stiffness = stiffness, hold_null_modes(stiffness, shapes.control, rigid)
        cells = cells and cells.stiffened(before, stiffness)
    if not cores and "point" in placement.types:
        warnings.warn(
            "frame_type has 'point' frames, which cannot turn, and nothing of the body is held: where it tumbles its "
            "energy may jump and it may stay crumpled; use 'affine' or 'rigid' frames, or hold a piece.",
            TurnWarning,
            stacklevel=3,  # beyond telling_memory
        )
    points = None
    if placement.regions and laws:
        progress("placing the quadrature points")
        points = quadrature(grid, shapes, placement.regions, placement.tree)
    difference: tuple[np.ndarray, ...] = ()
    # bodies that turn gain energy from mass that MuJoCo does not know of; that of several quadratic frames is singular
    slides = all(name in ("affine", "point") for name in placement.types[len(links) :])
    if mass == "consistent" or (mass is None and slides):
        difference = mass_difference(grid, shaped, shapes, region, stiffness)
    progress("attaching the surfaces")
    shape = (volume.labels, volume.spacing, volume.origin, volume.axes)
    surface = Surface(**cached("surface", shape, lambda: vars(extract_surface(volume))))
    spheres = contact_points(surface, volume, contact_radius)
    sphere_weights = shapes.at(grid, spheres.positions)
    patches = group_patches(spheres.positions, spheres.normals, sphere_weights, shapes.control)
    spheres = spheres.sorted(patches.order)
    sphere_weights = sparse.csr_array(sphere_weights[patches.order])
    lattice = rest_lattice(grid, shapes, surface, spheres, patches.patch, sphere_weights)
    return SoftBody(
        parent=placement.tree.parent,
        types=placement.types,
        links=links,
        control=shapes.control,
        stiffness=stiffness,
        law=law,
        law_constants=np.array([some.constants for some in laws]).reshape(-1, 3),
        cells=cells,
        quadrature=points,
        mass_difference=difference,
        mode=mode,
        skin=Skin(
            surface.vertices,
            surface.faces,
            surface.label,
            shapes.at(grid, surface.vertices),
        ),
        contact=ContactSpheres(
            spheres.positions,
            spheres.radius,
            patches.patch,
            patches.cluster,
            sphere_weights,
        ),
        lattice=lattice,
        materials=dict(volume.materials),
        damping=(alpha, beta),
        voxels=len(grid.index),
        error=made.error if made else None,
        fields=Fields(
            volume=volume,
            weights=shapes.weights,
            correction=shapes.correction,
            lifting=made.lifting if made else None,
            error=made.where if made else None,
            region=region,
            seeds=tuple(some.astype(np.int64) for some in placement.seeds),
            metric=metric,
        ),
    )


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
