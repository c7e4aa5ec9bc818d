"""Saved soft bodies: one compressed .npz with the arrays of `SoftBody`, ragged ones laid end to end."""

from __future__ import annotations

import json
import os
import zipfile
import zlib
from dataclasses import asdict

import numpy as np
from scipy import sparse

from mjframes.body import ContactSpheres, Skin, SoftBody
from mjframes.constants import FORMAT_VERSION, KIND
from mjframes.control import ControlPoints
from mjframes.errors import MjframesError
from mjframes.fields import pack_fields, unpack_fields
from mjframes.files import replacing
from mjframes.lattice import Lattice
from mjframes.material import Material
from mjframes.quadrature import Quadrature
from mjframes.stiffness import Stiffness
from mjframes.whole_body.cells import Cells
from mjframes.whole_body.error import BodyError

LATTICE = ("spacing", "origin", "shape", "node", "distance", "patch", "spheres")  # and its weights


def save(body: SoftBody, path: str | os.PathLike[str]) -> None:
    """Write `body` to an .npz file. Raises MjframesError where that cannot be done."""
    stiffness = body.stiffness
    arrays = {
        "kind": np.array(KIND),
        "version": np.array(FORMAT_VERSION),
        "parent": body.parent,
        "types": np.array(body.types),
        "links": np.array(body.links, str),
        "mode": np.array(body.mode),
        "law": np.array(body.law),
        "law_constants": body.law_constants,
        "mass_difference": np.concatenate([np.zeros(0), *map(lower_triangle, body.mass_difference)]),
        "control_frame": body.control.frame,
        "control_rest": body.control.rest,
        "control_mass": body.control.mass,
        "control_basis": body.control.basis,
        "control_center": body.control.center,
        "control_scale": body.control.scale,
        "control_axes": body.control.axes,
        "region_size": np.array([len(points) for points in stiffness.points]),
        "region_points": np.concatenate(stiffness.points),
        "region_gradient": np.concatenate(stiffness.gradient),
        "region_matrix": np.concatenate([lower_triangle(matrix) for matrix in stiffness.matrix]),
        "region_volume": stiffness.volume,
        "skin_vertices": body.skin.vertices,
        "skin_faces": body.skin.faces,
        "skin_label": body.skin.label,
        "contact_centers": body.contact.centers,
        "contact_radius": np.array(body.contact.radius),
        "contact_patch": body.contact.patch,
        "contact_cluster": body.contact.cluster,
        **{f"lattice_{name}": np.asarray(getattr(body.lattice, name)) for name in LATTICE},
        "damping": np.array(body.damping),
        "voxels": np.array(body.voxels),
        "materials": np.array(json.dumps({label: asdict(m) for label, m in body.materials.items()})),
    }
    if stiffness.fallback:
        arrays["region_fallback"] = np.concatenate(stiffness.fallback)
    if body.cells is not None:
        arrays |= packed_cells(body.cells)
    if body.quadrature is not None:
        arrays |= _packed_quadrature(body.quadrature)
    for name, weights in (
        ("skin", body.skin.weights),
        ("contact", body.contact.weights),
        ("lattice", body.lattice.weights),
    ):
        arrays |= {f"{name}_weight": weights.data, f"{name}_index": weights.indices, f"{name}_row": weights.indptr}
    if body.error is not None:
        weight = np.nan if body.error.weight is None else body.error.weight
        arrays["body_error"] = np.array([weight, body.error.pushes])
    arrays |= pack_fields(body.fields)
    with replacing(path, "the soft body") as partial, open(partial, "wb") as file:
        np.savez_compressed(file, **arrays)


def is_soft_body(path: str | os.PathLike[str]) -> bool:
    """Whether a file is a saved soft body, of whatever version."""
    try:
        with zipfile.ZipFile(path) as archive, archive.open("kind.npy") as file:
            return str(np.lib.format.read_array(file, allow_pickle=False)) == KIND
    except (OSError, KeyError, zipfile.BadZipFile, zlib.error, ValueError, EOFError):
        return False


