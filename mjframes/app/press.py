"""Press an indenter into a soft body of a scene and read the force over the depth.

The indenter is a mocap body that moves at a constant speed along a line; it touches without friction. The scene comes
to rest first, with its motion damped. The depth counts from the first force on.
"""

from __future__ import annotations

import csv
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjframes.app.dented import skin_vertices
from mjframes.app.hertz import Ground, hertz_force, where_it_fails
from mjframes.base.errors import MjframesError, reason
from mjframes.base.files import replacing
from mjframes.scene import forces, scaling
from mjframes.scene.load import DIVERGED, load_scene, mujoco_warnings, start
from mjframes.scene.plugin_text import SEPARATOR
from mjframes.scene.view import Soft, soft, soft_names

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

KINDS = {
    "ball": mujoco.mjtGeom.mjGEOM_SPHERE,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "punch": mujoco.mjtGeom.mjGEOM_BOX,
}
NAME = "press:indenter"
ALL = 2**31 - 1  # contype: it touches what touches anything
SETTLING, DRAG, AT_REST = 5.0, 20.0, 0.02  # [s] at most, [1/s] of all motion, [-] of the speed
DURATION = 1.0  # [s] of the press, unless a speed is given
HOLD = 0.3  # [s] at the end
ROWS = 100  # of the table
STIFF = 1.3  # [-] times Hertz's force: what frames that are far apart do
BENT = 0.2  # [-] of Hertz's force: less is no dent
NOTHING = 1e-3  # [-] of the largest force: what is left of it where nothing is pressed any more
NOTABLE = 0.1  # [-] of the force or the depth: what is worth a sentence


@dataclass(frozen=True)
class Indenter:
    """What is pressed.

    kind: "ball", "cylinder" (along its path, its flat end first) or "punch" (a flat square).
    size: radius, of a punch width [m].
    """

    kind: str
    size: float

    def profile(self, aside: Array) -> Array:
        """Return how far behind the tip its surface is (n,) at (n, 2) beside its axis; infinite beyond it [m]."""
        r = np.linalg.norm(aside, axis=1)
        if self.kind == "ball":
            return np.where(r < self.size, self.size - np.sqrt(np.maximum(self.size**2 - r**2, 0)), np.inf)
        inside = r < self.size if self.kind == "cylinder" else np.abs(aside).max(axis=1) < self.size / 2
        return np.where(inside, 0.0, np.inf)


@dataclass(frozen=True, eq=False)
class Pressed:
    """What a press gave.

    depth: (n,) [m], force: (n,) [N], hertz: (n,) [N], None where there is no such formula.
    held: force when the indenter has stopped for a while [N].  notes: sentences on what to doubt.
    touched: (3,) where its tip was when it touched the body first, in the world [m].
    """

    depth: Array
    force: Array
    hertz: Array | None
    held: float
    notes: tuple[str, ...]
    touched: Array


def press(
    scene: str | os.PathLike[str],
    indenter: Indenter,
    depth: float,
    *,
    body: str | None = None,
    at: Sequence[float] | None = None,
    direction: Sequence[float] = (0.0, 0.0, -1.0),
    speed: float | None = None,
) -> Pressed:
    """Press an indenter into a soft body of a scene (.xml).

    depth: from the first force on [m].  body: its name, needed where the scene has several.
    at: a point (3,) in the world on the indenter's path [m], the middle of the body unless given.
    direction: (3,) of the path in the world.  speed: [m/s], the depth in one second unless given.
    Raise MjframesError for a scene without that body, a path that misses it and a simulation that diverges.
    """
    u = np.asarray(direction, float)
    if indenter.kind not in KINDS or not (math.isfinite(indenter.size) and indenter.size > 0):
        raise MjframesError(f"the indenter is {indenter}; give a ball, a cylinder or a punch with a positive size.")
    if not (math.isfinite(depth) and depth > 0):
        raise MjframesError(f"depth is {depth!r}; it must be a positive length in metres.")
    if u.shape != (3,) or not np.isfinite(u).all() or not u.any():
        raise MjframesError(f"direction is {direction!r}; give three numbers that are not all 0.")
    pace = depth / DURATION if speed is None else speed
    if not (math.isfinite(pace) and pace > 0):
        raise MjframesError(f"speed is {speed!r}; it must be a positive speed in m/s.")
    u = u / np.linalg.norm(u)
    with mujoco_warnings() as warnings:
        model, data = _scene(scene, indenter, depth, u, warnings)
        view = soft(model, data, _chosen(model, body))
        return _Press(model, data, view, indenter, u, depth, pace).run(at)


