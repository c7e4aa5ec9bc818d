"""That large volumes are measured as said; never how long anything takes."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from benchmarks.solids.cases import STEAK
from benchmarks.speed import bench
from benchmarks.speed.large import Job, Measured, jobs_of, measure, measure_here, ring_file
from mjframes.base.cache import SWITCH
from mjframes.base.errors import MjframesError
from mjframes.cli.commands import exit_code
from mjframes.volume.volume import Volume


@pytest.mark.slow
def test_a_mesh_fills_a_grid_of_so_many_cells(tmp_path: Path) -> None:
    job = Job(ring_file(str(tmp_path)), 400_000, 2)
    (measured,) = measure([job], repeats=1)
    assert measured.job == job
    assert measured.cells == pytest.approx(400_000, rel=0.1)
    assert measured.voxels / measured.cells == pytest.approx(1 / 6, rel=0.1)
    assert measured.seconds > 0
    assert measured.memory > 10 * measured.cells  # labels and voxel numbers alone


@pytest.mark.slow
def test_a_volume_is_resampled(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(SWITCH, "1")
    measured = measure_here(Job(str(STEAK), 30_000, 2))
    assert measured.voxels == np.count_nonzero(Volume.load(STEAK).resample(30_000).labels)
    assert measured.processor > 0
    assert os.environ[SWITCH] == "1"  # others in this process keep what they build


def test_a_file_has_a_job_a_number_of_frames(tmp_path: Path) -> None:
    ring = ring_file(str(tmp_path))
    assert jobs_of(ring, None, [3, 20]) == [Job(ring, 7_000_000, 3), Job(ring, 7_000_000, 20)]
    assert jobs_of(str(STEAK), None, [10]) == [Job(str(STEAK), 500_000, 10)]
    assert jobs_of(str(STEAK), 9000, [10]) == [Job(str(STEAK), 9000, 10)]


def test_a_missing_file_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(MjframesError, match=r"missing\.ply: there is no such file"):
        jobs_of("missing.ply", None, [3])
    assert exit_code(lambda: bench.main(["missing.ply", "--cells", "7e6", "--frames", "3"])) == 2
    assert "missing.ply: there is no such file" in capsys.readouterr().err


def test_the_table_has_rates_and_bytes_a_cell() -> None:
    measured = [Measured(Job("ring.ply", n, 10), n, n // 6, n / 1e6, n / 8e5, 50 * n) for n in (10**4, 10**5, 10**6)]
    table = bench.large_table(measured)
    assert table.row_count == 3
    assert list(table.columns[4].cells) == ["166,600", "166,660", "166,666"]
    assert list(table.columns[6].cells) == ["50", "50", "50"]
