"""From a volume of materials to a soft body: the stages of the paper's Algorithm 1, initialization, in order.

volume → grid → frame placement → weights → regions → elimination tree → control points → stiffness → surfaces
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from mjframes.cache import cached
from mjframes.control import ControlPoints, control_points, control_weights, frame_types
from mjframes.errors import MjframesError
from mjframes.fields import Fields
from mjframes.grid import voxel_grid
from mjframes.lattice import Lattice, rest_lattice
from mjframes.laws import LAWS
from mjframes.mass import mass_difference
from mjframes.material import Material
from mjframes.null_modes import hold_null_modes
from mjframes.patches import group_patches
from mjframes.placement import place_frames
from mjframes.quadrature import Quadrature, parameters, quadrature, require_turning
from mjframes.regions import split_regions
from mjframes.stiffness import Stiffness, region_stiffness
from mjframes.supports import Attached, Fixed, held_cores
from mjframes.surfaces import Surface, contact_points, extract_surface, surface_weights
from mjframes.tree import depth_first, frame_tree
from mjframes.volume import Volume, require_connected
from mjframes.weights import Kind, frame_weights

COROTATIONAL = "corotational"
MASSES = ("lumped", "consistent")
MODES = ("implicit", "explicit")
RADIUS_LIMIT = 10.0  # [voxels] larger contact spheres no longer follow the surface


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
    body is attached to.  control: its points.  stiffness: of its regions.  fit_error: (r,) of the weights in each
    region [-].  law: of its elasticity; law_constants: (t, 3) of each material, and quadrature: the points where it
    is evaluated, for a law other than "corotational".  mass_difference: consistent minus lumped mass matrix of each
    region (m, m) [kg], none for lumped mass.  mode: "implicit" or "explicit".  skin, contact: its surfaces.
    lattice: its rest shape, for contact.  materials: by label.  damping: Rayleigh's (α [1/s], β [s]).  voxels: how
    many.  fields: what is known at each voxel.
    """

    parent: np.ndarray
    types: tuple[str, ...]
    links: tuple[str, ...]
    control: ControlPoints
    stiffness: Stiffness
    fit_error: np.ndarray
    law: str
    law_constants: np.ndarray
    quadrature: Quadrature | None
    mass_difference: tuple[np.ndarray, ...]
    mode: str
    skin: Skin
    contact: ContactSpheres
    lattice: Lattice
    materials: dict[int, Material]
    damping: tuple[float, float]
    voxels: int
    fields: Fields

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