def _scene(
    path: str | os.PathLike[str], indenter: Indenter, depth: float, u: Array, warnings: list[str]
) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The scene with the indenter, whose tip is at its mocap body's origin."""
    spec = load_scene(path)[1]
    for key in list(spec.keys):  # they know of no indenter
        spec.delete(key)
    length = max(indenter.size, 2 * depth)
    sizes = {"ball": (indenter.size, 0, 0), "cylinder": (indenter.size, length, 0), "punch": (indenter.size / 2,) * 2}
    size = (*sizes[indenter.kind], length)[:3]
    quat = np.zeros(4)
    mujoco.mju_quatZ2Vec(quat, -u)
    holder = spec.worldbody.add_body(name=NAME, mocap=True, quat=quat)
    geom = holder.add_geom(name=NAME, type=KINDS[indenter.kind], size=size, contype=ALL, conaffinity=ALL)
    geom.pos = [0, 0, indenter.size if indenter.kind == "ball" else length]
    geom.condim, geom.priority = 1, 1 + max((other.priority for other in spec.geoms), default=0)
    geom.solref[:2] = max(0.01, 2 * spec.option.timestep), 1
    geom.solimp[:2] = 0.99, 0.99
    try:
        model = spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        raise MjframesError(f"{path}: MuJoCo cannot compile the scene with the indenter ({reason(error)}).") from error
    return model, start(model, warnings)


def _chosen(model: mujoco.MjModel, name: str | None) -> str:
    names = soft_names(model)
    if name in names:
        return str(name)
    known = ", ".join(map(repr, names)) or "none"
    if name is None and len(names) == 1:
        return names[0]
    raise MjframesError(f"body is {name!r}, but the soft bodies of the scene are: {known}; name one of them.")


