"""Surface meshes from files, made fit to tell inside from outside: p is inside where its winding number w(p) > ½.

w(p) = Σ_t Ω_t(p) / 4π, Ω_t the signed solid angle of triangle t seen from p. For a closed surface w is an integer,
for an open one a smooth guess at it (Jacobson et al. 2013, "generalized winding number"). What that makes of imperfect
surfaces is the policy here, and each case is said in a notice:

- equal vertices are merged; repeated triangles count once, and two of opposite orientation cancel;
- a shell (connected triangles) whose triangles disagree about their outer side is made consistent and turned outwards;
- a shell that is inside out is turned, with all it encloses. A shell within another keeps its orientation relative to
  that one: the opposite one is a cavity, the same one is more of the solid;
- parts that overlap count once; parts that a self-intersection turns inside out (w < 0) are outside;
- holes are closed by the surface where w = ½.

Refused: meshes without triangles, flat ones, and loose triangles that enclose nothing.
First stage of the pipeline (the paper, §4, voxelizes closed surfaces), before `voxelize.py`. All is SI.
"""

from __future__ import annotations

import contextlib
import io
import math
import os
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import scipy.sparse.csgraph
from numpy.typing import NDArray

from mjframes.base.errors import MjframesError, Notice, reason
from mjframes.base.packages import optional

if TYPE_CHECKING:
    import trimesh

MeshLike: TypeAlias = "str | os.PathLike[str] | trimesh.Trimesh | trimesh.Scene"
SURFACE_TYPES = (".obj", ".stl", ".ply", ".off", ".glb", ".gltf", ".3mf")  # that trimesh reads
SOLID_TYPES = (".msh", ".vtu", ".vtk", ".mesh", ".inp", ".xdmf")  # of tetrahedra and bricks, that meshio reads
MESH_TYPES = (*SURFACE_TYPES, *SOLID_TYPES)
TETRA, BRICK = (
    ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)),
    ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)),
)
WEDGE = ((0, 2, 1), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5))
PIECE = "mjframes piece"  # in the metadata of a trimesh object: what messages call it
# the outward faces of solid elements by meshio's names, corners only: those of second order have them first
SIDES = {"tetra": TETRA, "tetra10": TETRA, "hexahedron": BRICK, "hexahedron20": BRICK, "hexahedron27": BRICK}
SIDES |= {"wedge": WEDGE}
FLAT_SIDES = {"triangle": ((0, 1, 2),), "triangle6": ((0, 1, 2),), "quad": ((0, 1, 2, 3),)}
MERGE = 1e-6  # [-] of the mesh's diagonal: nearer vertices are the same, exporters round to about 1e-7
FLAT = 1e-5  # [-] smallest to largest extent of a mesh that has no inside
UNDECIDED = 0.25  # [-] distance of w from an integer beyond which it says little; share of such places that is too much
PROBES = 20  # a side of the mesh's box, for places to look at
MIXED = "the surface has triangles of mixed orientation"
WITNESSES = 16  # [-] vertices that all must lie within another shell for a shell to be a cavity


class MeshWarning(Notice):
    """A surface has a fault; the warning says which one and what was done about it."""


@dataclass(frozen=True, eq=False)
class MeshSurface:
    """An oriented triangle mesh, normals outwards.

    name: file or number, for messages.
    vertices: (n, 3) [m].
    faces: (m, 3) int64.
    notices: (k,) sentences about what was wrong and what was done.
    open_edges: how many edges have no other side; 0 for a closed surface.
    """

    name: str
    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    notices: tuple[str, ...] = ()

    @cached_property
    def open_edges(self) -> int:
        return len(_open_edges(self.faces)[0])


