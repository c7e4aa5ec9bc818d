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
from dataclasses import dataclass

import mujoco
import numpy as np
from rich.console import Console
from rich.progress import track

from mjframes import plugin, view
from mjframes.errors import MjframesError
from mjframes.mjcf import changed_masses

PLUGIN_WARNING = "mjframes: "  # what the plugin's warnings begin with (plugin/soft.cc)
RECORDS = 5000  # instants kept of a run at most: enough for a plot, and a log of some megabytes
STILL = 1e-6  # [m] that everything's weight has to fall for an energy that is worth a number
NOTABLE = 1e-3  # [-] of the energy that moved: a smaller gain is not worth a number
DIVERGED = [
    int(mujoco.mjtWarning.mjWARN_BADQPOS),
    int(mujoco.mjtWarning.mjWARN_BADQVEL),
    int(mujoco.mjtWarning.mjWARN_BADQACC),
]


@dataclass(frozen=True, eq=False)
class Instant:
    """One recorded instant.

    time: [s].  qpos, qvel: the state.  kinetic, potential: of everything [J].
    elastic, soft_kinetic: of each soft body, by name [J].  contacts: how many.
    penetration: the deepest, 0 where nothing touches [m].  normal_force: sum over contacts [N].
    speed: of the fastest body's centre of mass [m/s].
    """

    time: float
    qpos: np.ndarray
    qvel: np.ndarray
    kinetic: float
    potential: float
    elastic: dict[str, float]
    soft_kinetic: dict[str, float]
    contacts: int
    penetration: float
    normal_force: float
    speed: float

    @property
    def total(self) -> float:
        """Kinetic + potential + elastic energy [J]."""
        return self.kinetic + self.potential + sum(self.elastic.values())


@dataclass(frozen=True, eq=False)
class Recording:
    """What a run gave.

    instants: at most RECORDS of them, evenly spread.  steps: number of `mj_step` calls.  seconds: wall time in them.
    timestep: [s].  depth: (steps,) deepest penetration in each step [m].  weight: of all that moves [N].
    """

    instants: tuple[Instant, ...]
    steps: int
    seconds: float
    timestep: float
    depth: np.ndarray
    weight: float

    @property
    def steps_per_second(self) -> float:
        """Of `mj_step` alone, without drawing and logging."""
        return self.steps / self.seconds

    @property
    def real_time_factor(self) -> float:
        """Simulated time per wall time in `mj_step`."""
        return self.steps * self.timestep / self.seconds

    @property
    def penetration(self) -> float:
        """The deepest of the run [m]."""
        return float(self.depth.max())

    @property
    def final_penetration(self) -> float:
        """The deepest of the last second [m]."""
        return float(self.depth[-max(1, round(1 / self.timestep)) :].max())

    @property
    def energy(self) -> np.ndarray:
        """(k,) total energy at the instants [J]."""
        return np.array([instant.total for instant in self.instants])

    @property
    def motion(self) -> np.ndarray:
        """(k,) kinetic and potential energy at the instants [J]."""
        return np.array([instant.kinetic + instant.potential for instant in self.instants])

    @property
    def energy_scale(self) -> float:
        """The largest kinetic energy or difference of potential energies: what the run is about [J]."""
        potential = [instant.potential for instant in self.instants]
        return max(max(instant.kinetic for instant in self.instants), float(np.ptp(potential)))

    @property
    def motion_gain(self) -> float:
        """The most by which kinetic and potential energy together exceed the total energy of the start [J].

        Without the elastic energy, which is nothing to rely on where a material is very stiff: a step h that turns such
        a body by ω h stretches it by (ω h)²/2, and it stays so while it turns.
        """
        return max(0.0, float((self.motion - self.energy[0]).max()))

    @property
    def energy_gain(self) -> float:
        """The most by which the total energy ever exceeds that of the start [J]; 0 for a passive scene."""
        return float((self.energy - self.energy[0]).max())


def load_scene(path: str | os.PathLike[str]) -> tuple[mujoco.MjModel, mujoco.MjSpec]:
    """A scene from MJCF, and its spec; loads the plugin where the scene asks for it.

    Raises MjframesError with MuJoCo's reason where it cannot be loaded.
    """
    if not os.path.isfile(path):
        raise MjframesError(f"{path}: there is no such scene; give the path of an MJCF file (.xml).")
    with mujoco_warnings() as warnings:
        try:
            try:
                spec = mujoco.MjSpec.from_file(os.fspath(path))
            except ValueError as error:
                if plugin.NAME not in str(error) or plugin.is_loaded():
                    raise
                plugin.load()
                spec = mujoco.MjSpec.from_file(os.fspath(path))
            if any(other.plugin_name == plugin.NAME for other in spec.plugins) and (
                why := changed_masses(spec.compiler)
            ):
                raise MjframesError(f"{path}: the scene has soft bodies, and {why}.")
            return spec.compile(), spec
        except MjframesError:
            raise
        except (ValueError, mujoco.FatalError) as error:
            raise MjframesError(f"{path}: MuJoCo cannot load the scene ({_sentence(error, warnings)}).") from error


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
            raise MjframesError(f"MuJoCo cannot start the scene ({_sentence(error, warnings)}).") from error
        bodies = {name: view.soft(model, data, name) for name in view.soft_names(model)}
        draw = write = save_plot = None
        if video is not None:
            from mjframes.video import film

            draw = stack.enter_context(film(model, video, camera=camera, fps=fps, size=size))
        if log is not None:
            from mjframes.log import log_file

            write = stack.enter_context(log_file(log, tuple(bodies), scene))
        if plot is not None:
            from mjframes.plot import plot_file

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


def summary(recording: Recording) -> str:
    """The lines that `mjframes run` prints."""
    return "\n".join(
        (
            f"steps         {recording.steps} of {recording.timestep * 1e3:g} ms",
            f"speed         {recording.steps_per_second:.0f} steps/s, {recording.real_time_factor:.2f} × real time",
            f"penetration   {recording.penetration * 1e3:.3f} mm at most, "
            f"{recording.final_penetration * 1e3:.3f} mm in the last second",
            f"energy        {_balance(recording)}",
        )
    )


def _balance(recording: Recording) -> str:
    """What became of the energy that moved, in words."""
    scale = recording.energy_scale
    if scale <= STILL * recording.weight:
        return "nothing moved"
    change = recording.energy[0] - recording.motion[-1]
    end = f"{change:.3g} J less" if change >= 0 else f"{-change:.3g} J more"
    gain = recording.motion_gain
    above = f"{gain:.2g} J ({gain / scale:.1%})" if gain > NOTABLE * scale else "never"
    return (
        f"{scale:.3g} J moved; kinetic and potential energy are {end} at the end than at the start, "
        f"and {above} above it in between"
    )


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
def mujoco_warnings() -> Iterator[list[str]]:
    """Catches what MuJoCo warns of, instead of a file MUJOCO_LOG.TXT in the working directory."""
    caught: list[str] = []
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(caught.append)
    try:
        yield caught
    finally:
        mujoco.set_mju_user_warning(before)


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


def _sentence(error: Exception, warnings: list[str]) -> str:
    """The reason in one line: the plugin's own words where it has some, else MuJoCo's."""
    lines = [*warnings, *str(error).splitlines()]
    own = [line for line in lines if line.startswith(PLUGIN_WARNING)]
    text = own[-1].removeprefix(PLUGIN_WARNING) if own else (warnings or [str(error)])[-1]
    return " ".join(text.split()).rstrip(".")