def load(path: str | os.PathLike[str]) -> SoftBody:
    """Read a soft body. Raises MjframesError for files that are missing, damaged, of another kind or version."""
    arrays = _read(path)
    try:
        return _restored(arrays)
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise MjframesError(f"{path}: arrays of the soft body are missing or damaged; build it again.") from error


def _restored(arrays: dict[str, np.ndarray]) -> SoftBody:
    points = len(arrays["control_frame"])

    def weights(name: str) -> sparse.csr_array:
        parts = (arrays[f"{name}_weight"], arrays[f"{name}_index"], arrays[f"{name}_row"])
        return sparse.csr_array(parts, shape=(len(parts[2]) - 1, points))

    size = arrays["region_size"]
    ends = np.cumsum(size)[:-1]
    materials = {
        int(label): Material(**{**m, "rgba": tuple(m["rgba"])})
        for label, m in json.loads(str(arrays["materials"])).items()
    }
    return SoftBody(
        parent=arrays["parent"],
        types=tuple(map(str, arrays["types"])),
        links=tuple(map(str, arrays["links"])),
        control=ControlPoints(
            **{
                name: arrays[f"control_{name}"]
                for name in ("frame", "rest", "mass", "basis", "center", "scale", "axes")
            }
        ),
        stiffness=Stiffness(
            points=tuple(np.split(arrays["region_points"], ends)),
            gradient=tuple(np.split(arrays["region_gradient"], ends)),
            matrix=triangles(arrays["region_matrix"], 3 * size),
            volume=arrays["region_volume"],
            fallback=tuple(np.split(arrays["region_fallback"], ends)) if "region_fallback" in arrays else (),
        ),
        mass_difference=triangles(arrays["mass_difference"], size),
        mode=str(arrays["mode"]),
        law=str(arrays["law"]),
        law_constants=arrays["law_constants"],
        cells=_restored_cells(arrays, size),
        quadrature=_restored_quadrature(arrays, np.split(arrays["region_points"], ends)),
        skin=Skin(arrays["skin_vertices"], arrays["skin_faces"], arrays["skin_label"], weights("skin")),
        contact=ContactSpheres(
            arrays["contact_centers"],
            float(arrays["contact_radius"]),
            arrays["contact_patch"],
            arrays["contact_cluster"],
            weights("contact"),
        ),
        lattice=Lattice(
            spacing=float(arrays["lattice_spacing"]),
            weights=weights("lattice"),
            **{name: arrays[f"lattice_{name}"] for name in LATTICE if name != "spacing"},
        ),
        materials=materials,
        damping=(float(arrays["damping"][0]), float(arrays["damping"][1])),
        voxels=int(arrays["voxels"]),
        error=_restored_error(arrays),
        fields=unpack_fields(arrays, materials, points, size),
    )


def _restored_error(arrays: dict[str, np.ndarray]) -> BodyError | None:
    if "body_error" not in arrays:
        return None
    weight, pushes = arrays["body_error"].tolist()
    return BodyError(None if np.isnan(weight) else weight, pushes)


def packed_cells(cells: Cells) -> dict[str, np.ndarray]:
    """The arrays of the cells, ragged ones laid end to end."""
    return {
        "cell_count": np.array([len(volume) for volume in cells.volume]),
        "cell_volume": np.concatenate(cells.volume),
        "cell_material": np.concatenate(cells.material),
        "cell_slope": np.concatenate([slope.ravel() for slope in cells.slope]),
        "cell_remainder": np.concatenate([lower_triangle(matrix) for matrix in cells.remainder]),
    }


def _restored_cells(arrays: dict[str, np.ndarray], size: np.ndarray) -> Cells | None:
    if "cell_count" not in arrays:
        return None
    count = arrays["cell_count"]
    ends = np.cumsum(count)[:-1]
    return Cells(
        volume=tuple(np.split(arrays["cell_volume"], ends)),
        material=tuple(np.split(arrays["cell_material"], ends)),
        slope=cell_slopes(arrays["cell_slope"], count, size),
        remainder=triangles(arrays["cell_remainder"], 3 * size),
    )