def load_surface(source: MeshLike, name: str, scale: float | None) -> MeshSurface:
    """Return the surface in a file (MESH_TYPES) or a trimesh object, cleaned as the module's text says.

    name: what messages call it where it is no file.  scale: [m] that one unit of the mesh is long, None for the unit
    that it has, or else metres.
    Raise MjframesError if the file is missing, unreadable or of another type, or if the mesh cannot have an inside.
    """
    if isinstance(source, (str, os.PathLike)):
        name = os.fspath(source)
        points, triangles = _read(Path(source), scale)
    else:
        points, triangles = _arrays(name, source, scale)
    if not np.isfinite(points).all() or (len(triangles) and not 0 <= triangles.min() <= triangles.max() < len(points)):
        raise MjframesError(f"{name}: it has vertices that are no points in space; export the mesh anew.")
    points, triangles = _merge(points, triangles)
    if len(triangles) == 0:
        raise MjframesError(f"{name}: there are no triangles in it; a volume needs a closed surface.")
    _refuse_flat(name, points)

    notices = []
    triangles, dropped = _drop_repeated(triangles)
    if dropped:
        notices.append(f"{name}: {_count(dropped, 'repeated triangle')} dropped.")
    shell = shells_of(len(points), triangles)
    triangles, mixed = _make_consistent(name, triangles, shell)
    if mixed.any():
        which = f"{mixed.sum()} of {len(mixed)} shells have" if len(mixed) > 1 else "it has"
        notices.append(f"{name}: {which} triangles of mixed orientation; they were made consistent.")
    turned = _inside_out(points, triangles, shell, mixed)
    triangles = np.where(turned[shell][:, None], triangles[:, ::-1], triangles)
    if (turned & ~mixed).any():
        which = f"{(turned & ~mixed).sum()} of {len(turned)} shells are" if len(turned) > 1 else "it is"
        notices.append(f"{name}: {which} inside out; the triangles were turned.")
    surface = MeshSurface(name, points, triangles, tuple(notices))
    if surface.open_edges == 0:
        return surface
    _refuse_loose(surface)
    text = (
        f"{name}: the surface is not watertight ({_count(surface.open_edges, 'open edge')}, {len(triangles)} triangles)"
    )
    text += "; inside is where its generalized winding number exceeds 1/2, which closes the holes."
    return replace(surface, notices=(*notices, text))


def mesh_name(source: MeshLike, number: int) -> str:
    """Return what messages call a mesh that is no file: the piece of a file that it is, or else its number."""
    return getattr(source, "metadata", {}).get(PIECE) or f"mesh {number}"


def mesh_contents(source: MeshLike, name: str, scale: float | None) -> tuple[object, ...]:
    """Return all of `source` that `load_surface` depends on, for `mjframes.base.cache`.

    That is path and contents, or name and arrays.

    name, scale: as of `load_surface`.

    Raise MjframesError for what is neither.
    """
    if isinstance(source, (str, os.PathLike)):
        return os.fspath(source), Path(source)  # messages have the path
    return name, *_arrays(name, source, scale)


def lids(surface: MeshSurface) -> MeshSurface:
    """Return what closes an open surface: for each hole the cone from its edge to its middle.

    MeshSurface and lids together are closed, so w = w_together − w_lids has an integer and few triangles to sum over.
    """
    tail, head, balance = _open_edges(surface.faces)
    n = len(surface.vertices)
    links = scipy.sparse.coo_array((np.ones(len(tail), bool), (tail, head)), (n, n))
    hole = scipy.sparse.csgraph.connected_components(links, directed=False)[1][tail]
    hole = np.unique(hole, return_inverse=True)[1]
    center = (surface.vertices[tail] + surface.vertices[head]) / 2
    middle = np.stack([np.bincount(hole, center[:, x]) for x in range(3)], axis=1) / np.bincount(hole)[:, None]
    triangles = np.stack([head, tail, n + hole], axis=1)
    return MeshSurface(
        surface.name, np.concatenate([surface.vertices, middle]), np.repeat(triangles, balance, axis=0), ()
    )


def import_igl(name: str, fault: str = "the surface is not watertight") -> Any:
    """Return libigl, for surfaces with a fault.  Raise MjframesError that names it and says how to get libigl."""
    return optional("igl", f"{name}: {fault} and", "meshes", "libigl", instead="repair it")


