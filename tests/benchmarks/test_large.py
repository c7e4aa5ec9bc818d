"""That large volumes are measured as said; never how long anything takes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from builders.pictures import picture, share

from benchmarks.speed import bench
from benchmarks.speed import large as bench_large
from benchmarks.speed.large import (
    Job,
    Measured,
    draw_growth,
    jobs_of,
    measure,
    measure_here,
    ring_file,
    standard_jobs,
)
from mjframes.base.cache import SWITCH
from mjframes.base.errors import MjframesError
from mjframes.cli.commands import exit_code
from mjframes.volume.volume import Volume


def test_a_mesh_fills_a_grid_of_so_many_cells(tmp_path: Path) -> None:
    job = Job(ring_file(str(tmp_path)), 400_000, 2, 3)
    (measured,) = measure([job], repeats=1)
    assert measured.job == job
    assert measured.cells == pytest.approx(400_000, rel=0.1)
    assert measured.voxels / measured.cells == pytest.approx(1 / 6, rel=0.1)
    assert measured.seconds > 0
    assert measured.memory > 10 * measured.cells  # labels and voxel numbers alone


@pytest.mark.slow
def test_a_volume_is_resampled(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(SWITCH, "0")  # as `measure_here` sets it, but for this test only
    measured = measure_here(Job(str(bench_large.STEAK), 30_000, 2))
    assert measured.voxels == np.count_nonzero(Volume.load(bench_large.STEAK).resample(30_000).labels)
    assert measured.processor > 0


def test_the_jobs_are_those_of_the_paper(tmp_path: Path) -> None:
    jobs = standard_jobs(str(tmp_path))
    assert [(job.count, job.frames, job.samples, job.paper) for job in jobs[1::2]] == [
        (500_000, 10, 200, ("knee", 11.0)),
        (1_500_000, 30, 230, ("rat", 90.0)),
        (7_000_000, 3, 6, ("dragon", 100.0)),
        (7_000_000, 10, 41, ("dragon", 220.0)),
        (7_000_000, 20, 158, ("dragon", 360.0)),
    ]
    assert jobs[::2] == [replace(job, samples=None) for job in jobs[1::2]]
    assert jobs_of(jobs[-1].source, None, [20]) == jobs[-2:-1]
    assert jobs_of(str(bench_large.STEAK), None, [10]) == jobs[:1]


def test_a_missing_file_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(MjframesError, match=r"missing\.ply: there is no such file"):
        jobs_of("missing.ply", None, [3])
    assert exit_code(lambda: bench.main(["missing.ply", "--cells", "7e6", "--frames", "3"])) == 2
    assert "missing.ply: there is no such file" in capsys.readouterr().err


def test_growth_is_drawn_and_printed(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    measured = [Measured(Job("ring.ply", n, 10), n, n // 6, n / 1e6, n / 8e5, 50 * n) for n in (10**4, 10**5, 10**6)]
    draw_growth(measured, tmp_path / "growth.png")
    shown = picture(tmp_path / "growth.png")
    assert min(share(shown, color) for color in ("C0", "C1")) > 3e-4
    table = bench.large_table(measured)
    assert table.row_count == 3
    assert list(table.columns[4].cells) == ["166,600", "166,660", "166,666"]
    assert list(table.columns[6].cells) == ["50", "50", "50"]
