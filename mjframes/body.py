"""From a volume of materials to a soft body: the stages of the paper's Algorithm 1, initialization, in order.

volume → grid → frame placement → weights → regions → elimination tree → control points → stiffness → surfaces
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from mjframes.control import ControlPoints, control_points, control_weights
from mjframes.errors import MjframesError
from mjframes.grid import voxel_grid
from mjframes.material import Material
from mjframes.patches import group_patches
from mjframes.placement import place_frames
from mjframes.regions import split_regions
from mjframes.stiffness import Stiffness, region_stiffness
from mjframes.surfaces import contact_points, extract_surface, surface_weights
from mjframes.tree import depth_first, elimination_tree
from mjframes.volume import Volume, require_connected
from mjframes.weights import voronoi_weights


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
    control: its points.  stiffness: of its regions.  fit_error: (r,) of the weights in each region [-].
    skin, contact: its surfaces.  materials: by label.  damping: Rayleigh's (α [1/s], β [s]).  voxels: how many.
    """

    parent: np.ndarray
    control: ControlPoints
    stiffness: Stiffness
    fit_error: np.ndarray
    skin: Skin
    contact: ContactSpheres
    materials: dict[int, Material]
    damping: tuple[float, float]
    voxels: int

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
    damping: tuple[float, float] = (0.0, 0.0),
    contact_radius: float | None = None,
    seed: int = 0,
    progress: Callable[[str], None] = lambda stage: None,
) -> SoftBody:
    """Build a soft body from a volume.

    frames: how many, or at: (f, 3) where, in volume coordinates [m].  samples: how many regions at most (the paper's
    integration samples).  damping: Rayleigh's (α [1/s], β [s]).  contact_radius: of the contact spheres [m], half a
    voxel unless given.  progress: called with the name of each stage.
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
    placement = place_frames(grid, frames, at, seed)
    progress("computing the weights")
    weights = voronoi_weights(grid, placement)
    progress("splitting the regions")
    regions = split_regions(grid, weights, samples)
    tree = elimination_tree(regions.frames, len(placement.seeds))
    weights, regions, tree = depth_first(weights, regions, tree)
    progress("summing the stiffness")
    control = control_points(grid, weights)
    stiffness = region_stiffness(grid, weights, control, regions, tree)
    progress("attaching the surfaces")
    surface = extract_surface(volume)
    spheres = contact_points(surface, volume, contact_radius)
    sphere_weights = control_weights(surface_weights(grid, weights, spheres.positions), control, spheres.positions)
    patches = group_patches(spheres.positions, spheres.normals, sphere_weights, control)
    return SoftBody(
        parent=tree.parent,
        control=control,
        stiffness=stiffness,
        fit_error=regions.fit_error,
        skin=Skin(
            surface.vertices,
            surface.faces,
            surface.label,
            control_weights(surface_weights(grid, weights, surface.vertices), control, surface.vertices),
        ),
        contact=ContactSpheres(
            spheres.positions[patches.order],
            spheres.radius,
            patches.patch,
            patches.cluster,
            sparse.csr_array(sphere_weights[patches.order]),
        ),
        materials=dict(volume.materials),
        damping=(alpha, beta),
        voxels=len(grid.index),
    )