def winding_number(points: NDArray[np.float64], triangles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return w (q,) at points (q, 3) of triangles (m, 3, 3), by the sum over all (van Oosterom and Strackee 1983)."""
    w = np.empty(len(points))
    for q, point in enumerate(points):
        a, b, c = np.moveaxis(triangles - point, 1, 0)
        la, lb, lc = (np.linalg.norm(corner, axis=1) for corner in (a, b, c))
        above = np.einsum("mx,mx->m", a, np.cross(b, c))
        dot_ab, dot_bc, dot_ca = (np.einsum("mx,mx->m", u, v) for u, v in ((a, b), (b, c), (c, a)))
        w[q] = np.arctan2(above, la * lb * lc + dot_ab * lc + dot_bc * la + dot_ca * lb).sum() / (2 * math.pi)
    return w


def open_scene(path: Path, **options: Any) -> trimesh.Scene:
    """Return what trimesh reads in a file of SURFACE_TYPES.

    Raise MjframesError if it is missing or damaged, or if a package that reads it is not installed.
    """
    from mjframes.base.trimeshes import trimesh

    _require_file(path)
    if path.suffix.lower() == ".obj":
        options["skip_materials"] = True
    if path.suffix.lower() == ".3mf":
        for name in ("lxml", "networkx"):
            optional(name, f"{path}: reading it", "meshes")
    try:
        return trimesh.load_scene(path, process=False, **options)
    except Exception as error:  # a damaged file can fail anywhere in five foreign readers
        raise MjframesError(f"{path}: the file is damaged, truncated or not of its type ({reason(error)}).") from error


def _require_file(path: Path) -> None:
    if not path.is_file():
        raise MjframesError(f"{path}: there is no such file; a mesh is a trimesh object or the path of a mesh file.")


def _read(path: Path, scale: float | None) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    kind = path.suffix.lower()
    if kind not in MESH_TYPES:
        raise MjframesError(f"{path}: meshes of type {kind or 'none'} cannot be read; give {', '.join(MESH_TYPES)}.")
    if kind in SURFACE_TYPES:
        return _arrays(str(path), open_scene(path), scale)
    points, triangles = _outside(path)
    return points * (scale or 1.0), triangles


def _outside(path: Path) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The faces that one solid element has and no other, or, where there are no solids, the triangles."""
    _require_file(path)
    meshio = optional("meshio", f"{path}: reading it", "meshes")
    try:
        with contextlib.redirect_stdout(io.StringIO()):  # meshio prints what it finds odd
            mesh = meshio.read(path)
    except (Exception, SystemExit) as error:  # meshio ends the process where it finds no reader
        raise MjframesError(f"{path}: the file is damaged, truncated or not of its type ({reason(error)}).") from error
    solids = [(SIDES[cell.type], cell.data) for cell in mesh.cells if cell.type in SIDES]
    plane = [(FLAT_SIDES[cell.type], cell.data) for cell in mesh.cells if cell.type in FLAT_SIDES]
    faces = [data[:, side] for sides, data in solids or plane for side in sides]
    if not faces:
        return np.zeros((0, 3)), np.zeros((0, 3), np.int64)
    triangles = []
    for corners in (3, 4):
        some = [face for face in faces if face.shape[1] == corners]
        if not some:
            continue
        every = np.concatenate(some).astype(np.int64)
        if solids:
            _, first, count = np.unique(np.sort(every, axis=1), axis=0, return_index=True, return_counts=True)
            every = every[first[count == 1]]
        triangles += [every[:, [0, i, i + 1]] for i in range(1, corners - 1)]
    points = np.zeros((len(mesh.points), 3))
    points[:, : mesh.points.shape[1]] = mesh.points
    return points, np.concatenate(triangles)


def _arrays(name: str, mesh: object, scale: float | None) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Vertices (n, 3) [m] and faces (m, 3) of one mesh or of all in a scene, placed as its nodes say."""
    from mjframes.base.trimeshes import trimesh

    if isinstance(mesh, trimesh.Scene):
        parts = [part for part in mesh.dump() if isinstance(part, trimesh.Trimesh)]
    elif isinstance(mesh, trimesh.Trimesh):
        parts = [mesh]
    else:
        raise MjframesError(f"{name}: it is a {type(mesh).__name__}; a mesh is a trimesh object or the path of a file.")
    if not parts:
        return np.zeros((0, 3)), np.zeros((0, 3), np.int64)
    start = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces = [np.asarray(part.faces, np.int64) + first for part, first in zip(parts, start, strict=False)]
    units = [_metres(name, part.units) if scale is None else scale for part in parts]
    points = [unit * np.asarray(part.vertices, np.float64) for unit, part in zip(units, parts, strict=True)]
    return np.concatenate(points), np.concatenate(faces)


def _metres(name: str, unit: str | None) -> float:
    """The length of a unit as trimesh calls it [m], 1 where there is none."""
    from mjframes.base.trimeshes import trimesh

    try:
        return 1.0 if unit is None else trimesh.units.unit_conversion(unit, "meters")
    except (KeyError, ValueError) as error:
        raise MjframesError(f"{name}: its unit is {unit!r}; give its length in metres as scale or --scale.") from error


def _merge(points: NDArray[np.float64], triangles: NDArray[np.int64]) -> tuple[NDArray[Any], NDArray[np.int64]]:
    """One vertex for all at the same place, only those that triangles use, no triangles that this makes edges."""
    used, corner = np.unique(triangles, return_inverse=True)
    points, triangles = points[used], corner.reshape(triangles.shape)
    if len(points) == 0:
        return points, triangles
    low = points.min(axis=0)
    key = np.rint((points - low) / max(MERGE * float(np.linalg.norm(np.ptp(points, axis=0))), 1e-300)).astype(np.int64)
    code = (key[:, 0] << 42) | (key[:, 1] << 21) | key[:, 2]  # 1/MERGE < 2²¹
    _, first, place = np.unique(code, return_index=True, return_inverse=True)
    points, triangles = points[first], place[triangles]
    a, b, c = triangles.T
    return points, triangles[(a != b) & (b != c) & (c != a)]


def _refuse_flat(name: str, points: NDArray[np.float64]) -> None:
    extents = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if extents[-1] <= FLAT * extents[0] or len(points) < 4:
        raise MjframesError(f"{name}: the mesh is flat, it has no inside; a volume needs a closed surface.")


def _refuse_loose(surface: MeshSurface) -> None:
    """Most edges are open, and where w > ½ it is far from an integer: triangles without relation."""
    if surface.open_edges <= len(surface.faces) / 2:
        return
    low, high = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
    cells = np.stack(np.meshgrid(*[np.arange(PROBES)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    points = low + (cells + 0.5) / PROBES * (high - low)
    w = import_igl(surface.name).fast_winding_number(surface.vertices, surface.faces, points)
    w = w[w > 0.5]
    if np.count_nonzero(np.abs(w - np.maximum(np.rint(w), 1)) > UNDECIDED) >= UNDECIDED * len(w):
        raise MjframesError(
            f"{surface.name}: its {len(surface.faces)} triangles are loose ({surface.open_edges} open edges) and "
            "enclose nothing; a volume needs a closed surface."
        )


def _drop_repeated(triangles: NDArray[np.int64]) -> tuple[NDArray[np.int64], int]:
    """The triangles without repetitions, and how many went."""
    a, b, c = triangles.T
    ordered = np.sort(triangles, axis=1)
    is_even = ((a < b) & (b < c)) | ((b < c) & (c < a)) | ((c < a) & (a < b))  # cyclic shift of the sorted corners
    by_corners = np.lexsort(ordered.T)
    is_new = np.ones(len(triangles), bool)
    is_new[1:] = (np.diff(ordered[by_corners], axis=0) != 0).any(axis=1)
    if is_new.all():
        return triangles, 0
    net = np.add.reduceat(np.where(is_even, 1, -1)[by_corners], np.flatnonzero(is_new))
    kept = ordered[by_corners][is_new]
    if 2 * np.count_nonzero(net) < len(net):  # drawn on both sides: one of them is the surface
        net[net == 0] = 1
    kept = np.where(net[:, None] > 0, kept, kept[:, ::-1])[net != 0]
    return kept, len(triangles) - len(kept)


def shells_of(n: int, triangles: NDArray[np.int64]) -> NDArray[np.int32]:
    """Return (m,) which connected part each triangle belongs to, of a mesh with n vertices."""
    a, b, c = triangles.T
    links = scipy.sparse.coo_array((np.ones(2 * len(a), bool), (np.r_[a, b], np.r_[b, c])), (n, n))
    vertex_part = scipy.sparse.csgraph.connected_components(links, directed=False)[1]
    return np.unique(vertex_part[a], return_inverse=True)[1].astype(np.int32)


def shells_around(
    points: NDArray[np.float64], triangles: NDArray[np.int64], shell: NDArray[np.int32]
) -> list[list[int]]:
    """Return for each shell those around it: WITNESSES of its vertices are inside of them."""
    parts = [triangles[shell == s] for s in range(shell.max() + 1)]
    low, high = (np.array([end(points[part], axis=(0, 1)) for part in parts]) for end in (np.min, np.max))
    found = []
    for s, part in enumerate(parts):
        own = np.unique(part)
        witnesses = points[own[np.linspace(0, len(own) - 1, min(WITNESSES, len(own))).astype(int)]]
        boxed = (low <= low[s]).all(axis=1) & (high >= high[s]).all(axis=1)
        others = [o for o in np.flatnonzero(boxed).tolist() if o != s]
        found.append([o for o in others if (np.abs(winding_number(witnesses, points[parts[o]])) > 0.5).all()])
    return found


def _edges(triangles: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """The edges: (e,) place of a side in triangles.ravel(), (e,) number of sides, (e,) balance of directions.

    Balance is positive where more sides run from the smaller vertex number to the larger one. If it is 0 everywhere
    the surface is closed: its boundary as a chain is 0, and winding numbers are integers.
    """
    tail, head = triangles.ravel(), triangles[:, [1, 2, 0]].ravel()
    code = np.minimum(tail, head) * (triangles.max() + 1) + np.maximum(tail, head)
    _, first, edge, count = np.unique(code, return_index=True, return_inverse=True, return_counts=True)
    return first, count, np.bincount(edge, weights=np.where(tail < head, 1, -1)).astype(np.int64)


def _open_edges(triangles: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """(e,) tail, (e,) head and (e,) how many sides from tail to head lack their opposite."""
    first, _, balance = _edges(triangles)
    is_open = balance != 0
    first, balance = first[is_open], balance[is_open]
    ends = np.sort(np.stack([triangles.ravel()[first], triangles[:, [1, 2, 0]].ravel()[first]]), axis=0)
    tail, head = np.where(balance > 0, ends, ends[::-1])
    return tail, head, np.abs(balance)


def _make_consistent(
    name: str, triangles: NDArray[np.int64], shell: NDArray[np.int32]
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """The triangles, neighbours on the same side within a shell, and (s,) which shells that changed."""
    mixed = np.zeros(shell.max() + 1, bool)
    first, count, balance = _edges(triangles)
    mixed[shell[first[(count == 2) & (balance != 0)] // 3]] = True
    if mixed.any():
        chosen = mixed[shell]
        triangles = triangles.copy()
        triangles[chosen] = import_igl(name, MIXED).bfs_orient(np.ascontiguousarray(triangles[chosen]))[0]
    return triangles, mixed


def _inside_out(
    points: NDArray[np.float64], triangles: NDArray[np.int64], shell: NDArray[np.int32], mixed: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """(s,): the shells to turn. A mixed one says nothing about cavities, so it only is turned outwards."""
    volume = _shell_volumes(points, triangles, shell)
    turned = volume < 0
    if not turned.any() or len(volume) == 1:
        return turned
    around = shells_around(points, triangles, shell)
    for s in np.argsort(-np.abs(volume)):
        outer = [o for o in around[s] if not (mixed[o] or mixed[s]) and abs(volume[o]) > abs(volume[s])]
        if outer:
            turned[s] = turned[min(outer, key=lambda o: abs(volume[o]))]
    return turned


def _shell_volumes(
    points: NDArray[np.float64], triangles: NDArray[np.int64], shell: NDArray[np.int32]
) -> NDArray[np.float64]:
    """(s,) signed volume of each shell [m³]; of an open one, that of its cone to its own middle."""
    corners = points[triangles]
    a, b, c = np.moveaxis(corners, 1, 0)
    normal = np.cross(b - a, c - a) / 2
    area = np.linalg.norm(normal, axis=1)
    center = corners.mean(axis=1)
    weight = np.maximum(np.bincount(shell, area), 1e-300)
    middle = np.stack([np.bincount(shell, area * center[:, x]) / weight for x in range(3)], axis=1)
    return np.bincount(shell, np.einsum("mx,mx->m", normal, center - middle[shell]) / 3).astype(np.float64)


def _count(number: int, what: str) -> str:
    return f"{number} {what}" + ("" if number == 1 else "s")
