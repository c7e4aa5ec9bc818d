"""Precomputation of large volumes: time and memory.

From a mesh file or a volume to the saved soft body. Each measurement has a process of its own, which builds a small
body first, so that all kernels are compiled, and then reports the growth of its largest resident size. Nothing is taken
from the cache of stages. The body is a ring of about a million voxels unless a file is given.
"""

from __future__ import annotations

import resource
import sys
import tempfile
import time
import warnings
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from benchmarks.contenders.frames import nothing_kept
from mjframes.base.errors import MjframesError
from mjframes.body.build import build
from mjframes.volume.material import Material
from mjframes.volume.meshes import MESH_TYPES
from mjframes.volume.volume import Volume

RUBBER = Material(young=1e5, poisson=0.4, density=1000)
REPEATS = 2  # of which the faster counts: nothing makes a machine faster than it is
CELLS, VOXELS = 7_000_000, 500_000  # of a mesh's grid, and inside a volume, where no number is given


@dataclass(frozen=True)
class Job:
    """A body to build.

    source: a mesh, of which the bounding grid has so many cells, or a volume, of which so many voxels are inside.
    frames: of the body.
    """

    source: str
    count: int
    frames: int


@dataclass(frozen=True)
class Measured:
    """What a job took.

    cells: of the grid.
    voxels: inside.
    seconds: wall time [s].
    processor: time of all threads [s].
    memory: [bytes].
    """

    job: Job
    cells: int
    voxels: int
    seconds: float
    processor: float
    memory: int

    @property
    def rate(self) -> float:
        """Return the voxels a second."""
        return self.voxels / self.seconds


def jobs_of(source: str, count: int | None, frames: Sequence[int]) -> list[Job]:
    """Return jobs of a mesh (.obj .stl .ply .off .glb) in `count` cells, or a label image with materials of
    `count` voxels inside.

    Raise MjframesError if there is no such file.
    """
    if not Path(source).is_file():
        raise MjframesError(f"{source}: there is no such file; give a mesh or a volume with materials.")
    count = count or (CELLS if _is_mesh(source) else VOXELS)
    return [Job(source, count, f) for f in frames]


def ring_file(folder: str) -> str:
    """Write a tilted ring of 0.3 m, a mesh of 24,000 triangles whose box is one sixth full, as the paper's dragon's."""
    from mjframes.base.trimeshes import trimesh

    ring = trimesh.creation.torus(0.12, 0.035, major_sections=200, minor_sections=60)
    ring.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 4, [1, 1, 0]))
    path = str(Path(folder) / "ring.ply")
    ring.export(path)
    return path


def measure(jobs: Sequence[Job], repeats: int = REPEATS) -> Iterator[Measured]:
    """Yield what each job takes, one after the other."""
    context = get_context("spawn")
    with ProcessPoolExecutor(1, context, max_tasks_per_child=1) as pool:
        for job in jobs:
            found = [pool.submit(measure_here, job).result() for _ in range(repeats)]
            yield min(found, key=lambda measured: measured.seconds)


@nothing_kept()
def measure_here(job: Job) -> Measured:
    """Measure a job in this process, once: from the file to the saved body."""
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what a mesh lacks is not the question here
        path = str(Path(folder) / "body.npz")
        _build(replace(job, count=20_000, frames=min(job.frames, 3)), path)
        before = _peak()
        wall, processor = time.perf_counter(), time.process_time()
        volume = _build(job, path)
        wall, processor = time.perf_counter() - wall, time.process_time() - processor
        after = _peak()
    voxels = int(np.count_nonzero(volume.labels))
    return Measured(job, volume.labels.size, voxels, wall, processor, after - before)


def _peak() -> int:
    """Largest resident size of this process [bytes]."""
    status = Path("/proc/self/status")
    if status.is_file():  # Linux hands ru_maxrss on to the programs that a process starts
        return 1024 * int(next(line for line in status.read_text().splitlines() if line.startswith("VmHWM")).split()[1])
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def _is_mesh(source: str) -> bool:
    return Path(source).suffix.lower() in MESH_TYPES


def _build(job: Job, path: str) -> Volume:
    if _is_mesh(job.source):
        volume = Volume.from_meshes([(job.source, RUBBER)], spacing=_spacing(job.source, job.count))
    else:
        volume = Volume.load(job.source).resample(job.count)
    volume = volume.largest_component()
    build(volume, job.frames).save(path)
    return volume


def _spacing(mesh: str, cells: int) -> float:
    """[m] at which the mesh's bounding box has so many cells."""
    from mjframes.base.trimeshes import trimesh

    low, high = trimesh.load_scene(mesh, process=False).bounds
    return float(np.prod(high - low) / cells) ** (1 / 3)
