"""The figure of a run: energies, penetration, contact force and speed over time."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mjframes.base.errors import MjframesError
from mjframes.base.files import replacing
from mjframes.base.packages import optional

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from mjframes.app.recording import Recording

FORMATS = (".png", ".pdf", ".svg")
RESOLUTION = 120  # [dots per inch] of a .png: 1440 pixels wide


@contextmanager
def plot_file(path: str | os.PathLike[str]) -> Iterator[Callable[[Recording], None]]:
    """A function that draws a recording; raises what `figure_file` does."""
    with figure_file(path, (12, 7.5)) as figure:
        yield lambda recording: _draw(recording, figure)


@contextmanager
def figure_file(path: str | os.PathLike[str], size: tuple[float, float]) -> Iterator[Figure]:
    """An empty figure of a size [inch]; its file (.png, .pdf, .svg) appears when the block succeeds.

    Raises MjframesError where matplotlib is missing, for another ending, or where the file cannot be written.
    """
    Figure = optional("matplotlib.figure", "a plot", "plot").Figure
    if Path(path).suffix.lower() not in FORMATS:
        raise MjframesError(f"{path}: a plot is written as .png, .pdf or .svg; give the path one of these endings.")
    with replacing(path, "the plot") as partial:
        figure = Figure(figsize=size, layout="constrained")
        yield figure
        figure.savefig(partial, dpi=RESOLUTION)


def _draw(recording: Recording, figure: Figure) -> None:
    def series(name: str) -> np.ndarray:
        return np.array([getattr(instant, name) for instant in recording.instants])

    time = series("time")
    grid = figure.subplots(2, 2, sharex=True)
    energy, depth, force, speed = grid.ravel()

    potential = series("potential")
    elastic = [sum(instant.elastic.values()) for instant in recording.instants]
    energy.plot(time, series("kinetic"), label="kinetic")
    energy.plot(time, potential - potential[0], label="gravity and springs, from the start")
    if recording.instants[0].elastic:
        energy.plot(time, elastic, label="elastic")
    energy.plot(time, recording.energy - recording.energy[0], "k--", label="total, from the start")
    _label(energy, "energy", "J")
    energy.legend(fontsize="small")

    depth.plot(time, series("penetration") * 1e3, color="tab:red", linewidth=1)
    depth.set_ylim(bottom=0)
    _label(depth, "greatest penetration", "mm")

    curves = _force_curves(recording)
    for label, curve in curves.items():
        force.plot(time, curve, linewidth=1, label=label)
    force.axhline(recording.weight, color="k", linestyle="--", label="weight of all that moves")
    settled = max(np.percentile(curve, 99) for curve in curves.values()) if len(time) > 1 else 0.0
    force.set_ylim(0, 1.3 * max(settled, recording.weight, 1e-9))  # an impact may go beyond: the rest shall be seen
    _label(force, "normal contact force", "N")
    force.legend(fontsize="small")

    speed.plot(time, series("speed"), color="tab:green")
    speed.set_ylim(bottom=0)
    _label(speed, "fastest body", "m/s")
    for axes in grid[1]:
        axes.set_xlabel("time [s]")
    title = f"{recording.steps} steps of {recording.timestep * 1e3:g} ms"
    if not math.isnan(recording.seconds):
        title += f", {recording.steps_per_second:.0f} steps/s ({recording.real_time_factor:.2f} × real time)"
    figure.suptitle(title)


def _force_curves(recording: Recording) -> dict[str, np.ndarray]:
    """Normal contact forces [N] over the instants: on each soft body, and what rigid ones put on each other."""
    instants = recording.instants
    soft = {f"on {name}": np.array([i.soft_force[name] for i in instants]) for name in instants[0].soft_force}
    return {**soft, f"between {'others' if soft else 'all'}": np.array([i.rigid_force for i in instants])}


def _label(axes: Axes, title: str, unit: str) -> None:
    axes.set_title(title, fontsize="medium", loc="left")
    axes.set_ylabel(f"[{unit}]")
    axes.grid(alpha=0.3)