@dataclass(eq=False)
class _Press:
    """The run of one press."""

    model: mujoco.MjModel
    data: mujoco.MjData
    view: Soft
    indenter: Indenter
    u: Array
    depth: float
    speed: float

    def run(self, at: Sequence[float] | None) -> Pressed:
        notes = self._settle()
        before = self._vertices()
        low, high = before.min(axis=0), before.max(axis=0)
        point = (low + high) / 2 if at is None else np.asarray(at, float)
        axes = self.data.xmat[self.model.body(NAME).id].reshape(3, 3)
        aside = (before - point) @ axes[:, :2]
        reach = (before - point) @ self.u + self.indenter.profile(aside)
        if not np.isfinite(reach).any():
            raise MjframesError(f"the indenter at {np.round(point, 4).tolist()} misses {self.view.name!r}; give at.")
        tip = point + reach.min() * self.u
        ground = self._ground(before, aside, (before - point) @ self.u)
        self._contact(True)
        travel, force, others = self._push(tip)
        held = self._hold()
        first = int(np.argmax(force > 0))
        depth = travel - travel[max(first - 1, 0)]
        far = before @ self.u >= np.quantile(before @ self.u, 0.95)
        moved = float(((self._vertices() - before)[far] @ self.u).mean())
        if abs(moved) > NOTABLE * self.depth:
            notes.append(f"the far side moved by {1e3 * moved:.2g} mm: the body is pushed or bent as a whole.")
        if abs(force[-1] - held) > NOTABLE * held:
            notes.append(f"the force went to {held:.3g} N when the indenter stopped: press more slowly.")
        if held < NOTHING * force.max():
            end = 1e3 * float(depth[force > 0].max())
            notes.append(f"the force fell to nothing at {end:.3g} mm: the indenter went through the body or past it.")
        if others:
            notes.append(f"the indenter also touched {', '.join(sorted(others))}, whose forces are not counted.")
        binned, mean = _binned(depth[first:], force[first:], self.depth)
        hertz = None
        if self.indenter.kind == "ball":
            hertz, told = self._hertz(binned, ground)
            notes += told
        if hertz is not None and mean[-1] > STIFF * hertz[-1]:
            notes.append(f"the contact is stiffer than Hertz says: {self._why_stiff()}.")
        if hertz is not None and mean[-1] < BENT * hertz[-1]:
            notes.append("the contact is far softer than Hertz says: what is pressed bends or moves; give another at.")
        return Pressed(binned, mean, hertz, held, tuple(notes), tip + travel[first] * self.u)

    def _why_stiff(self) -> str:
        if "patch_dent" in self.view.configuration:
            return "dents below so small a ball are too firm, the more so the more frames the body has"
        return "its dents are off, by mf.Contact(dents=False) or --no-dents"

    def _step(self) -> None:
        mujoco.mj_step(self.model, self.data)
        if self.data.warning.number[DIVERGED].any():
            raise MjframesError("the simulation diverged; try a smaller timestep in the scene.")

    def _contact(self, touches: bool) -> None:
        geom = self.model.geom(NAME).id
        self.model.geom_contype[geom] = self.model.geom_conaffinity[geom] = ALL if touches else 0

    def _settle(self) -> list[str]:
        """Let the scene come to rest without the indenter."""
        self._contact(False)
        keep, fastest = math.exp(-DRAG * self.model.opt.timestep), 0.0
        while self.data.time < SETTLING:
            self._step()
            self.data.qvel *= keep
            fastest = float(np.linalg.norm(self.view.control_velocities, axis=1).max())
            if self.data.time > 10 / DRAG and fastest < AT_REST * self.speed:
                return []
        return [f"the body still moved by {1e3 * fastest:.2g} mm/s after {SETTLING:g} s, when the press began."]

    def _push(self, tip: Array) -> tuple[Array, Array, set[str]]:
        """Return travel (t,) [m] and force (t,) [N] of each step, and what else was touched."""
        travel, force, others = [], [], set()
        start, first = -NOTABLE * self.depth, math.inf
        step = self.speed * self.model.opt.timestep
        for n in range(math.ceil((2 + 2 * NOTABLE) * self.depth / step) + 1):
            travel.append(start + n * step)
            self.data.mocap_pos[self._mocap] = tip + travel[-1] * self.u
            self._step()
            force.append(self._force(others))
            if force[-1] > 0:
                first = min(first, travel[-1])
            if travel[-1] >= first + self.depth:
                return np.array(travel), np.array(force), others
        raise MjframesError(f"the indenter never touched {self.view.name!r}; give at, or another direction.")

    def _hold(self) -> float:
        found = []
        for _ in range(max(1, round(HOLD / self.model.opt.timestep))):
            self._step()
            found.append(self._force(set()))
        return float(np.mean(found[len(found) // 2 :]))

    @property
    def _mocap(self) -> int:
        return int(self.model.body_mocapid[self.model.body(NAME).id])

    def _force(self, others: set[str]) -> float:
        """Against the path, from the body alone [N]."""
        own, total = self.model.geom(NAME).id, 0.0
        for touch in forces.touches_of(self.model, self.data, np.array([own])):
            if touch.other in self.view.patches:
                total -= float(touch.force @ self.u)
            else:
                others.add(self.model.geom(touch.other).name or f"geom {touch.other}")
        return total

    def _vertices(self) -> Array:
        return np.concatenate([vertices for _, vertices in self._skins()])

    def _skins(self) -> list[tuple[str, Array]]:
        """Name, without the body's, and vertices (n, 3) of each of its skins [m]."""
        mujoco.mj_kinematics(self.model, self.data)
        every = skin_vertices(self.model, self.data, mujoco.MjvScene(self.model, 0))
        head = self.view.name + SEPARATOR
        named = [(self.model.skin(k).name, vertices.astype(float)) for k, vertices in enumerate(every)]
        found = [(name.removeprefix(head), vertices) for name, vertices in named if name.startswith(head)]
        if not found:
            raise MjframesError(f"{self.view.name!r} has no skin to find its surface by.")
        return found

    def _ground(self, vertices: Array, aside: Array, along: Array) -> Ground | None:
        """What is below the indenter; None where its material is not known or does not deform."""
        nearest = int(np.lexsort((along, np.round(np.linalg.norm(aside, axis=1) / self.indenter.size, 1)))[0])
        names = [name for name, some in self._skins() for _ in some]
        moduli = scaling.moduli(self.model, self.view.name)
        called = scaling.materials(self.model, self.view.name)
        factors = scaling.stiffness(self.model, self.view.name, len(called))
        seen = [
            (moduli[label], float(factor))
            for (label, name), factor in zip(called.items(), factors, strict=True)
            if label in moduli and names[nearest] in (name, f"{name}_{label}", str(label))
        ]
        if not seen:
            return None
        (young, poisson), factor = seen[0]
        contact = math.sqrt(self.indenter.size * self.depth)
        slope, curvature = _shape(aside, along, aside[nearest], float(along[nearest]), contact)
        size = float(np.ptp(vertices, axis=0).min())
        return Ground(young * factor, poisson, len(moduli), curvature, slope, size)

    def _hertz(self, depth: Array, ground: Ground | None) -> tuple[Array | None, list[str]]:
        if ground is None:
            return None, ["Hertz's force is not known: the scene does not say E and ν of the material at the surface."]
        if not 0 < ground.radius(self.indenter.size) < np.inf:
            return None, ["Hertz's force is not drawn: the surface is as hollow as the ball."]
        fails = where_it_fails(self.depth, self.indenter.size, ground)
        told = [f"Hertz's force does not hold at {1e3 * self.depth:g} mm: {', and '.join(fails)}."] if fails else []
        return hertz_force(depth, self.indenter.size, ground), told


def _shape(aside: Array, along: Array, point: Array, height: float, contact: float) -> tuple[float, float]:
    """Slope [-] and mean curvature [1/m] of the surface around a point, by a paraboloid through what is near it."""
    away = np.linalg.norm(aside - point, axis=1)
    for reach in contact * np.array([1.5, 3, 6]):
        near = (away < reach) & (np.abs(along - height) < reach)
        if near.sum() >= 8:
            a, b = (aside[near] - point).T
            plane = np.stack([np.ones_like(a), a, b, a * a, a * b, b * b], axis=1)
            (_, x, y, xx, _, yy), *_ = np.linalg.lstsq(plane, along[near], rcond=None)
            return float(math.hypot(x, y)), float(xx + yy)
    return 0.0, 0.0


def _binned(depth: Array, force: Array, most: float) -> tuple[Array, Array]:
    """Means of about ROWS stretches of equal depth."""
    place = np.minimum((depth / most * ROWS).astype(int), ROWS - 1)
    count = np.bincount(place)
    kept = count > 0
    return tuple(np.bincount(place, values)[kept] / count[kept] for values in (depth, force))  # type: ignore[return-value]


def write_table(pressed: Pressed, path: Path) -> None:
    """Write depth_m, force_N and, where it is known, hertz_N as .csv."""
    with replacing(path, "the table") as partial, partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        columns = [pressed.depth, pressed.force] + ([] if pressed.hertz is None else [pressed.hertz])
        writer.writerow(["depth_m", "force_N", "hertz_N"][: len(columns)])
        writer.writerows([f"{value:.6g}" for value in row] for row in np.stack(columns, axis=1))


def plot_press(pressed: Pressed, figure: Figure, title: str) -> None:
    """Draw force over depth."""
    axes = figure.subplots()
    axes.plot(1e3 * pressed.depth, pressed.force, label="force")
    if pressed.hertz is not None:
        axes.plot(1e3 * pressed.depth, pressed.hertz, "k--", label="Hertz")
        axes.legend()
    axes.set(xlabel="depth [mm]", ylabel="force [N]", title=title)
    axes.grid(alpha=0.3)


def summary(pressed: Pressed) -> str:
    """Return the line that `mjframes press` prints."""
    place = np.round(1e3 * pressed.touched, 1) + 0.0  # no −0
    line = f"touched at {tuple(place.tolist())} mm; {pressed.force[-1]:.3g} N at {1e3 * pressed.depth[-1]:.3g} mm"
    if pressed.hertz is not None:
        line += f", {pressed.force[-1] / pressed.hertz[-1]:.2f} × Hertz's {pressed.hertz[-1]:.3g} N"
    return line
