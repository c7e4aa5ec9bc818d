"""The paper's Table 2 again: precomputation and steps per second of its models by its own method, its numbers beside.

Models that are neither at hand nor given are left out; `report.models` says what stands for the paper's.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from statistics import median

import mujoco

from benchmarks.solids.models import volume_of
from benchmarks.speed.bench import Size, measure_builds
from benchmarks.speed.step_scenes import soft_run
from benchmarks.speed.steps import Group
from benchmarks.speed.steps import measure as measure_steps
from mjframes.app.video import make_renderer
from mjframes.base.errors import MjframesError

# model, frames, samples: vertices, voxels, t_ini [s], frames a second
PAPER = {
    ("steak", 3, 10): ("5k", "67k", 3, 500),
    ("steak", 10, 53): ("5k", "67k", 8, 100),
    ("steak", 20, 140): ("5k", "67k", 12, 40),
    ("dragon", 3, 6): ("20k", "7M", 100, 300),
    ("dragon", 10, 41): ("20k", "7M", 220, 150),
    ("dragon", 20, 158): ("20k", "7M", 360, 27),
    ("ribbon", 5, 9): ("4k", "60k", 4, 200),
    ("knee", 10, 200): ("35k", "500k", 11, 10),
    ("rat", 30, 230): ("600k", "1.5M", 90, 8),
}
MODELS = tuple(dict.fromkeys(model for model, _, _ in PAPER))
STEPS = 400  # that are timed at once: it lands, bends over the edge of the box and comes to rest
WIDTH, HEIGHT = 640, 480  # [pixels]


@dataclass(frozen=True)
class Line:
    """One row of the table; steps and pictures a second, the latter 0 where nothing can be drawn here."""

    model: str
    frames: int
    samples: int
    vertices: int
    voxels: int
    build_seconds: float
    steps: float
    drawn: float


def measure(files: Mapping[str, str], quick: bool, progress: Callable[[str], None]) -> list[Line]:
    """Return the measured rows. files: model → path of a label image or a mesh.

    Raise MjframesError for other models and unusable files.
    """
    if unknown := set(files) - set(MODELS):
        raise MjframesError(f"model {sorted(unknown)[0]!r} is not in the table; it has {', '.join(MODELS)}.")
    lines = []
    for model in ("steak",) if quick and not files else MODELS:
        progress(f"table 2: {model}")
        volume = volume_of(model, files)
        if volume is None:
            continue
        sizes = [Size(frames, samples) for name, frames, samples in PAPER if name == model]
        bodies, buildings = measure_builds(volume, sizes, 1 if quick or model != "steak" else 3)
        for size, body, building in zip(sizes, bodies, buildings, strict=True):
            frames, samples = size
            assert samples is not None
            run = soft_run(model, body, "contact")
            (speed,) = measure_steps([Group(STEPS, (run,))], 3)
            lines.append(
                Line(
                    model,
                    frames,
                    samples,
                    len(body.skin.vertices),
                    body.voxels,
                    building.total,
                    1 / speed.step,
                    _drawn(run.model, run.data),
                )
            )
    return lines


def _drawn(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    """Steps a second when each is drawn."""
    try:
        renderer = make_renderer(model, WIDTH, HEIGHT)
    except MjframesError:
        return 0.0
    try:
        spent = []
        for _ in range(30):
            start = time.perf_counter()
            mujoco.mj_step(model, data)
            renderer.update_scene(data)
            renderer.render()
            spent.append(time.perf_counter() - start)
    finally:
        renderer.close()
    return 1 / median(spent)
