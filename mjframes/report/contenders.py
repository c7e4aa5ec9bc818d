"""Soft bodies of frames, solved in the simulator: what `build` and `attach` make, stepped by `mj_step`.

Forces f_v on voxels act on control point j as Σ_v W_j(v) f_v, and a voxel moves by Σ_j W_j(v) x_j − p_v.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjframes.body import SoftBody, build
from mjframes.control import control_weights
from mjframes.errors import MjframesError
from mjframes.material import Material
from mjframes.mjcf import attach
from mjframes.report.cases import Case
from mjframes.report.equilibrium import release, seconds_per_step, seconds_to_rest, settle
from mjframes.supports import Fixed
from mjframes.view import soft
from mjframes.volume import Volume

Array = NDArray[np.float64]

TYPES = ("affine", "rigid", "quadratic")
KERNELS: dict[str, dict[str, Any]] = {  # name: options of `build`
    "voronoi": {"weights": "voronoi"},
    "voronoi 2": {"weights": "voronoi", "subdivisions": 2},
    "harmonic": {"weights": "harmonic"},
    "linear": {"weights": "linear"},
}
SAMPLES = (1, 3)  # [a frame] that are tried: one region a set of frames, or bent weights split further


@dataclass(frozen=True)
class Setting:
    """One way to build a case's body. frames: that are free.  samples: a frame.  averaged: the paper-style variant."""

    frames: int
    frame_type: str = "affine"
    kernel: str = "voronoi"
    relax: bool = True
    samples: int = SAMPLES[0]
    averaged: bool = False
    mass: str = "lumped"

    @property
    def family(self) -> str:
        """What it has in common with other numbers of frames."""
        if self.averaged:
            return "paper-style (Euclidean kernels, averaged samples)"
        more = f", {self.samples} samples a frame" if self.samples > SAMPLES[0] else ""
        more += ", consistent mass" if self.mass == "consistent" else ""
        return f"{self.frame_type}, {self.kernel}{', relaxed' if self.relax else ''}{more}"


@dataclass(frozen=True, eq=False)
class Contender:
    """A compiled model that has come to rest.

    moved: (n, 3) [m].  build_seconds: of the precomputation.  steps: to within 1 %, at `timestep` [s].
    """

    name: str
    family: str
    dofs: int
    moved: Array
    build_seconds: float
    steps: int
    timestep: float
    model: mujoco.MjModel
    data: mujoco.MjData
    push: Callable[[], None]
    field: Callable[[], Array]
    goal: Array

    def seconds_per_step(self, timestep: float, least: float) -> float:
        return seconds_per_step(self.model, self.data, timestep, least)

    def seconds_to_rest(self) -> float:
        return seconds_to_rest(self.model, self.data, self.push, self.steps, self.timestep)

    def release(self, timestep: float, steps: int) -> Array:
        """(steps,) the quantity of interest [m] once the load is gone."""
        return release(self.model, self.data, lambda: float(np.sum(self.goal * self.field())), timestep, steps)


def settings(case: Case, quick: bool) -> list[Setting]:
    """What is tried: affine frames with each kernel, relaxed or not; other types relaxed; the paper-style variant."""
    kernels = [kernel for kernel in KERNELS if kernel != "linear" or case.straight]
    if quick:
        kernels = ["linear" if case.straight else "voronoi", "harmonic"]
    found = []
    for frames in case.frames:
        for kernel in kernels:
            found += [Setting(frames, "affine", kernel, relax) for relax in (True, False)]
            found += [Setting(frames, kind, kernel) for kind in TYPES if kind != "affine"]
            if kernel != "linear":
                found.append(Setting(frames, "affine", kernel, samples=SAMPLES[-1]))
        found.append(Setting(frames, averaged=True, relax=False, samples=SAMPLES[-1]))
    return found


def solved(case: Case, setting: Setting, load: Array) -> Contender:
    """Built, attached, at rest under `load` (n, 3) [N]. Raises MjframesError where one of these is refused."""
    start = time.perf_counter()
    body = averaged_body(case, setting) if setting.averaged else built(case, case.volume, setting)
    build_seconds = time.perf_counter() - start
    spec = mujoco.MjSpec()
    spec.option.gravity = [0, 0, 0]
    spec.option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    attach(spec.worldbody, body, name="body", contact=False)
    try:
        model = spec.compile()
    except ValueError as error:
        raise MjframesError(f"MuJoCo cannot compile it ({' '.join(str(error).split())[:200]}).") from error
    data = mujoco.MjData(model)
    view = soft(model, data, "body")
    grid = case.grid
    shapes = control_weights(body.fields.weights, body.control, grid.centers)
    force = np.asarray(shapes.T @ load)
    rest = np.asarray(shapes @ body.control.rest)

    def push() -> None:
        """A point of a rigid frame is not the body's centre of mass: the force has a torque."""
        data.xfrc_applied[:] = 0
        arm = view.control_positions - data.xipos[view.bodies]
        np.add.at(data.xfrc_applied, view.bodies, np.hstack([force, np.cross(arm, force)]))

    def field() -> Array:
        return np.asarray(shapes @ view.control_positions) - rest

    result = settle(model, data, push, field)
    if not result:
        raise MjframesError("the body does not come to rest.")
    return Contender(
        f"{setting.frames} free frames", setting.family, model.nv, result["moved"], build_seconds, result["steps"],
        result["timestep"], model, data, push, field, case.goal,
    )  # fmt: skip


def built(case: Case, volume: Volume, setting: Setting) -> SoftBody:
    places: dict[str, Any] = {"frames": setting.frames} if case.places is None else {"at": case.places(setting.frames)}
    return build(
        volume,
        samples=setting.samples * setting.frames,
        frame_type=setting.frame_type,
        relax=setting.relax,
        mass=setting.mass,
        fixed=[Fixed(case.fixed)],
        **KERNELS[setting.kernel],
        **places,
    )


def averaged_body(case: Case, setting: Setting) -> SoftBody:
    """Kernels that know no stiffness, and one stiffness a region: the mean of its voxels'."""
    grid = case.grid
    even = Material(1.0, float(grid.per_material("poisson")[0]), float(np.mean(grid.density)))
    labels = (case.volume.labels > 0).astype(np.uint8)
    body = built(case, replace(case.volume, labels=labels, materials={1: even}), replace(setting, relax=False))
    region = body.fields.region
    mean = np.bincount(region, grid.young) / np.bincount(region)
    stiffness = replace(
        body.stiffness, matrix=tuple(e * matrix for e, matrix in zip(mean, body.stiffness.matrix, strict=True))
    )
    return replace(body, stiffness=stiffness, fields=replace(body.fields, volume=case.volume))
