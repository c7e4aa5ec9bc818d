"""Chambers and fibres of a soft body as MuJoCo's tendons, whose length and Jacobian the plugin supplies.

    V = Σ p_a · (p_b × p_c) / 6     of a chamber [m³]: a motor's force on it is a pressure [Pa]
    L = Σ_k |p_k+1 − p_k|           length of a fibre [m]: a tension [N]

with p = Σ_j W_j x_j (the paper, equation (3)). Both are corrected so that their slopes pull as finite elements say:
tendon_slopes.py, and chamber_growth.py for chambers. MuJoCo's own path of such a tendon is a placeholder: a segment as
long as V or L at rest, and behind a pulley that divides by 1e12 tiny balls on all bodies that move it, so that the
Jacobian has a column for each of their joints. A geom that always collides with a ball at the same place has the plugin
called (plugin/tendon.h).
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage, sparse

from mjframes.base.constants import LEAST_VERTICES
from mjframes.base.errors import MjframesError
from mjframes.base.numbers import is_number, is_whole
from mjframes.base.rows import distinct_rows
from mjframes.body.soft_body import SoftBody
from mjframes.scene import links, plugin
from mjframes.scene.carriers import Carrier, carrier_of, printable
from mjframes.scene.chamber_growth import growth, walls_around
from mjframes.scene.material_points import OUTSIDE
from mjframes.scene.muscles import Muscle, fibres, segments
from mjframes.scene.patch_geoms import PATCH_GROUP, add_bounds, use_plugin
from mjframes.scene.plugin_text import ROUNDING, SEPARATOR, decode, encode, weight_attributes
from mjframes.scene.skins import add_skin
from mjframes.scene.tendon_slopes import Elements, correction, likeness, pair_slopes
from mjframes.surface.isosurface import kept_surface
from mjframes.volume.grid import voxel_grid
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume
from mjframes.weights.interpolation import closest_voxels

TINY = 1e-9  # [m] radius of balls that MuJoCo's path would wrap around if it met them
DIVISOR = 1e12  # of the pulley behind which MuJoCo's path passes the bodies: their distances do not count
HIDDEN = (0.0, 0.0, 0.0, 0.0)
AIR = (0.3, 0.6, 1.0, 0.4)  # colour of a chamber
ATMOSPHERE = 101_325.0  # [Pa]


@dataclass(frozen=True, eq=False)
class Chamber:
    """A cavity of a soft body whose volume is the length of a tendon.

    A motor's force on the tendon is a pressure [Pa] above that of the surroundings, a position actuator's target a
    volume [m³]. `attach` adds the tendon.

    Parameters
    ----------
    cavity
        The voxels of the cavity, a mask (nx, ny, nz) of the volume's labels, or a point (3,) in it, in volume
        coordinates [m]. Its voxels must have the label 0.
    lid
        Whether openings are closed by a lid. The lid moves with the material next to it. Without it, a cavity must be
        closed.
    gas
        Absolute pressure [Pa] of gas that is sealed in at rest, None for none. Its pressure p follows from p V^γ
        constant, and pushes as p − ambient.
    ambient
        Absolute pressure around the body [Pa], 0 in a vacuum.
    exponent
        γ: 1.4 for air that is squeezed quickly, 1 for air that stays as warm as what is around it.
    vertices
        About how many vertices the surface of the chamber has, 100 or more.

    Raises
    ------
    MjframesError
        If an argument is not as described.
    """

    cavity: ArrayLike
    lid: bool = False
    gas: float | None = None
    ambient: float = ATMOSPHERE
    exponent: float = 1.4
    vertices: int = 500

    def __post_init__(self) -> None:
        for name in ("gas", "exponent"):
            value = getattr(self, name)
            if not (is_number(value) and value > 0) and (name != "gas" or value is not None):
                raise MjframesError(f"{name} is {value!r}; give a number > 0.")
        if not (is_number(self.ambient) and self.ambient >= 0):
            raise MjframesError(f"ambient is {self.ambient!r}; give an absolute pressure in pascals, 0 in a vacuum.")
        if not (is_whole(self.vertices) and self.vertices >= LEAST_VERTICES):
            raise MjframesError(f"vertices is {self.vertices!r}; give a whole number ≥ {LEAST_VERTICES}.")
        if not isinstance(self.lid, bool):
            raise MjframesError(f"lid is {self.lid!r}; it must be True or False.")


@dataclass(frozen=True, eq=False)
class Fibre:
    """A path through a soft body whose length is the length of a tendon.

    A motor's force on the tendon is minus its tension [N]. `attach` adds the tendon.

    Parameters
    ----------
    points
        The stops of the path, two or more: points (3,) of the material in volume coordinates [m], or names of sites of
        the scene. Between stops the path is straight.

    Raises
    ------
    MjframesError
        If the stops are not as described.
    """

    points: Sequence[ArrayLike | str]

    def __post_init__(self) -> None:
        if isinstance(self.points, str) or len(self.points) < 2:
            raise MjframesError(f"points is {self.points!r}; a fibre needs two stops or more.")
        for number, stop in enumerate(self.points):
            if not isinstance(stop, str) and (np.shape(stop) != (3,) or not all(map(is_number, np.asarray(stop)))):
                raise MjframesError(
                    f"points[{number}] is {stop!r}; give three volume coordinates in metres, or the name of a site."
                )


@dataclass(frozen=True, eq=False)
class Measured:
    """What the plugin measures.

    config: the attributes of the instance beyond the points'.
    weights: W_j (n, k) of its points.
    offset: (n, 3) p̄ − Σ_j W_j x̄_j [m].
    rest: the value at rest [m³] or [m].
    sites: of the scene that it passes.
    places: how many stops are drawn.
    """

    config: dict[str, str]
    weights: sparse.csr_array
    offset: np.ndarray
    rest: float
    sites: tuple[str, ...] = ()
    places: int = 0


def add_tendons(
    spec: mujoco.MjSpec,
    body: SoftBody,
    name: str,
    carried: Sequence[Carrier],
    rest: np.ndarray,
    tendons: Mapping[str, Chamber | Fibre | Muscle],
) -> None:
    """Add the tendons of a soft body that is in the spec.

    carried: its bodies.  rest: (k, 3) of the control points, as the model has them [m].
    """
    elements = Elements(body)
    for own, kind in tendons.items():
        if not isinstance(own, str) or not own:
            raise MjframesError(f"tendons has the key {own!r}; its keys are names of tendons.")
        if any(own == other.name for other in (*spec.tendons, *spec.plugins)):
            raise MjframesError(f"tendons has the name {own!r}, which the spec has already; give another one.")
        if isinstance(kind, Chamber):
            measured = _chamber(spec, elements, name, own, carried, rest, kind)
        elif isinstance(kind, Fibre):
            measured = _fibre(spec, elements, name, own, rest, kind)
        elif isinstance(kind, Muscle):
            measured = _muscle(elements, own, rest, kind)
        else:
            raise MjframesError(f"tendons[{own!r}] is a {type(kind).__name__}; give a Chamber, a Fibre or a Muscle.")
        _write(spec, name, own, carried, measured)


def _write(spec: mujoco.MjSpec, name: str, own: str, carried: Sequence[Carrier], measured: Measured) -> None:
    """Add the tendon, its placeholder, its plugin instance and the geoms that have it measured."""
    weights = sparse.csr_array(measured.weights)
    weights.sum_duplicates()
    config = measured.config | weight_attributes(weights)
    if np.abs(measured.offset).max() > ROUNDING * np.ptp([carrier.pose[1] for carrier in carried], axis=0).max():
        config["offset"] = encode(measured.offset)
    spec.activate_plugin(plugin.TENDON_NAME)
    spec.add_plugin(name=own, plugin_name=plugin.TENDON_NAME, active=True).config = config

    stem = f"{name}{SEPARATOR}{own}"
    on = [f"{name}{SEPARATOR}{carrier.points[0]}" for carrier in carried]
    first = spec.body(next(body for body, carrier in zip(on, carried, strict=True) if carrier.joints))
    add_bounds(spec, stem, 0.01)
    hidden = {"group": PATCH_GROUP, "rgba": HIDDEN}
    alone = {"mass": 0, "contype": 0, "conaffinity": 0}
    geom = first.add_geom(name=stem, type=mujoco.mjtGeom.mjGEOM_SDF, meshname=stem, **hidden, **alone)
    use_plugin(geom, own, plugin.TENDON_NAME)
    first.add_geom(name=f"{stem}_ball", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.01, 0, 0], **hidden, **alone)
    spec.add_pair(name=stem, geomname1=f"{stem}_ball", geomname2=stem)

    start, end = f"{stem}_start", f"{stem}_end"
    first.add_site(name=start, **hidden)
    first.add_site(name=end, pos=[printable(measured.rest)[0], 0, 0], **hidden)
    tendon = spec.add_tendon(name=own)
    tendon.wrap_site(start)
    tendon.wrap_site(end)
    tendon.wrap_pulley(DIVISOR)
    tendon.wrap_site(start)
    for site in measured.sites:
        tendon.wrap_site(site)
        tendon.wrap_site(start)
    turns = itertools.cycle([end, start])
    passed = 4 + 2 * len(measured.sites)
    pulled = [weights.indices, decode(config["pair"])] if "pair" in config else [weights.indices]
    for carrier in _leaves(carried, np.unique(np.concatenate(pulled))):
        # between two sites on one body, and not in the way: MuJoCo gives it columns, and computes nothing
        ball = f"{stem}_{carrier}"
        spec.body(on[carrier]).add_geom(
            name=ball, type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[TINY] * 3, **hidden, **alone
        )
        tendon.wrap_geom(ball, "")
        tendon.wrap_site(next(turns))
        passed += 2
    for _ in range(max(measured.places, 5) - passed):
        tendon.wrap_site(next(turns))


def _leaves(carried: Sequence[Carrier], points: np.ndarray) -> list[int]:
    """The carriers of these control points that are above none of the others."""
    used = set(carrier_of(carried)[points].tolist())
    above: set[int] = set()
    for carrier in used:
        while (carrier := carried[carrier].parent) >= 0:
            above.add(carrier)
    return sorted(used - above)


def _points(body: SoftBody, at: np.ndarray, what: str | None) -> tuple[sparse.csr_array, np.ndarray]:
    """W_j (n, k) and p̄ − Σ_j W_j x̄_j (n, 3) [m] of points (n, 3) that are in the material.

    what: of the points, for the error where one is outside; None where they may be.
    """
    grid = voxel_grid(body.fields.volume)
    nearest = closest_voxels(grid, at)
    away = np.abs((at - grid.points(nearest)) @ grid.axes / grid.spacing).max(axis=1, initial=0)
    if what is not None and away.max(initial=0) > OUTSIDE:
        n = int(np.argmax(away))
        raise MjframesError(
            f"{what} has the point {tuple(at[n].tolist())}, {away[n] - 0.5:.1f} voxels outside the material; "
            "give points of the material, in volume coordinates in metres."
        )
    weights = sparse.csr_array(body.shapes.at(grid, at, nearest))
    entries = np.diff(weights.indptr)
    weights.data += np.repeat((1 - weights.sum(axis=1)) / entries, entries)  # those of a saved body sum to 1 ± 1e-7
    return weights, at - weights @ body.control.rest


def _chamber(
    spec: mujoco.MjSpec,
    elements: Elements,
    name: str,
    own: str,
    carried: Sequence[Carrier],
    rest: np.ndarray,
    chamber: Chamber,
) -> Measured:
    """The volume of a cavity, and a skin that shows it."""
    body, volume = elements.body, elements.body.fields.volume
    cavity = _cavity(volume, own, chamber)
    inside = replace(volume, labels=cavity.astype(np.uint8), materials={1: Material(1e3, 0.3, 1000)})
    surface = kept_surface(inside, chamber.vertices)
    weights, offset = _points(body, surface.vertices, None)
    order = np.argsort(distinct_rows(weights.indptr, weights.indices)[0], kind="stable")
    number = np.empty(len(order), int)
    number[order] = np.arange(len(order))
    faces = number[surface.faces]
    vertices, weights, offset = surface.vertices[order], sparse.csr_array(weights[order]), offset[order]
    add_skin(spec, carried, f"{name}{SEPARATOR}{own}", name, vertices, faces, weights, AIR)
    config = {"quantity": "volume", "triangle": encode(faces)}
    if chamber.gas is not None:
        config |= {
            "gas": repr(float(chamber.gas)),
            "ambient": repr(float(chamber.ambient)),
            "exponent": repr(float(chamber.exponent)),
        }
    at = weights @ rest + offset
    walls = walls_around(elements.grid, elements.solver, cavity)
    moved, x = elements.motion(walls.load())
    areas = _volume_slopes(at, faces)
    wanted, has = elements.pull(x), weights.T @ areas
    scale, rest_volume = likeness(elements, wanted, has), float((at * areas).sum() / 3)
    config |= {"scale": repr(scale), "rest_volume": repr(rest_volume)}
    pairs, slope = correction(body, rest, wanted, scale * has)
    config |= {"pair": encode(pairs), "pair_slope": encode(slope)}

    def slopes(at: np.ndarray) -> np.ndarray:
        own = scale * weights.T @ _volume_slopes(weights @ at + offset, faces)
        return own + pair_slopes(pairs, slope, at)

    if (grown := growth(elements, walls, moved, x, rest, slopes)) is not None:
        config["pair_growth"] = encode(correction(body, rest, grown, np.zeros_like(grown))[1])
    return Measured(config, weights, offset, rest_volume)


def _volume_slopes(at: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """∂V/∂p (n, 3) [m²] of points at p (n, 3), the corners of triangles (f, 3) around V."""
    a, b, c = at[faces].transpose(1, 0, 2)
    total = np.zeros_like(at)
    for corner in faces.T:
        np.add.at(total, corner, np.cross(b - a, c - a) / 6)
    return total


def _corrected(body: SoftBody, rest: np.ndarray, wanted: np.ndarray, has: np.ndarray) -> dict[str, str]:
    """The attributes of the correction by which the tendon pulls as in finite elements."""
    pairs, slope = correction(body, rest, wanted, has)
    return {"pair": encode(pairs), "pair_slope": encode(slope)}


def _cavity(volume: Volume, own: str, chamber: Chamber) -> np.ndarray:
    """(nx, ny, nz) the voxels of a chamber. Raise MjframesError where they are not empty, or open without a lid."""
    empty = volume.labels == 0
    given = np.asarray(chamber.cavity)
    if given.shape == (3,):
        at = np.floor((given - volume.origin) @ volume.axes / volume.spacing).astype(int)
        if not all(0 <= i < n for i, n in zip(at, empty.shape, strict=True)) or not empty[tuple(at)]:
            raise MjframesError(
                f"the cavity of {own!r} is at {tuple(given.tolist())}, where the volume has no empty voxel; "
                "give a point in a cavity, in volume coordinates in metres."
            )
        pieces = np.empty(empty.shape, np.int32)
        ndimage.label(empty, output=pieces)  # pyright: ignore[reportArgumentType]
        cavity = pieces == pieces[tuple(at)]
    elif given.shape == empty.shape and given.dtype == bool:
        cavity = given
    else:
        raise MjframesError(
            f"the cavity of {own!r} has the shape {given.shape} and type {given.dtype}; give a boolean mask of the "
            f"volume's {empty.shape} voxels, or a point (3,) in metres."
        )
    if not cavity.any() or not empty[cavity].all():
        filled = "no voxel" if not cavity.any() else f"{np.count_nonzero(cavity & ~empty)} voxels of material"
        raise MjframesError(f"the cavity of {own!r} has {filled}; give empty voxels, which have the label 0.")
    padded = np.pad(cavity, 1)
    opening = ndimage.binary_dilation(padded) & ~padded & np.pad(empty, 1, constant_values=True)
    if opening.any() and not chamber.lid:
        raise MjframesError(
            f"the cavity of {own!r} is open at {np.count_nonzero(opening)} voxels; fill the opening with material, or "
            "give a mask of the voxels that are the chamber, and lid=True."
        )
    return cavity


def _fibre(spec: mujoco.MjSpec, elements: Elements, name: str, own: str, rest: np.ndarray, fibre: Fibre) -> Measured:
    """The length of a path."""
    at = np.array([stop for stop in fibre.points if not isinstance(stop, str)], float).reshape(-1, 3)
    if not len(at):
        raise MjframesError(f"{own!r} passes sites only; give one point of the material, or use MuJoCo's <spatial>.")
    weights, offset = _points(elements.body, at, repr(own))
    rotation, origin = links.pose_in_world(spec.body(name))
    passed, sites, stops = iter(range(len(at))), [], []
    places = []
    for stop in fibre.points:
        if isinstance(stop, str):
            if (site := spec.site(stop)) is None:
                known = ", ".join(repr(other.name) for other in spec.sites if SEPARATOR not in other.name) or "none"
                raise MjframesError(f"{own!r} passes the site {stop!r}, but the scene's sites are: {known}.")
            sites.append(stop)
            stops.append(-1)
            places.append(links.site_in_world(site))
        else:
            stops.append(next(passed))
            places.append(rotation @ at[stops[-1]] + origin)
    way = np.diff(places, axis=0)
    length = np.linalg.norm(way, axis=1)
    config = {"quantity": "length", "stop": encode(np.array(stops))}
    if elements.body.held or not sites:  # what pulls a free body away is not a load that it can rest under
        along = way / np.maximum(length, np.finfo(float).tiny)[:, None] @ rotation
        pull = np.zeros_like(at)
        for number, stop in enumerate(stops):
            if stop >= 0:
                pull[stop] = along[number - 1] * (number > 0) - along[min(number, len(along) - 1)] * (
                    number < len(along)
                )
        nearest = closest_voxels(elements.grid, at)
        config |= _corrected(elements.body, rest, elements.pull_of(nearest, at, pull), weights.T @ pull)
    return Measured(config, weights, offset, float(length.sum()), tuple(sites), len(stops))


def _muscle(elements: Elements, own: str, rest: np.ndarray, muscle: Muscle) -> Measured:
    """∫ |F f| dV of a field of fibres."""
    body, grid = elements.body, elements.grid
    voxels, along = fibres(grid, own, muscle)
    taken = segments(body, rest, grid, voxels, along, muscle.samples)
    way = np.diff((taken.weights @ rest + taken.offset).reshape(-1, 2, 3), axis=1)
    length = np.linalg.norm(way, axis=2, keepdims=True)
    pull = taken.volume[:, None, None] * way / length**2
    share = np.zeros(2 * len(length) - 1)
    share[::2] = taken.volume / length.ravel()
    config = {"quantity": "length", "stop": encode(np.arange(2 * len(length))), "share": encode(share)}
    width = grid.spacing.min()
    ends = [grid.points(voxels) + sign / 2 * width * along for sign in (-1, 1)]
    force = grid.cell_volume / width * along
    wanted = elements.pull_of(np.tile(voxels, 2), np.concatenate(ends), np.concatenate([-force, force]))
    config |= _corrected(body, rest, wanted, taken.weights.T @ np.concatenate([-pull, pull], axis=1).reshape(-1, 3))
    return Measured(config, taken.weights, taken.offset, float(taken.volume.sum()))
