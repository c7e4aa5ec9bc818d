"""The plugin instance's attributes: a soft body as the text that plugin/parse.cc reads."""

from __future__ import annotations

import base64
from collections.abc import Sequence

import numpy as np
from scipy import sparse

from mjframes.base.choices import COROTATIONAL
from mjframes.base.constants import FORMAT_VERSION
from mjframes.base.packing import lower_triangle
from mjframes.body.soft_body import SoftBody
from mjframes.elasticity.mass import uncoupled
from mjframes.elasticity.quadrature import Quadrature
from mjframes.elasticity.stiffness import shows_rotations
from mjframes.scene.carriers import Carrier
from mjframes.scene.patches import Patch
from mjframes.scene.rounding import in_units
from mjframes.whole_body.cells import Cells

# fmt: off
ATTRIBUTES = (  # in the plugin's order, which is that of the compiled model
    "version", "law", "mode", "alpha", "beta", "carrier_size", "carrier_point", "point_offset", "point_rest",
    "point_mass", "point_branch", "region_size", "region_point", "region_gradient", "region_stiffness",
    "region_stiffens", "materials", "region_own", "region_share", "law_constants", "law_factor", "quadrature_count",
    "quadrature_volume", "quadrature_material", "quadrature_gradient", "cell_count", "cell_volume", "cell_material",
    "cell_slope", "region_mass", "region_enlargement", "contact_reach", "patch_size", "patch_clusters",
    "patch_cluster_size", "patch_point", "patch_weight", "patch_offset", "patch_dent", "patch_factor",
    "lattice_spacing", "lattice_axes", "lattice_origin", "lattice_shape", "lattice_node", "lattice_distance",
    "lattice_patch", "lattice_set", "set_size", "set_point", "lattice_weight", "lattice_vertex", "lattice_normal",
    "asset",
)
# fmt: on
TYPES = {"i8": "<i1", "i16": "<i2", "i32": "<i4", "f32": "<f4", "f64": "<f8"}  # of arrays
SEPARATOR = ":"  # in the names of what belongs to a soft body, and in no name of one
LARGEST_WEIGHT = np.iinfo(np.int16).max - 1  # of a node of the lattice, in units, before it is rounded
LARGEST_NORMAL = 127  # a normal's length as 8 bits say it
ROUNDING = 1e-9  # [-] of the body's size: an offset of a contact vertex that is no offset


def configuration(
    body: SoftBody,
    key: str,
    carried: Sequence[Carrier],
    branch: np.ndarray,
    patches: Sequence[Patch],
    dents: bool,
) -> dict[str, str]:
    """Return what the plugin reads, by key.

    key: which built body it is.

    carried: in the order of the model's bodies.  branch: (k,) of the kinematic tree, 0 where it is the soft body's.

    patches: in the order of the model's geoms; none for no contact.  dents: whether contacts make dents.
    """
    stiffness, control = body.stiffness, body.control
    rest, offset, mass = control.rest.copy(), np.zeros_like(control.rest), np.zeros(len(control.mass))
    for carrier in carried:
        mass[carrier.points] = carrier.mass / len(carrier.points)
        if carrier.joints == "slides":  # as the bodies have it, digits lost: from any other a stiff body is strained
            rest[carrier.points] = carrier.pose[1]
        else:
            offset[carrier.points] = carrier.local(rest[carrier.points])
    values = {
        "version": str(FORMAT_VERSION),
        "law": body.law,
        "mode": body.mode,
        "alpha": repr(body.damping[0]),
        "beta": repr(body.damping[1]),
        "carrier_size": encode([len(carrier.points) for carrier in carried]),
        "carrier_point": encode(np.concatenate([carrier.points for carrier in carried])),
        "point_rest": encode(rest),
        "point_mass": encode(mass),
        "region_size": encode([len(points) for points in stiffness.points]),
        "region_point": encode(np.concatenate(stiffness.points)),
        "asset": key,
    }
    values |= _hyperelastic(body, body.quadrature, rest) if body.quadrature else _corotational(body, rest)
    if body.cells:
        values |= _cells(body, body.cells)
    if len(body.deformable) > 1:
        values |= _materials(body)
    if offset.any():
        values["point_offset"] = encode(offset)
    if branch.any():
        values["point_branch"] = encode(branch)
        values["region_enlargement"] = encode(np.array([enlargement(branch[p]) for p in stiffness.points]))
    if body.mass_difference:
        parts = zip(body.mass_difference, stiffness.points, strict=True)
        values["region_mass"] = encode(np.concatenate([lower_triangle(uncoupled(D, branch[p])) for D, p in parts]))
    return values | (_contact(body, patches, dents) if patches else {})


