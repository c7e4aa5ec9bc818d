"""Runs of a scene: plain `mj_step`, watched.

Energies at the start of a step, when positions, velocities and contacts of MjData belong together:
kinetic ½ Σ_b (m_b |v_b|² + ω_bᵀ I_b ω_b) + ½ Σ_d armature_d q̇_d² over bodies b and degrees of freedom d, potential as
MuJoCo has it (gravity and springs), elastic as the soft bodies have it. MuJoCo's own kinetic energy is not used: during
a step its mass matrix is that of equation (7), M + hC + h²K.
"""

from __future__ import annotations

import math
import os
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import mujoco
import numpy as np
from rich.console import Console
from rich.progress import track

from mjframes.app.recording import Instant, Recording
from mjframes.base.errors import MjframesError
from mjframes.scene import view
from mjframes.scene.load import mujoco_warnings, sentence

RECORDS = 5000  # instants kept of a run at most: enough for a plot, and a log of some megabytes
DIVERGED = [
    int(mujoco.mjtWarning.mjWARN_BADQPOS),
    int(mujoco.mjtWarning.mjWARN_BADQVEL),
    int(mujoco.mjtWarning.mjWARN_BADQACC),
]


def record(
    model: mujoco.MjModel,
    duration: float,
    *,
    video: str | os.PathLike[str] | None = None,
    log: str | os.PathLike[str] | None = None,
    plot: str | os.PathLike[str] | None = None,
    camera: str | None = None,
    fps: float = 30.0,
    size: tuple[int, int] = (1280, 720),
    scene: str = "",
    progress: bool = False,
) -> Recording:
    """Step a scene from its initial state for `duration` [s] and record it.

    video, log, plot: files to write (.mp4, .mcap, .png), all of them or, where the run fails, none.
    camera, fps, size: of the video, see `video.film`.  scene: XML to attach to the log.
    progress: show a bar on a terminal.
    Raises MjframesError for bad arguments, a scene the plugin refuses and a simulation that diverges.
    """
    if not (math.isfinite(duration) and duration > 0):
        raise MjframesError(f"duration is {duration!r}; it must be a positive time in seconds.")
    timestep = model.opt.timestep
    if not (math.isfinite(timestep) and timestep > 0):
        raise MjframesError(f"the scene's timestep is {timestep!r}; it must be a positive time in seconds, as 0.002.")
    steps = max(1, round(duration / timestep))
    stride = math.ceil(steps / RECORDS)
    depth = np.zeros(steps)
    instants: list[Instant] = []
    seconds, frames = 0.0, 0
    with ExitStack() as stack:
        warnings = stack.enter_context(mujoco_warnings())
        stack.enter_context(_potential_energy(model))
        try:
            data = mujoco.MjData(model)
        except mujoco.FatalError as error:
            raise MjframesError(f"MuJoCo cannot start the scene ({sentence(error, warnings)}).") from error
        bodies = {name: view.soft(model, data, name) for name in view.soft_names(model)}
        draw = write = save_plot = None
        if video is not None:
            from mjframes.app.video import film

            draw = stack.enter_context(film(model, video, camera=camera, fps=fps, size=size))
        if log is not None:
            from mjframes.app.log import log_file

            write = stack.enter_context(log_file(log, tuple(bodies), scene))
        if plot is not None:
            from mjframes.app.plot import plot_file

            save_plot = stack.enter_context(plot_file(plot))
        hidden = not (progress and sys.stderr.isatty())
        for step in track(range(steps), "stepping", console=Console(stderr=True), transient=True, disable=hidden):
            qpos, qvel, now = data.qpos.copy(), data.qvel.copy(), data.time
            start = time.perf_counter()
            mujoco.mj_step(model, data)
            seconds += time.perf_counter() - start
            if data.warning.number[DIVERGED].any():
                reason = warnings[-1] if warnings else f"Time = {now:.4f}."
                raise MjframesError(
                    f"the simulation diverged: {reason} Try a smaller timestep, or damping where the scene has none."
                )
            depth[step] = penetration(data)
            if step % stride == 0 or step == steps - 1:
                instants.append(_instant(model, data, bodies, now, qpos, qvel, depth[step]))
                if write is not None:
                    write(instants[-1])
            if draw is not None and now >= frames / fps - timestep / 2:
                draw(data)
                frames += 1
        recording = Recording(tuple(instants), steps, seconds, timestep, depth, _weight(model))
        if save_plot is not None:
            save_plot(recording)
    return recording


def penetration(data: mujoco.MjData) -> float:
    """The deepest penetration of the contacts that act [m], 0 where nothing touches; current after `mj_step`."""
    acting = data.contact.dist[data.contact.exclude == 0]
    return max(0.0, -float(acting.min())) if len(acting) else 0.0


def kinetic_energy(model: mujoco.MjModel, data: mujoco.MjData, qvel: np.ndarray) -> float:
    """Of all bodies and armatures, as MuJoCo knows their masses [J].  qvel: (nv,), that of data's `cvel`."""
    velocity = _center_velocities(model, data)
    spin = np.einsum("bji,bj->bi", data.ximat.reshape(-1, 3, 3), data.cvel[:, :3])
    linear = model.body_mass @ (velocity**2).sum(axis=1)
    angular = (model.body_inertia * spin**2).sum()
    return 0.5 * float(linear + angular + model.dof_armature @ qvel**2)


@contextmanager
def _potential_energy(model: mujoco.MjModel) -> Iterator[None]:
    """Lets MuJoCo keep `data.energy` current in every step."""
    before = model.opt.enableflags
    model.opt.enableflags = before | int(mujoco.mjtEnableBit.mjENBL_ENERGY)
    try:
        yield
    finally:
        model.opt.enableflags = before


def _instant(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    bodies: dict[str, view.Soft],
    now: float,
    qpos: np.ndarray,
    qvel: np.ndarray,
    depth: float,
) -> Instant:
    return Instant(
        time=now,
        qpos=qpos,
        qvel=qvel,
        kinetic=kinetic_energy(model, data, qvel) + sum(float(body.kinetic_difference) for body in bodies.values()),
        potential=float(data.energy[0]),
        elastic={name: float(body.elastic_energy) for name, body in bodies.items()},
        soft_kinetic={name: float(body.kinetic_energy) for name, body in bodies.items()},
        contacts=data.ncon,
        penetration=float(depth),
        normal_force=_normal_force(model, data),
        speed=float(np.linalg.norm(_center_velocities(model, data), axis=1).max()),
    )


def _center_velocities(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """(nbody, 3) velocities of the bodies' centres of mass [m/s]; `cvel` is about the centre of the whole tree."""
    arm = data.xipos - data.subtree_com[model.body_rootid]
    return data.cvel[:, 3:] + np.cross(data.cvel[:, :3], arm)


def _normal_force(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    force, total = np.zeros(6), 0.0
    for contact in range(data.ncon):
        mujoco.mj_contactForce(model, data, contact, force)
        total += force[0]
    return float(total)


def _weight(model: mujoco.MjModel) -> float:
    return float(model.body_mass[model.body_weldid != 0].sum() * np.linalg.norm(model.opt.gravity))
