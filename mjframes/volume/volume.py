"""The volume: a material label per voxel, M(p̄) = materials[labels[a, b, c]] (the paper, §4: material maps).

Voxel (a, b, c) fills origin + axes · (spacing ∘ [a, a+1] × [b, b+1] × [c, c+1]); label 0 is outside. All is SI.
First stage of the pipeline: labels and materials in, a `Volume` out, valid by construction.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.ndimage
from numpy.typing import ArrayLike, NDArray

from mjframes.base.constants import MOST_CELLS, UP, VOLUME_VERSION
from mjframes.base.errors import MjframesError, telling_memory
from mjframes.base.files import replacing
from mjframes.base.numbers import is_number
from mjframes.volume.hull import in_convex_hull
from mjframes.volume.images import LabelImage, read_image, write_materials
from mjframes.volume.material import Material
from mjframes.volume.outline import Outline, ball_outline, cylinder_outline, outline_in, outline_of
from mjframes.volume.solids import Solid, ball, box, cylinder
from mjframes.volume.spacing import require_voxels, spacing_or_voxels, three_lengths

if TYPE_CHECKING:
    from mjframes.volume.meshes import MeshLike

ORTHOGONAL = 1e-3  # [-] largest cosine between index axes: headers round to about 1e-5, a tilted gantry gives 1e-2
MANY = 30  # labels without a material that no atlas, but an image of intensities has
SHOWN = 10  # of them
FINER = 0.3  # [-] of the voxels: what was sampled by larger ones is too far away from the steps between these
LARGEST_LABEL = 2**32 - 1  # fits uint32; atlases number their structures with up to nine digits


@dataclass(frozen=True, eq=False)
class Volume:
    """Voxels, each with a label. Each label has a material, and 0 is outside.

    `Volume.load`, `from_labels`, `from_meshes`, `box`, `sphere` and `cylinder` make one.

    Parameters
    ----------
    labels
        Unsigned integers (nx, ny, nz), 0 outside.
    spacing
        Edges (3,) of a voxel [m].
    origin
        Corner (3,) of voxel (0, 0, 0) [m].
    axes
        Proper rotation (3, 3). Column a is the direction of index axis a.
    materials
        Material of every label that occurs. Other labels may be there too.
    outline
        Surfaces that the voxels were sampled from, if known, in voxels. The body's surface is drawn to them where it
        is near.

    Raises
    ------
    MjframesError
        If an argument is not as described, and for a volume with nothing inside.
    """

    labels: NDArray[np.unsignedinteger]
    spacing: NDArray[np.float64]
    origin: NDArray[np.float64]
    axes: NDArray[np.float64]
    materials: dict[int, Material]
    outline: Outline | None = None

    def __post_init__(self) -> None:
        labels = np.asarray(self.labels)
        if labels.ndim != 3:
            raise MjframesError(f"labels have shape {labels.shape}; they must be an (nx, ny, nz) array of integers.")
        if labels.dtype.kind != "u":
            raise MjframesError(
                f"labels are {labels.dtype}; pass them through Volume.from_labels, which converts them."
            )
        for name in ("spacing", "origin"):
            value = np.asarray(getattr(self, name))
            if value.shape != (3,) or not np.isfinite(value).all() or (name == "spacing" and (value <= 0).any()):
                kind = "three positive lengths" if name == "spacing" else "three coordinates"
                raise MjframesError(f"{name} is {value.tolist()}; it must be {kind} in metres.")
        axes = np.asarray(self.axes)
        if axes.shape != (3, 3) or not np.allclose(axes.T @ axes, np.eye(3), atol=1e-6) or np.linalg.det(axes) < 0:
            raise MjframesError(f"axes are {axes.tolist()}; they must be a proper rotation matrix.")
        if not isinstance(self.outline, Outline | None):
            raise MjframesError(f"outline is {self.outline!r}; it must be an Outline, as from_meshes makes, or None.")
        _check_materials(occurring(labels), self.materials)

    @classmethod
    @telling_memory
    def load(
        cls,
        path: str | os.PathLike[str],
        *,
        spacing: ArrayLike | None = None,
        materials: Mapping[int, Material] | None = None,
        origin: ArrayLike | None = None,
        drop_unknown: bool = False,
        crop: bool = False,
        up: str = "z",
    ) -> Volume:
        """Return a volume from a file: what `save` wrote, or a label image.

        Coordinates are those of the file. Images with anatomical orientation are converted to RAS: x points to the
        right and y to the front, whether the file has them so (NIfTI) or as LPS (NRRD, MetaImage). For left-handed axes
        one array axis is reversed; sheared axes are refused.

        Parameters
        ----------
        path
            File of one of the types in `mjframes.volume.images.IMAGE_TYPES`.
        spacing
            Edge of a voxel [m], one length or three, in place of the file's.
        materials
            Material of each label. A file that was saved with materials needs none.
        origin
            Corner (3,) of voxel (0, 0, 0) [m], in place of the file's.
        drop_unknown, crop, up
            See `from_labels`.

        Raises
        ------
        MjframesError
            If the file cannot be read or used.
        """
        if not isinstance(path, (str, os.PathLike)):
            raise MjframesError(f"path is a {type(path).__name__}; give that of a file, or an array to from_labels.")
        image = read_image(Path(path))
        return cls._made(image, f"{os.fspath(path)}: ", spacing, materials, origin, drop_unknown, crop, up)

    @classmethod
    @telling_memory
    def from_labels(
        cls,
        labels: ArrayLike,
        spacing: ArrayLike | None = None,
        materials: Mapping[int, Material] | None = None,
        origin: ArrayLike | None = None,
        drop_unknown: bool = False,
        crop: bool = False,
        up: str = "z",
    ) -> Volume:
        """Return a volume from an array of labels.

        Parameters
        ----------
        labels
            Non-negative whole numbers (nx, ny, nz), 0 outside.
        spacing
            Edge of a voxel [m], one length or three.
        materials
            Material of each label that occurs.
        origin
            Corner (3,) of voxel (0, 0, 0) [m]. The default is 0.
        drop_unknown
            Whether voxels without a material are outside, such as noise in a segmentation. Otherwise they are refused.
        crop
            Whether to remove slices with nothing inside on all sides.
        up
            Axis of the array that points up, see `upright`.

        Raises
        ------
        MjframesError
            For labels, lengths and materials that cannot be used.
        """
        if isinstance(labels, (str, os.PathLike)):
            raise MjframesError(f"labels is {os.fspath(labels)!r}; give an array, or a file to Volume.load.")
        return cls._made(LabelImage(_array(labels)), "", spacing, materials, origin, drop_unknown, crop, up)

    @classmethod
    def _made(
        cls,
        image: LabelImage,
        source: str,
        spacing: ArrayLike | None,
        materials: Mapping[int, Material] | None,
        origin: ArrayLike | None,
        drop_unknown: bool,
        crop: bool,
        up: str,
    ) -> Volume:
        found = materials if materials is not None else image.materials or {}
        if not isinstance(found, Mapping):
            raise MjframesError(f"materials is {found!r}; it must map labels to Material, as in {{1: Material(...)}}.")
        _require_labels(source, image.labels)
        shape = np.array(image.labels.shape)
        low, high = _box(image.labels, set(found) if drop_unknown else None) if crop else (np.zeros(3, int), shape)
        array = _shrink(source, image.labels[tuple(map(slice, low, high))])
        if (step := image.spacing if spacing is None else spacing) is None:
            missing = [] if drop_unknown else [label for label in occurring(array) if label not in found]
            more = f" Besides, {_without_material(missing)}" if missing else ""
            raise MjframesError(
                f"{source}spacing is missing; pass spacing= or --spacing, the edge of a voxel in metres.{more}"
            )
        step = three_lengths(f"{source}spacing", step)
        axes = _orthonormal(source, image.axes)
        corner = np.zeros(3)
        if image.origin is not None:
            corner = _vector(f"{source}origin", image.origin) - axes @ step * image.origin_index
        is_left = np.linalg.det(axes) < 0
        if is_left:
            a = int(np.argmin(np.diag(axes)))  # of the three reversals the one that leaves the smallest rotation
            corner = corner + axes[:, a] * step[a] * shape[a]
            axes[:, a] *= -1
            array = np.flip(array, a)
            low[a] = shape[a] - high[a]
        if origin is not None:
            corner = _vector("origin", origin)
        if drop_unknown:
            array[np.isin(array, list(set(occurring(array)) - set(found)))] = 0
        try:
            outline = image.outline
            if outline is not None:
                whole_grid = not is_left and tuple(outline.shape) == image.labels.shape
                outline = outline.on(low.astype(float), np.ones(3), array.shape) if whole_grid else None
            whole = cls(np.ascontiguousarray(array), step, corner + axes @ (low * step), axes, dict(found), outline)
        except MjframesError as error:
            raise MjframesError(f"{source}{error}") from error
        return whole.upright(up)

    @classmethod
    @telling_memory
    def from_meshes(
        cls,
        meshes: Sequence[tuple[MeshLike, Material]],
        spacing: ArrayLike | None = None,
        *,
        voxels: int | None = None,
        fill: Material | None = None,
        scale: float | None = None,
        up: str = "z",
    ) -> Volume:
        """Return a volume from surface meshes, each of one material. Where they overlap, the later one wins.

        Voxels are cached on disk until a mesh or an argument changes. Surfaces need not be perfect:
        `mjframes.volume.meshes` says what counts as inside.

        Parameters
        ----------
        meshes
            Pairs (mesh, material). A mesh is a file (.obj .stl .ply .off .glb …) or a trimesh object. The i-th pair,
            counted from 1, has label i.
        spacing
            Edge of a voxel [m], one length or three.
        voxels
            About how many voxels are inside, in place of `spacing`. The default is 20,000.
        fill
            Material of the rest of the convex hull: flesh around bones. Its label is the last one.
        scale
            Length of the meshes' unit [m], 0.001 for millimetres. The default is the unit that a mesh has itself, as
            .3mf files do, or else the metre. Coordinates are kept otherwise.
        up
            Axis of the meshes that points up, see `upright`.

        Raises
        ------
        MjframesError
            For a mesh that cannot be used or contains no voxel, and for arguments out of range.

        Warns
        -----
        MeshWarning
            For each fault of a surface, with what was done about it, and for parts that are thinner than a voxel.
        """
        from mjframes.base.cache import cached
        from mjframes.volume.meshes import MeshWarning, load_surface, mesh_contents, mesh_name
        from mjframes.volume.voxelize import convex_hull, spacing_for, voxelize

        step, count = spacing_or_voxels(spacing, voxels)
        if scale is not None and not (is_number(scale) and scale > 0):
            raise MjframesError(f"scale is {scale!r}; it must be the length of the meshes' unit in metres.")
        pairs = list(meshes)
        if not pairs or not all(isinstance(pair, tuple) and len(pair) == 2 for pair in pairs):
            raise MjframesError("meshes must be a list of one or more pairs (mesh, material).")
        materials = [material for _, material in pairs] + ([] if fill is None else [fill])
        for material in materials:
            if not isinstance(material, Material):
                raise MjframesError(f"a mesh has the material {material!r}; it must be a Material.")
        named = [(mesh, mesh_name(mesh, number)) for number, (mesh, _) in enumerate(pairs, 1)]

        def compute() -> dict[str, NDArray[Any]]:
            surfaces = [load_surface(mesh, name, scale) for mesh, name in named]
            edges = spacing_for(surfaces, count, fill is not None) if step is None else step
            labels, origin, notices = voxelize(surfaces, edges, fill is not None)
            whole = surfaces if fill is None else [convex_hull(surfaces)]
            outline = outline_of(whole, origin, edges, labels.shape).arrays()
            arrays = {"labels": labels, "origin": origin, "spacing": edges, "notices": np.array(notices, np.str_)}
            return arrays | outline

        contents = [mesh_contents(mesh, name, scale) for mesh, name in named]
        settings = (step, count if step is None else None, fill is not None, scale if scale is None else float(scale))
        known = cached("volume", (*contents, *settings), compute)
        for notice in known["notices"].tolist():
            warnings.warn(notice, MeshWarning, stacklevel=3)  # beyond telling_memory
        labels, origin, step = known["labels"], known["origin"], known["spacing"]
        present = set(occurring(labels))
        inside = {i: material for i, material in enumerate(materials, 1) if i in present}
        return cls(labels, step, origin, np.eye(3), inside, outline_in(known)).upright(up)

    @classmethod
    @telling_memory
    def box(
        cls, size: ArrayLike, material: Material, spacing: ArrayLike | None = None, *, voxels: int | None = None
    ) -> Volume:
        """Return a box of one material, label 1, centred on the origin.

        Parameters
        ----------
        size
            Edges along x, y and z [m], one length or three. They are exact.
        material
            What the box is made of.
        spacing
            Edge of a voxel [m], one length or three. It is adjusted so that a whole number of voxels fits each edge.
        voxels
            About how many voxels the box has, in place of `spacing`. The default is 20,000.

        Raises
        ------
        MjframesError
            If a length is not positive, if both `spacing` and `voxels` are given, or if no voxel fits.
        """
        return cls._of_solid(box(size, spacing, voxels), material)

    @classmethod
    @telling_memory
    def sphere(
        cls, radius: float, material: Material, spacing: ArrayLike | None = None, *, voxels: int | None = None
    ) -> Volume:
        """Return a solid sphere of one material, label 1, centred on the origin.

        A voxel is inside if its centre is. The surface is round.

        Parameters
        ----------
        radius
            Radius [m].
        material
            What the sphere is made of.
        spacing
            Edge of a voxel [m], one length or three.
        voxels
            About how many voxels are inside, in place of `spacing`. The default is 20,000.

        Raises
        ------
        MjframesError
            If a length is not positive, if both `spacing` and `voxels` are given, if no voxel fits, or if the
            volume of all voxels is off by more than a quarter.
        """
        whole = cls._of_solid(ball(radius, spacing, voxels), material)
        grid = whole.origin, whole.spacing, whole.labels.shape
        return replace(whole, outline=ball_outline(float(radius), *grid))

    @classmethod
    @telling_memory
    def cylinder(
        cls,
        radius: float,
        length: float,
        material: Material,
        spacing: ArrayLike | None = None,
        *,
        voxels: int | None = None,
    ) -> Volume:
        """Return a solid cylinder of one material, label 1, along z and centred on the origin.

        A voxel is inside if its centre is. The surface is round.

        Parameters
        ----------
        radius
            Radius [m].
        length
            Length along z [m]. It is exact.
        material
            What the cylinder is made of.
        spacing
            Edge of a voxel [m], one length or three. Along z it is adjusted so that a whole number of voxels fits.
        voxels
            About how many voxels are inside, in place of `spacing`. The default is 20,000.

        Raises
        ------
        MjframesError
            If a length is not positive, if both `spacing` and `voxels` are given, if no voxel fits, or if the
            volume of all voxels is off by more than a quarter.
        """
        whole = cls._of_solid(cylinder(radius, length, spacing, voxels), material)
        grid = whole.origin, whole.spacing, whole.labels.shape
        return replace(whole, outline=cylinder_outline(float(radius), float(length), *grid))

    @classmethod
    def _of_solid(cls, solid: Solid, material: Material) -> Volume:
        labels, spacing, origin = solid
        if not isinstance(material, Material):
            raise MjframesError(
                f"material is {material!r}; it must be a Material, as Material.named('silicone-00-30')."
            )
        return cls(labels, spacing, origin, np.eye(3), {1: material})

    @property
    def centers(self) -> NDArray[np.float64]:
        """The centres (n, 3) of the voxels inside, in volume coordinates [m], in C order of their indices."""
        return self.origin + ((np.argwhere(self.labels > 0) + 0.5) * self.spacing) @ self.axes.T

    def __repr__(self) -> str:
        nx, ny, nz = self.labels.shape
        names = ", ".join(f"{label}: {self.materials[label].name or 'unnamed'}" for label in occurring(self.labels))
        size = " × ".join(f"{length * 1e3:.3g}" for length in self.labels.shape * self.spacing)
        return f"<Volume of {nx} × {ny} × {nz} voxels, {size} mm; {np.count_nonzero(self.labels)} inside; {names}>"

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the volume and its materials to a file. The file is complete or does not appear.

        Parameters
        ----------
        path
            File (.npz).

        Raises
        ------
        MjframesError
            For another file type, and if the file cannot be written.
        """
        path = Path(path)
        if path.suffix.lower() != ".npz":
            raise MjframesError(f"{path}: a volume is saved as .npz; give the path that ending.")
        arrays: dict[str, Any] = {"labels": self.labels, "spacing": self.spacing, "origin": self.origin}
        arrays |= {"axes": self.axes, "materials": write_materials(self.materials), "format_version": VOLUME_VERSION}
        arrays |= {} if self.outline is None else self.outline.arrays()
        with replacing(path, "the volume") as partial, partial.open("wb") as file:
            np.savez_compressed(file, **arrays)

    @telling_memory
    def resample(self, voxels: int) -> Volume:
        """Return the volume on a grid of cubes, each with the label at its centre.

        Parameters
        ----------
        voxels
            About how many voxels are inside.

        Raises
        ------
        MjframesError
            If a label would vanish.
        """
        require_voxels(voxels)
        inside = np.count_nonzero(self.labels) * np.prod(self.spacing)
        step = float(inside / voxels) ** (1 / 3)
        low, high = _box(self.labels)
        some = self.labels[tuple(map(slice, low, high))]
        extents = some.shape * self.spacing
        counts = np.maximum(1, np.rint(extents / step))
        if np.prod(counts) > MOST_CELLS:
            raise MjframesError(
                f"voxels is {voxels}, for which the grid around them would have {np.prod(counts):.1e} cells; "
                f"take less than {voxels * MOST_CELLS / np.prod(counts):.0e}."
            )
        places = []
        for a, count in enumerate(counts.astype(int)):
            centers = extents[a] / 2 + (np.arange(count) - (count - 1) / 2) * step
            places.append(np.clip((centers / self.spacing[a]).astype(int), 0, some.shape[a] - 1))
        labels = some[np.ix_(*places)]
        if lost := sorted(set(occurring(self.labels)) - set(occurring(labels))):
            raise MjframesError(f"label {lost[0]} has parts too thin for {voxels} voxels and vanishes; take more.")
        start = low * self.spacing + (extents - np.array(labels.shape) * step) / 2
        outline = self.outline
        if outline is not None:
            is_near = step > FINER * float(self.spacing.min())
            outline = outline.on(start / self.spacing, step / self.spacing, labels.shape) if is_near else None
        corner = self.origin + self.axes @ start
        return replace(self, labels=labels, spacing=np.full(3, step), origin=corner, outline=outline)

    def upright(self, up: str) -> Volume:
        """Return the volume turned about the origin so that what was along the axis `up` ("y", "-x", …) is along z.

        Many programs write meshes with y up, in MuJoCo it is z.
        """
        if up not in UP:
            raise MjframesError(f"up is {up!r}; it must be one of {', '.join(map(repr, UP))}.")
        if up == "z":
            return self
        turn = np.zeros((3, 3))
        turn[2, "xyz".index(up[-1])] = -1 if up[0] == "-" else 1
        turn[0] = [0, 1, 0] if up[-1] == "x" else [1, 0, 0]
        turn[1] = np.cross(turn[2], turn[0])
        return replace(self, axes=turn @ self.axes, origin=turn @ self.origin)

    def side(self, side: str, depth: float | None = None) -> NDArray[np.bool_]:
        """Return a mask (nx, ny, nz) of a slab of voxels at one side of the volume, for `mjframes.Fixed`.

        Parameters
        ----------
        side
            "x", "-x", "y", "-y", "z" or "-z": a direction of the volume's coordinates, not of the array.
        depth
            Thickness of the slab, from the outermost face inwards [m]. The default is one voxel.

        Raises
        ------
        MjframesError
            For another side, and for a slab that contains no centre of a voxel.
        """
        if side not in UP:
            raise MjframesError(f"side is {side!r}; it must be one of {', '.join(map(repr, UP))}.")
        direction = (-1.0 if side[0] == "-" else 1.0) * np.eye(3)["xyz".index(side[-1])]
        voxel = float(np.abs(direction @ self.axes) @ self.spacing)
        if depth is not None and not (is_number(depth) and depth >= 0.5 * voxel):
            raise MjframesError(
                f"depth is {depth!r}; it must be a length in metres, half a voxel or more, here {voxel / 2:g}."
            )
        height = self.centers @ direction
        face = float(height.max()) + 0.5 * voxel
        slab = face - (voxel if depth is None else depth) - 1e-9 * voxel
        return self._where(np.asarray(height >= slab))

    def in_box(self, lower: ArrayLike, upper: ArrayLike) -> NDArray[np.bool_]:
        """Return a mask (nx, ny, nz) of the voxels whose centres are in a box, for `mjframes.Fixed`.

        Parameters
        ----------
        lower, upper
            Corners (3,) in volume coordinates [m].

        Raises
        ------
        MjframesError
            For corners that are not three numbers, and for a box without a voxel.
        """
        low, high = _vector("lower", lower), _vector("upper", upper)
        centers = self.centers
        found = np.all((centers >= low) & (centers <= high), axis=1)
        if not found.any():
            ends = " to ".join(str(np.round(end, 6).tolist()) for end in (centers.min(axis=0), centers.max(axis=0)))
            raise MjframesError(
                f"the box from {low.tolist()} to {high.tolist()} holds no voxel; the voxels' centres are in {ends} m."
            )
        return self._where(found)

    def with_label(self, label: int) -> NDArray[np.bool_]:
        """Return a mask (nx, ny, nz) of the voxels with a label. Raise MjframesError where no voxel has it."""
        found = np.asarray(self.labels == label)
        if label < 1 or not found.any():
            known = ", ".join(map(str, occurring(self.labels)))
            raise MjframesError(f"label is {label!r}, which no voxel has; the labels are {known}.")
        return found

    def _where(self, chosen: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """A mask (nx, ny, nz) of the chosen (n,) of the voxels inside."""
        mask = np.asarray(self.labels > 0)
        mask[mask] = chosen
        return mask

    @telling_memory
    def filled(self, material: Material) -> Volume:
        """Return the volume with `material` in all of its convex hull that was outside: flesh around bones.

        It gets the label after the highest one, of those present and those with a material.
        """
        label = max(*occurring(self.labels), *self.materials) + 1
        if label > LARGEST_LABEL:
            raise MjframesError(f"the highest label is {label - 1}; the next, for what is filled, is too large.")
        labels = self.labels.astype(np.promote_types(self.labels.dtype, np.min_scalar_type(label)))
        labels[in_convex_hull(labels != 0) & (labels == 0)] = label
        return replace(self, labels=labels, materials=self.materials | {label: material}, outline=None)

    @telling_memory
    def largest_component(self) -> Volume:
        """Return the volume without all pieces but the one with the most voxels (26 neighbours)."""
        pieces, sizes = components(self.labels)
        return replace(self, labels=np.where(pieces == 1 + np.argmax(sizes), self.labels, 0).astype(self.labels.dtype))


def require_connected(volume: Volume) -> None:
    """Raise MjframesError unless the inside is one piece: no distance and no weight crosses a gap (26 neighbours)."""
    sizes = np.sort(components(volume.labels)[1])[::-1]
    if len(sizes) > 1:
        shown = ", ".join(map(str, sizes[:5])) + (", …" if len(sizes) > 5 else "")
        raise MjframesError(
            f"labels have {len(sizes)} unconnected pieces, sizes {shown} voxels; "
            "keep the largest with volume.largest_component() or --largest, fill what is between them with "
            "volume.filled(material) or --fill, or make a body of each piece of a mesh with mf.load_pieces or --pieces."
        )


def components(labels: NDArray[np.unsignedinteger | np.bool_]) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Return the piece (26 neighbours) of each voxel (nx, ny, nz), 0 outside and from 1 on inside, in the order of
    their first voxels, and the voxels of each piece (pieces,).
    """
    pieces = np.empty(labels.shape, np.int32)
    count = int(scipy.ndimage.label(labels != 0, structure=np.ones((3, 3, 3)), output=pieces))  # pyright: ignore[reportArgumentType]
    sizes = np.zeros(count + 1, np.int64)
    for slab in pieces:  # bincount makes an int64 copy: one slab at a time
        sizes += np.bincount(slab.ravel(), minlength=count + 1)
    return pieces, sizes[1:]


def occurring(labels: NDArray[np.unsignedinteger]) -> list[int]:
    """Return the labels of the voxels inside, ascending."""
    if labels.dtype.itemsize <= 2:
        seen = np.zeros(np.iinfo(labels.dtype).max + 1, bool)
        for slab in _slabs(labels):
            seen[slab] = True
        return (1 + np.flatnonzero(seen[1:])).tolist()
    found: set[int] = set()
    for slab in _slabs(labels):  # a slab at a time: sorting all of a large image needs as much memory again
        found.update(np.unique(slab[slab != 0]).tolist())
    return sorted(found)


def _slabs(array: NDArray[Any]) -> Iterator[NDArray[Any]]:
    """The slices of an array (nx, ny, nz) across the axis along which its memory is laid out."""
    return iter(np.moveaxis(array, int(np.argmax(np.abs(array.strides))), 0))


def _box(labels: NDArray[Any], known: set[int] | None = None) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Index (3,) of the first voxel inside along each axis and after the last; all where nothing is inside.

    known: labels that count as inside; all but 0 unless given.
    """
    along = int(np.argmax(np.abs(labels.strides)))
    used, shadow = np.zeros(labels.shape[along], bool), np.zeros(np.delete(labels.shape, along), bool)
    for k, slab in enumerate(_slabs(labels)):
        inside = slab != 0 if known is None else np.isin(slab, list(known))
        used[k] = inside.any()
        shadow |= inside
    places = [np.flatnonzero(some) for some in (shadow.any(axis=1), shadow.any(axis=0))]
    places.insert(along, np.flatnonzero(used))
    if not len(places[0]):
        return np.zeros(3, np.int64), np.array(labels.shape)
    return np.array([place[0] for place in places]), np.array([place[-1] + 1 for place in places])


def _check_materials(present: list[int], materials: Mapping[int, Material]) -> None:
    if not present:
        raise MjframesError("labels are all 0, which is outside; at least one voxel must have a positive label.")
    for label, material in materials.items():
        if not isinstance(label, (int, np.integer)) or label < 1 or not isinstance(material, Material):
            raise MjframesError(f"materials has {label!r}: {material!r}; it must map positive labels to Material.")
    if missing := [label for label in present if label not in materials]:
        raise MjframesError(_without_material(missing))


def _without_material(missing: list[int]) -> str:
    """What is wrong with labels that have no material, and what would be right."""
    if len(missing) > MANY:
        return (
            f"labels {', '.join(map(str, missing[:SHOWN]))}, … up to {missing[-1]}, {len(missing)} in all, have no "
            "material: is this a label image? Its values must number materials, not measure an intensity; segment it "
            "first, or leave out what has no material with drop_unknown=True or --drop-unknown."
        )
    which = f"label {missing[0]} has" if len(missing) == 1 else f"labels {', '.join(map(str, missing))} have"
    return (
        f"{which} no material; give one in materials={{label: Material(...)}} or with --material, "
        "or leave such voxels out with drop_unknown=True or --drop-unknown."
    )


def _array(labels: ArrayLike) -> NDArray[Any]:
    try:
        return np.asarray(labels)
    except ValueError as error:
        raise MjframesError("labels are rows of different lengths; they must be an (nx, ny, nz) array.") from error


def _require_labels(source: str, labels: NDArray[Any]) -> None:
    """Raise MjframesError for arrays of another shape and of what are no numbers."""
    if labels.ndim != 3:
        raise MjframesError(
            f"{source}labels have shape {labels.shape}; they must be an (nx, ny, nz) array of integers."
        )
    if labels.dtype.kind not in "biuf":
        raise MjframesError(f"{source}labels are {labels.dtype}; they must be integers, one material label per voxel.")
    if labels.size == 0:
        raise MjframesError(f"{source}labels have shape {labels.shape}; every side needs at least one voxel.")


def _shrink(source: str, labels: NDArray[Any]) -> NDArray[np.unsignedinteger]:
    """A copy of the labels in the smallest unsigned type that holds them."""
    np.empty(labels.shape, np.uint8)  # MemoryError before the labels are read, which may take minutes
    low, high = labels.min(), labels.max()
    if not (low >= 0 and high <= LARGEST_LABEL):  # so that NaN fails too
        raise MjframesError(
            f"{source}labels run from {low} to {high}; they must be integers from 0 (outside) to {LARGEST_LABEL}."
        )
    result = labels.astype(np.min_scalar_type(int(high)))
    if labels.dtype.kind == "f" and not np.array_equal(result, labels):
        value = labels[result != labels][0]
        raise MjframesError(
            f"{source}labels contain {value}; they must be integers, one material label per voxel. "
            "Is this a label image?"
        )
    return result


def _vector(name: str, value: ArrayLike) -> NDArray[np.float64]:
    try:
        vector = np.array(value, np.float64)
    except (TypeError, ValueError):
        vector = np.full(3, np.nan)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise MjframesError(f"{name} is {value!r}; it must be three coordinates in metres.")
    return vector


def _orthonormal(source: str, axes: NDArray[np.float64]) -> NDArray[np.float64]:
    """The nearest orthogonal matrix: headers hold rounded directions."""
    if axes.shape != (3, 3) or not np.isfinite(axes).all() or np.abs(axes.T @ axes - np.eye(3)).max() > ORTHOGONAL:
        raise MjframesError(
            f"{source}the directions of its index axes are {np.round(axes, 4).tolist()} (columns), which are not "
            "perpendicular unit vectors; resample the image to a grid without shear."
        )
    u, _, vt = np.linalg.svd(axes)
    return u @ vt