def _corotational(body: SoftBody, rest: np.ndarray) -> dict[str, str]:
    stiffness = body.stiffness
    matrices = body.cells.remainder if body.cells else stiffness.matrix
    gradients = [
        shows_rotations(gradient, rest[points])
        for points, gradient in zip(stiffness.points, stiffness.gradient, strict=True)
    ]
    values = {
        "region_gradient": encode(np.concatenate(gradients)),
        "region_stiffness": encode(np.concatenate([lower_triangle(matrix) for matrix in matrices])),
    }
    if body.law == COROTATIONAL and body.error is not None:  # the paper's method is as the paper has it
        values["region_stiffens"] = "1"
    return values


def _materials(body: SoftBody) -> dict[str, str]:
    """What each material has of the stiffness."""
    values = {"materials": str(len(body.deformable))}
    if body.law != COROTATIONAL:
        values["law_factor"] = encode(body.factor_of)
    if body.quadrature:
        return values
    shares = body.cells.shares if body.cells else body.stiffness.shares
    return values | {
        "region_own": encode([some.shape[1] // 3 for some in shares]),
        "region_share": encode(np.concatenate([lower_rows(some) for some in shares])),
    }


def lower_rows(rows: np.ndarray) -> np.ndarray:
    """Return the last rows (p, o, n) of p symmetric matrices (n, n), each up to the diagonal, end to end."""
    own, n = rows.shape[1:]
    return rows[:, np.tri(own, n, n - own, dtype=bool)].ravel()


def rows_of(lower: np.ndarray, count: int, own: int, n: int) -> np.ndarray:
    """Return the rows (count, own, n) of what `lower_rows` returned."""
    rows = np.zeros((count, own, n))
    rows[:, np.tri(own, n, n - own, dtype=bool)] = lower.reshape(count, -1)
    square = rows[:, :, n - own :]
    square += np.tril(square, -1).transpose(0, 2, 1)
    return rows


def _cells(body: SoftBody, cells: Cells) -> dict[str, str]:
    return {
        "law_constants": encode(body.law_constants),
        "cell_count": encode([len(volume) for volume in cells.volume]),
        "cell_volume": encode(np.concatenate(cells.volume)),
        "cell_material": encode(np.concatenate(cells.material).astype(int)),
        "cell_slope": encode(np.concatenate([slope.ravel() for slope in cells.slope])),
    }


def decode_slopes(text: str, count: np.ndarray, size: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return E_q (q, 9, 3m) of each region's cells.  count, size: (r,) cells and control points."""
    parts = np.split(decode(text), np.cumsum(27 * count * size)[:-1])
    return tuple(part.reshape(-1, 9, 3 * int(m)) for part, m in zip(parts, size, strict=True))


def _hyperelastic(body: SoftBody, quadrature: Quadrature, rest: np.ndarray) -> dict[str, str]:
    gradients = [
        shows_rotations(at_point, rest[points]).ravel()
        for points, gradient in zip(quadrature.points, quadrature.gradient, strict=True)
        for at_point in gradient
    ]
    return {
        "law_constants": encode(body.law_constants),
        "quadrature_count": encode([len(volume) for volume in quadrature.volume]),
        "quadrature_volume": encode(np.concatenate(quadrature.volume)),
        "quadrature_material": encode(np.concatenate(quadrature.material).astype(int)),
        "quadrature_gradient": encode(np.concatenate(gradients)),
    }


def enlargement(branch: np.ndarray) -> float:
    """Return that of a region's stiffness where its points, on these branches, couple beyond MuJoCo's inertia.

    K ⪯ n blockdiag(K) for n branches, and the step is stable while K ⪯ 4/3 of what is held.
    """
    return max(1.0, 0.75 * len(np.unique(branch)))


def weight_attributes(weights: sparse.csr_array) -> dict[str, str]:
    """Return what the plugin reads of the control weights (n, k) of points, point by point."""
    return {
        "weight_size": encode(np.diff(weights.indptr)),
        "weight_point": encode(weights.indices),
        "weight": encode(weights.data),
    }


def _contact(body: SoftBody, patches: Sequence[Patch], dents: bool) -> dict[str, str]:
    weights = body.contact.weights.toarray()
    sizes = [np.bincount(body.contact.cluster[patch.vertices]) for patch in patches]
    values = {
        "contact_reach": repr(body.contact.reach),
        "patch_size": encode([len(patch.points) for patch in patches]),
        "patch_clusters": encode([len(clusters) for clusters in sizes]),
        "patch_cluster_size": encode(np.concatenate(sizes)),
        "patch_point": encode(np.concatenate([patch.points for patch in patches])),
        "patch_weight": encode(
            np.concatenate([weights[np.ix_(patch.vertices, patch.points)].T.ravel() for patch in patches])
        ),
    }
    if dents:
        values |= _dents(body, patches)
    offset = body.contact.positions - body.contact.weights @ body.control.rest
    if np.abs(offset).max() > ROUNDING * np.ptp(body.contact.positions, axis=0).max():
        # the deformed volume is not Σ_j W_j x_j: such a body touches with its vertices only
        values["patch_offset"] = encode(np.concatenate([offset[patch.vertices].T.ravel() for patch in patches]))
        return values
    return values | _distance_field(body, patches)


def _dents(body: SoftBody, patches: Sequence[Patch]) -> dict[str, str]:
    """The dents below each vertex: width [m], softness [1/√Pa], thickness [m], and which factor they follow."""
    below, vertices = body.contact.dents, np.concatenate([patch.vertices for patch in patches])
    values = np.column_stack([below.width, below.softness, below.thickness])[vertices]
    factors = body.factor_of[below.material[vertices]]
    return {"patch_dent": encode(values), "patch_factor": encode(factors)}


def _distance_field(body: SoftBody, patches: Sequence[Patch]) -> dict[str, str]:
    field = body.distance_field
    number = np.empty(len(patches), int)  # of each patch of the body among those of the model
    number[[body.contact.patch[patch.vertices[0]] for patch in patches]] = np.arange(len(patches))
    largest = np.abs(field.weights.toarray()).max(axis=1)
    weights = in_units(field.weights, LARGEST_WEIGHT // largest).toarray()
    moved = weights != 0
    _, of_set, in_set = np.unique(np.packbits(moved, axis=1), axis=0, return_index=True, return_inverse=True)
    sets = [np.flatnonzero(moved[node]) for node in of_set]
    return {
        "lattice_spacing": repr(field.spacing),
        "lattice_axes": encode(body.fields.volume.axes),
        "lattice_origin": encode(field.origin),
        "lattice_shape": encode(field.shape),
        "lattice_node": encode(field.node),
        "lattice_distance": encode(field.distance.astype(np.float32)),
        "lattice_patch": encode(number[field.patch]),
        "lattice_set": encode(in_set),
        "set_size": encode([len(points) for points in sets]),
        "set_point": encode(np.concatenate(sets)),
        "lattice_weight": encode(weights[moved]),
        "lattice_vertex": encode(
            np.concatenate([field.vertices[patch.vertices] for patch in patches], dtype=np.float32)
        ),
        "lattice_normal": encode(
            np.concatenate([np.rint(LARGEST_NORMAL * body.contact.normals[some.vertices]) for some in patches]).astype(
                int
            )
        ),
    }


def instance_name(name: str) -> str:
    """Return the name of a soft body's plugin instance: its own, unless that is one letter.

    One letter gets a separator, as MuJoCo must attach something to it.
    """
    return name if len(name) > 1 else name + SEPARATOR


def soft_name(instance: str) -> str:
    """Return the name of the soft body whose plugin instance is called so."""
    return instance.removesuffix(SEPARATOR)


def encode(values: np.ndarray | Sequence[int]) -> str:
    """Return an array as the plugin reads it: type, count and base64 of the little-endian values.

    Integers get the smallest type that holds them, float32 stays that, all others are float64.
    """
    array = np.ravel(values)
    if np.issubdtype(array.dtype, np.integer):
        kind = next(kind for kind in ("i8", "i16", "i32") if _fits(array, TYPES[kind]))
    else:
        kind = "f32" if array.dtype == np.float32 else "f64"
    return f"{kind}:{array.size}:{base64.b64encode(array.astype(TYPES[kind]).tobytes()).decode('ascii')}"


def decode(text: str) -> np.ndarray:
    """Return the values (count,) of what `encode` wrote, as the plugin has them: int32 or float64."""
    kind, _, data = text.split(":")
    return np.frombuffer(base64.b64decode(data), TYPES[kind]).astype(np.int32 if kind[0] == "i" else np.float64)


def _fits(array: np.ndarray, kind: str) -> bool:
    limits = np.iinfo(kind)
    return not array.size or bool(array.min() >= limits.min and array.max() <= limits.max)
