"""What is installed, and whether it works: the lines that `mjframes doctor` prints."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import os
import platform
import shlex
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np

from mjframes.base.errors import MjframesError, reason
from mjframes.base.packages import optional
from mjframes.scene import plugin, solver

STEPS = 10
OK, FAILS, ABSENT, UNUSABLE = "ok", "FAILS", "not installed", "not working"
BACKENDS = ("egl", "osmesa", "glfw")  # of MUJOCO_GL; the first two need no display
# MuJoCo reads MUJOCO_GL when it is imported, and a backend may end the process: each is tried in one of its own.
DRAWING = """
import mujoco
model = mujoco.MjModel.from_xml_string("<mujoco><worldbody><geom size='.1'/></worldbody></mujoco>")
renderer = mujoco.Renderer(model, 16, 16)
renderer.render()
renderer.close()
"""
DRAWING_TIMEOUT = 60.0  # [s] a software renderer's first start on a busy machine takes seconds

# module: what it is for, the extra of mjframes that brings it
OPTIONAL = {
    "nrrd": ("reading .nrrd", "images"),
    "nibabel": ("reading .nii and .nii.gz", "images"),
    "pyamg": ("harmonic weights of many voxels", "harmonic"),
    "igl": ("surfaces that are not closed", "meshes"),
    "lxml": ("reading .3mf", "meshes"),
    "networkx": ("reading .3mf", "meshes"),
    "meshio": ("reading tetrahedra and bricks", "meshes"),
    "av": ("writing films", "video"),
    "mcap": ("logs", "log"),
    "foxglove": ("what Foxglove draws of logs", "log"),
    "matplotlib": ("plots", "plot"),
    "ray": ("collect --ray", "ray"),
    "viser": ("pages of view --web", "view"),
    "dm_control": ("dm_control's Physics", "dm"),
    "gymnasium": ("environments of Gymnasium", "gym"),
}


@dataclass(frozen=True)
class Finding:
    """One line of the report: what was looked at, what was found, and how that is.

    status: OK; FAILS, where mjframes cannot work without it; ABSENT or UNUSABLE, where it can.
    """

    name: str
    text: str
    status: str = OK


def report() -> list[Finding]:
    """Look at everything; a thing that fails is a finding, never an exception."""
    return [
        Finding("python", f"{platform.python_version()} ({sys.executable})"),
        Finding("mujoco", mujoco.mj_versionString()),
        _finding("mjframes", lambda: importlib.metadata.version("mjframes")),
        _compiler(),
        _finding("plugin", _library),
        _finding("soft body", _step),
        Finding("solver", solver.rule()),
        _drawing(),
        *(_optional(module, use, extra) for module, (use, extra) in OPTIONAL.items()),
    ]


def working_backend() -> str | None:
    """Return the value of MUJOCO_GL that draws here: the one that is set, else the first that works, else None."""
    candidates = [os.environ["MUJOCO_GL"]] if os.environ.get("MUJOCO_GL") else BACKENDS
    return next((backend for backend in candidates if _draws(backend)), None)


def main() -> int:
    """Print the report; return 0, or 2 where something that mjframes needs does not work."""
    findings = report()
    first = max(len(finding.status) for finding in findings)
    second = max(len(finding.name) for finding in findings)
    for finding in findings:
        print(f"{finding.status:{first}}  {finding.name:{second}}  {finding.text}")
    return 2 if any(finding.status == FAILS for finding in findings) else 0


def _finding(name: str, examine: Callable[[], str]) -> Finding:
    try:
        return Finding(name, examine())
    except MjframesError as error:
        return Finding(name, str(error), FAILS)
    except Exception as error:  # whatever breaks, the other lines are still wanted
        return Finding(name, f"{type(error).__name__}: {reason(error)}", FAILS)


def _compiler() -> Finding:
    try:
        return Finding("compiler", shlex.join(plugin.find_compiler()))
    except MjframesError as error:
        return Finding("compiler", str(error), ABSENT)  # not needed where a library fits; the plugin's line tells


def _library() -> str:
    plugin.load()
    return str(plugin.library_path())


def _step() -> str:
    """Builds a block of 6 x 3 x 3 voxels with two frames, attaches it to an empty world and steps it."""
    import mjframes as mf

    rubber = mf.Material(young=1e5, poisson=0.4, density=1000)
    labels = np.ones((6, 3, 3), dtype=np.int32)
    volume = mf.Volume.from_labels(labels, spacing=0.01, materials={1: rubber})
    spec = mujoco.MjSpec()
    mf.attach(spec, mf.build(volume, frames=2), "block")
    model = spec.compile()
    data = mujoco.MjData(model)
    for _ in range(STEPS):
        mujoco.mj_step(model, data)
    if not (np.isfinite(data.qpos).all() and data.time > 0):
        raise MjframesError(f"a soft block has no finite state after {STEPS} steps.")
    return f"a soft block of {model.nv} degrees of freedom made {STEPS} steps"


def _drawing() -> Finding:
    backend = working_backend()
    if backend is None:
        tried = os.environ.get("MUJOCO_GL") or ", ".join(BACKENDS)
        return Finding(
            "drawing",
            f"MUJOCO_GL={tried}: none works; films need OpenGL (Debian, Ubuntu: apt-get install libegl1 libgl1).",
            UNUSABLE,
        )
    return Finding("drawing", f"MUJOCO_GL={backend} works")


def _draws(backend: str) -> bool:
    environment = {**os.environ, "MUJOCO_GL": backend}
    try:
        command = [sys.executable, "-c", DRAWING]
        done = subprocess.run(command, env=environment, capture_output=True, timeout=DRAWING_TIMEOUT)
    except subprocess.TimeoutExpired:
        return False
    return done.returncode == 0


def _optional(module: str, use: str, extra: str) -> Finding:
    if importlib.util.find_spec(module) is None:
        return Finding(module, f'for {use}: pip install "mjframes[{extra}]"', ABSENT)
    try:
        optional(module, "it", extra)
    except MjframesError as error:
        return Finding(module, f"for {use}: {error}", UNUSABLE)
    return Finding(module, use)


if __name__ == "__main__":
    sys.exit(main())
