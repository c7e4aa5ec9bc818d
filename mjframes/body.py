"""From a volume of materials to a soft body: the stages of the paper's Algorithm 1, initialization, in order.

volume → grid → frame placement → weights → regions → elimination tree → control points → stiffness → surfaces
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from mjframes.cache import cached
from mjframes.control import ControlPoints, control_points, control_weights, frame_types
from mjframes.errors import MjframesError
from mjframes.fields import Fields
from mjframes.fixed import Fixed, fixed_cores
from mjframes.grid import voxel_grid
from mjframes.lattice import Lattice, rest_lattice
from mjframes.material import Material
from mjframes.null_modes import hold_null_modes
from mjframes.patches import group_patches
from mjframes.placement import place_frames
from mjframes.regions import split_regions
from mjframes.stiffness import Stiffness, region_stiffness
from mjframes.surfaces import Surface, contact_points, extract_surface, surface_weights
from mjframes.tree import depth_first, frame_tree
from mjframes.volume import Volume, require_connected
from mjframes.weights import Kind, frame_weights

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

    parent: (f,) parent frame in the elimination tree, −1 for the root; frames are numbered depth first.
    fixed: the first so many frames do not move in the body that the soft body is attached to.
    control: its points.  stiffness: of its regions.  fit_error: (r,) of the weights in each region [-].
    skin, contact: its surfaces.  lattice: its rest shape, for contact.  materials: by label.  damping: Rayleigh's
    (α [1/s], β [s]).  voxels: how many.  fields: what is known at each voxel.
    """

    parent: np.ndarray
    fixed: int
    control: ControlPoints
    stiffness: Stiffness
    fit_error: np.ndarray
    skin: Skin
    contact: ContactSpheres
    lattice: Lattice
    materials: dict[int, Material]
    damping: tuple[float, float]
    voxels: int
    fields: Fields

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
    relax: bool = True,
    damping: tuple[float, float] = (0.0, 0.0),
    contact_radius: float | None = None,
    fixed: Sequence[Fixed] = (),
    seed: int = 0,
    progress: Callable[[str], None] = lambda stage: None,
) -> SoftBody:
    """Build a soft body from a volume.

    frames: how many, or at: (f, 3) where, in volume coordinates [m].  samples: how many regions at most (the paper's
    integration samples).  frame_type: "affine" (12 degrees of freedom) or "quadratic" (30), for all frames or a
    sequence with one for each.  weights: "voronoi" kernels with `subdivisions` ≥ 1, "harmonic" or "linear" ones.
    relax: let the material of each region relax within it.  damping: Rayleigh's (α [1/s], β [s]).  contact_radius: of
    the contact spheres [m], half a voxel unless given.  fixed: pieces that do not move in the body that the soft body
    is attached to; each is a frame of its own, beside those asked for.  progress: called with the name of each stage.
    Raises MjframesError for a volume in several pieces and for values out of range.
    """
    try:
        alpha, beta = map(float, damping)
    except (TypeError, ValueError):
        alpha = beta = np.nan
    if not (np.isfinite([alpha, beta]).all() and min(alpha, beta) >= 0):
        raise MjframesError(f"damping is {damping!r}; it must be two rates (alpha [1/s], beta [s]), both ≥ 0.")
    if contact_radius is not None and not 0 < contact_radius <= RADIUS_LIMIT * np.min(volume.spacing):
        raise MjframesError(
            f"contact_radius is {contact_radius!r}; it must be positive and at most {RADIUS_LIMIT:g} voxels, "
            f"{RADIUS_LIMIT * np.min(volume.spacing):g} m."
        )
    require_connected(volume)
    progress("listing the voxels")
    grid = voxel_grid(volume)
    progress("placing the frames")
    cores = fixed_cores(grid, fixed)
    placement = place_frames(grid, frames, at, seed, cores)
    types = ("affine",) * len(cores) + frame_types(frame_type, len(placement.seeds) - len(cores))
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
    stiffness = region_stiffness(grid, shape_functions, control, regions, tree, relax)
    if not cores:  # a null mode moves all frames of its chain, so a fixed one holds it
        stiffness = hold_null_modes(stiffness, control)
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
        fixed=len(cores),
        control=control,
        stiffness=stiffness,
        fit_error=regions.fit_error,
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
