"""What a build will cost is told before it starts."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import trimesh

import mjframes as mf
from mjframes.base.errors import Notice
from mjframes.body import cost
from mjframes.cli.commands import main

FLESH = mf.Material(2e4, 0.45, 1000)

pytestmark = pytest.mark.usefixtures("uncached")  # what is kept needs no memory


def block() -> mf.Volume:
    return mf.Volume.from_labels(np.ones((20, 10, 10), int), 0.001, {1: FLESH})


def test_a_body_that_memory_will_not_hold_is_refused_before_anything_is_done(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cost, "available_memory", lambda: 1e6)
    stages: list[str] = []
    with pytest.raises(
        mf.MjframesError, match=r"^the volume has 2000 voxels, .* of 3 frames .* 0\.0 GB of memory"
    ) as told:
        mf.build(block(), 3, progress=stages.append)
    assert not stages
    found = re.search(r"take at most (\d+) voxels, as with --voxels or a spacing of (\S+) m\.$", str(told.value))
    assert found
    assert 200 < int(found[1]) < 1e6 / cost.BYTES[0]
    assert float(found[2]) == pytest.approx(0.001 * (2000 / int(found[1])) ** (1 / 3), rel=0.05)
    monkeypatch.setattr(cost, "available_memory", lambda: 1e7)
    mf.build(block(), 3)
    with pytest.raises(mf.MjframesError, match=r"the volume has 2000 voxels, .* of 20 frames"):
        mf.build(block())
    mf.build(block(), method="paper")


def test_a_long_build_is_announced(monkeypatch: pytest.MonkeyPatch, recwarn: pytest.WarningsRecorder) -> None:
    mf.build(block(), 3)
    assert not [some for some in recwarn if issubclass(some.category, Notice)]
    monkeypatch.setattr(cost, "SECONDS", (0.1, 0.1 / 3))
    with pytest.warns(
        Notice, match=r"^the volume has 2000 voxels: the build takes about 7 min and 0\.0 GB; fewer voxels"
    ) as told:
        mf.build(block(), 3)
    assert told[0].filename == __file__


def test_the_command_line_announces_it_before_and_refuses_in_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    block().save(tmp_path / "block.npz")
    command = ["build", str(tmp_path / "block.npz"), "--frames", "2", "-o", str(tmp_path / "block.xml")]
    monkeypatch.setattr(cost, "SECONDS", (0.1, 0))
    monkeypatch.setattr(cost, "available_memory", lambda: 1e6)
    assert main(command) == 2
    assert re.fullmatch(r"mjframes: the volume has 2000 voxels, for .*\.\n", capsys.readouterr().err)
    monkeypatch.setattr(cost, "available_memory", lambda: 1e9)
    assert main(command) == 0
    assert re.fullmatch(r"mjframes: the volume has 2000 voxels: .* 3 min .*\.\n", capsys.readouterr().err)


def test_a_grid_that_memory_will_not_hold_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mjframes.volume.spacing.available_memory", lambda: 1e6)
    ball = trimesh.creation.icosphere(radius=0.05)
    with pytest.raises(
        mf.MjframesError, match=r"which makes 1\.0e\+06 cells: these take about .* a spacing of 0\.0022 m"
    ):
        mf.Volume.from_meshes([(ball, FLESH)], 0.001)
    monkeypatch.setattr("mjframes.volume.spacing.available_memory", lambda: 1e7)
    mf.Volume.from_meshes([(ball, FLESH)], 0.001)
