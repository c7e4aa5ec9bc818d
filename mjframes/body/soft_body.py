"""A soft body: all that a scene needs of it, what the stages of Algorithm 1 end with."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy import sparse

from mjframes.base.archive import is_archive, read_archive, write_archive
from mjframes.base.constants import BODY_VERSION, KIND
from mjframes.base.errors import MjframesError, reason, telling_memory
from mjframes.base.packing import packed, restored
from mjframes.body.check import check_body
from mjframes.body.fields import Fields
from mjframes.elasticity.quadrature import Quadrature
from mjframes.elasticity.shares import factor_of
from mjframes.elasticity.stiffness import Stiffness
from mjframes.kinematics.control import ControlPoints
from mjframes.kinematics.shape_functions import ShapeFunctions
from mjframes.surface.dents import Dents
from mjframes.surface.distance_field import DistanceField
from mjframes.volume.material import Material
from mjframes.volume.volume import occurring
from mjframes.whole_body.cells import Cells
from mjframes.whole_body.error import BodyError

WHAT = "the soft body"  # that its file holds


@dataclass(frozen=True, eq=False)
class Skin:
    """The visible surface, moved by the control points.

    vertices: (s, 3) volume coordinates [m].
    faces: (t, 3).
    label: (t,) material label of each triangle.
    weights: (s, k) control weights W_j(s).
    """

    vertices: np.ndarray
    faces: np.ndarray
    label: np.ndarray
    weights: sparse.csr_array


@dataclass(frozen=True, eq=False)
class ContactVertices:
    """Vertices of the surface that touch, moved by the control points, sorted by patch and cluster.

    positions: (s, 3) volume coordinates [m].
    normals: (s, 3) of the surface there, outward, along the volume's axes.
    reach: what is higher than the deepest vertex of its cluster by this or more has no share in its contact [m].
    patch: (s,) and cluster: (s,) within it, see `patches`.
    weights: (s, k) control weights W_j(s).
    dents: those that a contact makes there.
    """

    positions: np.ndarray
    normals: np.ndarray
    reach: float
    patch: np.ndarray
    cluster: np.ndarray
    weights: sparse.csr_array
    dents: Dents


@dataclass(frozen=True, eq=False)
class SoftBody:
    """A soft body as `build` returns it: everything that a scene needs of it.

    It has k control points, f frames and r regions. You rarely make one yourself.

    Parameters
    ----------
    parent
        Parent (f,) of each frame in the elimination tree, −1 for the root. Frames are numbered depth first.
    types
        Type (f,) of each frame.
    links
        Names of the bodies that hold the first frames, one each, "" for the body that the soft body is attached to.
    control
        The control points.
    stiffness
        Stiffness of the regions at rest.
    law
        Name of the law of elasticity.
    law_constants
        Constants (t, 3) of each material of the grid's table, for a law other than "corotational".
    cells, quadrature
        Where that law is evaluated, by the whole body's method and by the paper's.
    mass_difference
        Consistent minus lumped mass matrix (m, m) of each region [kg]. It is empty for lumped mass.
    mode
        "implicit" or "explicit".
    skin, contact
        The surface that is drawn, and the vertices that touch.
    distance_field
        Signed distance of the rest shape, for contact.
    damping
        Rayleigh's α [1/s] and β [s].
    error
        Estimated error against finite elements, None for the paper's method.
    fields
        Values at each voxel.
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
    mass_difference: tuple[np.ndarray, ...] = field(metadata={"symmetric": True})
    mode: str
    skin: Skin
    contact: ContactVertices
    distance_field: DistanceField
    damping: tuple[float, float]
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
        """Return the control weights anywhere in the material."""
        return ShapeFunctions(self.fields.weights, self.control, self.fields.correction)

    @property
    def materials(self) -> Mapping[int, Material]:
        """Return the materials by label."""
        return self.fields.volume.materials

    @cached_property
    def deformable(self) -> dict[int, str]:
        """Return the names, by label, of the materials that deform and so have factors of their own, ascending.

        A body that is rigid throughout has one factor, under the first of its labels.
        """
        found = {label: material.name for label, material in self._present.items() if not material.is_rigid}
        return found or {label: material.name for label, material in list(self._present.items())[:1]}

    @property
    def factor_of(self) -> np.ndarray:
        """Return (t,) which of these factors each material that the volume has follows, by label."""
        return factor_of(list(self._present.values()))

    @cached_property
    def _present(self) -> dict[int, Material]:
        """The materials that the volume has, by label, ascending."""
        return {label: self.materials[label] for label in sorted(occurring(self.fields.volume.labels))}

    @property
    def voxels(self) -> int:
        """Return how many voxels are inside."""
        return len(self.fields.region)

    @property
    def held(self) -> int:
        """Return how many frames, the first ones, are held by bodies that are there already."""
        return len(self.links)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write an .npz; an existing file is replaced only by a complete one."""
        write_archive(path, WHAT, KIND, BODY_VERSION, packed(self))

    @staticmethod
    @telling_memory
    def load(path: str | os.PathLike[str]) -> SoftBody:
        """Return what `save` wrote. Raise MjframesError for anything else."""
        arrays = read_archive(path, WHAT, KIND, BODY_VERSION)
        try:
            return unpacked(arrays)
        except (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError) as error:
            fault = f"{error.args[0]} is missing" if isinstance(error, KeyError) else reason(error)
            raise MjframesError(
                f"{path}: arrays of the soft body are missing or damaged ({fault}); build it again."
            ) from error


def unpacked(arrays: Mapping[str, np.ndarray]) -> SoftBody:
    """Return the soft body of arrays that `packed` made.

    Raise ArithmeticError, AttributeError, LookupError, RecursionError, TypeError or ValueError for other arrays.
    """
    body = restored(SoftBody, arrays)
    check_body(body)
    return replace(body, fields=body.fields.normalised())


def is_soft_body(path: str | os.PathLike[str]) -> bool:
    """Return whether a file is a saved soft body, of whatever version."""
    return is_archive(path, KIND)