def cell_slopes(values: np.ndarray, count: np.ndarray, size: np.ndarray) -> tuple[np.ndarray, ...]:
    """E_q (q, 9, 3m) of each region from all of them end to end. count, size: (r,) cells and control points."""
    parts = np.split(values, np.cumsum(27 * count * size)[:-1])
    return tuple(part.reshape(-1, 9, 3 * int(m)) for part, m in zip(parts, size, strict=True))


def _packed_quadrature(quadrature: Quadrature) -> dict[str, np.ndarray]:
    return {
        "quadrature_count": np.array([len(volume) for volume in quadrature.volume]),
        "quadrature_position": np.concatenate(quadrature.position),
        "quadrature_volume": np.concatenate(quadrature.volume),
        "quadrature_gradient": np.concatenate([gradient.ravel() for gradient in quadrature.gradient]),
        "quadrature_material": np.concatenate(quadrature.material),
    }


def _restored_quadrature(arrays: dict[str, np.ndarray], points: list[np.ndarray]) -> Quadrature | None:
    if "quadrature_count" not in arrays:
        return None
    count = arrays["quadrature_count"]
    ends = np.cumsum(count)[:-1]
    lengths = [3 * int(q) * len(some) for q, some in zip(count, points, strict=True)]
    gradients = np.split(arrays["quadrature_gradient"], np.cumsum(lengths)[:-1])
    return Quadrature(
        points=tuple(points),
        position=tuple(np.split(arrays["quadrature_position"], ends)),
        volume=tuple(np.split(arrays["quadrature_volume"], ends)),
        gradient=tuple(g.reshape(-1, len(some), 3) for g, some in zip(gradients, points, strict=True)),
        material=tuple(np.split(arrays["quadrature_material"], ends)),
    )


def lower_triangle(matrix: np.ndarray) -> np.ndarray:
    """(n (n + 1) / 2,) the lower triangle of a symmetric (n, n) matrix, row by row."""
    return matrix[np.tril_indices(len(matrix))]


def triangles(values: np.ndarray, size: np.ndarray) -> tuple[np.ndarray, ...]:
    """The symmetric matrices whose lower triangles stand one after the other in `values`; none for none."""
    if not len(values):
        return ()
    parts = np.split(values, np.cumsum(size * (size + 1) // 2)[:-1])
    return tuple(_symmetric(lower, int(n)) for lower, n in zip(parts, size, strict=True))


def _symmetric(lower: np.ndarray, n: int) -> np.ndarray:
    matrix = np.zeros((n, n))
    rows, columns = np.tril_indices(n)
    matrix[rows, columns] = lower
    matrix[columns, rows] = lower
    return matrix


def _read(path: str | os.PathLike[str]) -> dict[str, np.ndarray]:
    """All arrays of the file, after the checks that make them trustworthy."""
    try:
        with np.load(path, allow_pickle=False) as file:
            # reading all of them checks the archive's checksums
            arrays = {name: file[name] for name in file.files}
    except OSError as error:
        raise MjframesError(f"{path}: the soft body cannot be read ({error.strerror or error}).") from error
    except (zipfile.BadZipFile, zlib.error, ValueError, EOFError, AttributeError, TypeError) as error:
        raise MjframesError(f"{path}: the file is truncated or damaged or no soft body; build it again.") from error
    if str(arrays.get("kind", "")) != KIND:
        raise MjframesError(
            f"{path}: this .npz holds no soft body; give one that mjframes build or SoftBody.save wrote."
        )
    version = int(arrays.get("version", 0))
    if version != FORMAT_VERSION:
        raise MjframesError(
            f"{path}: the soft body has format version {version}, this mjframes reads {FORMAT_VERSION}; build it again."
        )
    return arrays