def build(
    volume: Volume,
    frames: int | None = None,
    samples: int = 10,
    *,
    at: ArrayLike | None = None,
    frame_type: str | Sequence[str] = "affine",
    weights: Kind = "voronoi",
    subdivisions: int = 1,
    law: str = COROTATIONAL,
    law_constants: Mapping[int, Mapping[str, float]] | None = None,
    relax: bool = True,
    mass: str = "lumped",
    mode: str = "implicit",
    damping: tuple[float, float] = (0.0, 0.0),
    contact_radius: float | None = None,
    fixed: Sequence[Fixed] = (),
    attached: Sequence[Attached] = (),
    seed: int = 0,
    progress: Callable[[str], None] = lambda stage: None,
) -> SoftBody:
    """Build a soft body from a volume.

    frames: how many, or at: (f, 3) where, in volume coordinates [m].  samples: how many regions at most (the
    paper's integration samples).  frame_type: "affine" (12 degrees of freedom), "quadratic" (30), "rigid" (6) or
    "point" (3, translations only, for small rotations), for all frames or a sequence with one for each.  weights:
    "voronoi" kernels with `subdivisions` ≥ 1, "harmonic" or "linear" ones.  law: "corotational", or one that is
    evaluated at quadrature points: "green_lagrange", "neo_hookean", "mooney_rivlin" or "arruda_boyce", with their
    constants by label where those of Young's modulus and Poisson's ratio will not do.  relax: let the material of
    each region relax within it (the corotational law only).  mass: "lumped" or "consistent".  mode: "implicit",
    stable at any step, or "explicit", which does no stiffness work and needs steps shorter than the stiffest
    vibration.  damping: Rayleigh's (α [1/s], β [s]).  contact_radius: of the contact spheres [m], half a voxel
    unless given.  fixed, attached: pieces that do not move in the body that the soft body is attached to, or that
    move with a named one; each is a frame of its own, beside those asked for.  progress: called with the name of
    each stage.
    Raises MjframesError for a volume in several pieces and for values out of range.
    """
    try:
        alpha, beta = map(float, damping)
    except (TypeError, ValueError):
        alpha = beta = np.nan
    if not (np.isfinite([alpha, beta]).all() and min(alpha, beta) >= 0):
        raise MjframesError(f"damping is {damping!r}; it must be two rates (alpha [1/s], beta [s]), both ≥ 0.")
    if mass not in MASSES:
        raise MjframesError(f"mass is {mass!r}; it must be one of {', '.join(map(repr, MASSES))}.")
    if law not in (COROTATIONAL, *LAWS):
        raise MjframesError(f"law is {law!r}; it must be one of {', '.join(map(repr, (COROTATIONAL, *LAWS)))}.")
    if mode not in MODES:
        raise MjframesError(f"mode is {mode!r}; it must be one of {', '.join(map(repr, MODES))}.")
    if contact_radius is not None and not 0 < contact_radius <= RADIUS_LIMIT * np.min(volume.spacing):
        raise MjframesError(
            f"contact_radius is {contact_radius!r}; it must be positive and at most {RADIUS_LIMIT:g} voxels, "
            f"{RADIUS_LIMIT * np.min(volume.spacing):g} m."
        )
    require_connected(volume)
    progress("listing the voxels")
    grid = voxel_grid(volume)
    progress("placing the frames")
    cores, links = held_cores(grid, fixed, attached)
    placement = place_frames(grid, frames, at, seed, cores)
    types = ("affine",) * len(cores) + frame_types(frame_type, len(placement.seeds) - len(cores))
    if len(types) == 1 and types[0] in ("point", "rigid"):
        raise MjframesError(f"one {types[0]!r} frame cannot be deformed; ask for more, or for another frame_type.")
    progress("computing the weights")
    shape_functions = frame_weights(grid, placement, weights, subdivisions)
    progress("splitting the regions")
    regions = split_regions(grid, shape_functions, samples)
    tree = frame_tree(regions, len(placement.seeds), len(cores))
    types = [types[i] for i in tree.order]
    seeds = tuple(placement.seeds[i] for i in tree.order)
    shape_functions, regions, tree = depth_first(shape_functions, regions, tree)
    progress("summing the stiffness")
    control = control_points(grid, shape_functions, types)
    stiffness = region_stiffness(grid, shape_functions, control, regions, tree, relax and law == COROTATIONAL)
    if not cores:  # a null mode moves all frames of its chain, so a fixed one holds it
        stiffness = hold_null_modes(stiffness, control, [i for i, name in enumerate(types) if name == "rigid"])
    constants, points = np.zeros((0, 3)), None
    if law != COROTATIONAL:
        progress("placing the quadrature points")
        constants = np.array([p.constants for p in parameters(law, grid, law_constants or {})])
        points = require_turning(quadrature(grid, shape_functions, control, regions, tree), control, law)
    consistent = mass == "consistent"
    difference = mass_difference(grid, shape_functions, control, regions, stiffness) if consistent else ()
    progress("attaching the surfaces")
    shape = (volume.labels, volume.spacing, volume.origin, volume.axes)
    surface = Surface(**cached("surface", shape, lambda: vars(extract_surface(volume))))
    spheres = contact_points(surface, volume, contact_radius)
    sphere_weights = control_weights(
        surface_weights(grid, shape_functions, spheres.positions), control, spheres.positions
    )
    patches = group_patches(spheres.positions, spheres.normals, sphere_weights, control)
    spheres = spheres.sorted(patches.order)
    sphere_weights = sparse.csr_array(sphere_weights[patches.order])
    lattice = rest_lattice(grid, shape_functions, control, surface, spheres, patches.patch, sphere_weights)
    return SoftBody(
        parent=tree.parent,
        types=tuple(types),
        links=links,
        control=control,
        stiffness=stiffness,
        fit_error=regions.fit_error,
        law=law,
        law_constants=constants,
        quadrature=points,
        mass_difference=difference,
        mode=mode,
        skin=Skin(
            surface.vertices,
            surface.faces,
            surface.label,
            control_weights(surface_weights(grid, shape_functions, surface.vertices), control, surface.vertices),
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
        fields=Fields(volume, shape_functions, regions.label, seeds),
    )
