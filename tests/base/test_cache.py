"""The cache of stages: what makes a key, what is kept, and that it never gets in the way."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from mjframes.base import cache
from mjframes.base.cache import cached, digest, stage_directory
from mjframes.body.build import build
from mjframes.scene.plugin import library_path
from mjframes.volume import voxelize
from mjframes.volume.material import Material
from mjframes.volume.meshes import MeshWarning
from mjframes.volume.volume import Volume

FLESH = Material(3e4, 0.45, 1000)


@pytest.fixture(autouse=True)
def empty(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv("MJFRAMES_CACHE", raising=False)
    monkeypatch.setattr(cache, "WORTHWHILE", 0.0)


class Stage:
    """A stage that counts how often it is computed."""

    def __init__(self, size: int = 4) -> None:
        self.runs = 0
        self.arrays = {"values": np.arange(size), "labels": np.asfortranarray(np.eye(3, dtype=np.uint8)[:, :2])}

    def __call__(self) -> dict[str, np.ndarray]:
        self.runs += 1
        return self.arrays


def entries() -> list[Path]:
    return sorted(stage_directory().iterdir())


def test_a_stage_is_computed_once() -> None:
    stage = Stage()
    first, second = (cached("stage", (1, "a"), stage) for _ in range(2))
    assert stage.runs == 1
    for name, array in stage.arrays.items():
        for result in (first, second):
            np.testing.assert_array_equal(result[name], array)
            assert result[name].dtype == array.dtype
    cached("other", (1, "a"), stage)
    cached("stage", (2, "a"), stage)
    assert stage.runs == 3
    assert len(entries()) == 3


def test_values_that_differ_have_different_digests(tmp_path: Path) -> None:
    one, two = tmp_path / "one", tmp_path / "two"
    one.write_bytes(b"mesh")
    two.write_bytes(b"mess")
    values = [
        None, False, True, 0, 1, -1, 0.0, -0.0, 1.0, np.nextafter(1.0, 2.0), "", "1", "a", "ab", b"", b"a",
        (), ("a", "b"), ("ab",), (("a",), "b"), ("a", ("b",)), {}, {"a": 1}, {"a": 2}, {1: "a"},
        np.zeros(3), np.zeros((3, 1)), np.zeros(3, np.float32), np.zeros(3, np.int64), np.float32(0), np.ones(3),
        np.array([1, 0, 0.0]), Material(1e4, 0.4, 1000), Material(1e4, 0.4, 1001), one, two,
    ]  # fmt: skip
    assert len({digest(value) for value in values}) == len(values)


def test_the_content_counts(tmp_path: Path) -> None:
    array = np.arange(24).reshape(4, 6)
    assert digest(array.T) == digest(np.ascontiguousarray(array.T)) != digest(array)
    assert digest({"a": 1, "b": 2}) == digest({"b": 2, "a": 1})
    one, two = tmp_path / "one", tmp_path / "two"
    one.write_bytes(b"mesh")
    two.write_bytes(b"mesh")
    assert digest(one) == digest(two)
    for value in (object(), np.array([object()]), {1, 2}, len):
        with pytest.raises(TypeError):
            digest(value)


@pytest.mark.parametrize("damage", ["empty", "half", "bit", "text"])
def test_a_damaged_entry_is_computed_again(damage: str) -> None:
    stage = Stage(1000)
    cached("stage", (), stage)
    (entry,) = entries()
    content = bytearray(entry.read_bytes())
    if damage == "bit":
        content[len(content) // 3] ^= 1
    entry.write_bytes({"empty": b"", "half": content[: len(content) // 2], "bit": content, "text": b"no zip"}[damage])
    np.testing.assert_array_equal(cached("stage", (), stage)["values"], stage.arrays["values"])
    assert stage.runs == 2
    cached("stage", (), stage)
    assert stage.runs == 2  # and it is whole again


def test_quick_stages_are_not_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cache, "WORTHWHILE", 10.0)
    stage = Stage()
    cached("stage", (), stage)
    cached("stage", (), stage)
    assert stage.runs == 2
    assert not stage_directory().exists()


def test_the_environment_switches_it_off(monkeypatch: pytest.MonkeyPatch) -> None:
    stage = Stage()
    cached("stage", (), stage)
    monkeypatch.setenv("MJFRAMES_CACHE", "0")
    cached("stage", (), stage)
    assert stage.runs == 2


def test_a_directory_that_cannot_be_written_does_no_harm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    stage = Stage()
    np.testing.assert_array_equal(cached("stage", (), stage)["values"], stage.arrays["values"])


def test_an_error_leaves_nothing_behind() -> None:
    def fails() -> dict[str, np.ndarray]:
        raise ValueError("no mesh")

    with pytest.raises(ValueError, match="no mesh"):
        cached("stage", (), fails)
    assert not stage_directory().exists()


def test_a_missing_input_is_left_to_the_stage(tmp_path: Path) -> None:
    stage = Stage()
    cached("stage", (tmp_path / "none.ply",), stage)
    cached("stage", (tmp_path / "none.ply",), stage)
    assert stage.runs == 2


def test_the_least_recently_used_entries_go(monkeypatch: pytest.MonkeyPatch) -> None:
    stage = Stage()
    for number in range(3):
        cached("stage", (number,), stage)
    size = entries()[0].stat().st_size
    for age, entry in enumerate(entries()):
        os.utime(entry, (time.time() - 100 - age, time.time() - 100 - age))
    cached("stage", (0,), stage)  # used now
    assert stage.runs == 3
    monkeypatch.setattr(cache, "LIMIT", int(2.5 * size))
    cached("stage", (3,), stage)
    assert len(entries()) == 2
    cached("stage", (0,), stage)
    cached("stage", (3,), stage)
    assert stage.runs == 4


def test_what_a_dead_process_left_goes() -> None:
    stage_directory().mkdir(parents=True)
    old, new = (stage_directory() / f"{name}{cache.PARTIAL}" for name in ("old", "new"))
    for path in (old, new):
        path.write_bytes(b"half an entry")
    os.utime(old, (0, 0))
    cached("stage", (), Stage())
    assert not old.exists()
    assert new.exists()  # somebody may be writing it


def test_many_at_once() -> None:
    stage = Stage(10_000)
    with ThreadPoolExecutor(8) as pool:
        results = list(pool.map(lambda number: cached("stage", (number % 2,), stage)["values"], range(40)))
    for result in results:
        np.testing.assert_array_equal(result, stage.arrays["values"])
    assert len(entries()) == 2


def test_an_edit_of_the_package_meets_no_old_entries(monkeypatch: pytest.MonkeyPatch) -> None:
    stage = Stage()
    cached("stage", (), stage)
    monkeypatch.setattr(cache, "_program", lambda module: "another version")
    cached("stage", (), stage)
    assert stage.runs == 2


STAGES = ("mjframes.surface.isosurface", "mjframes.volume.volume")
LIBRARY = str(library_path())  # else it is compiled into each empty cache
LOADED = "import sys, {}; print(*[name for name in sys.modules if name.startswith('mjframes.')])"


@pytest.mark.parametrize("module", STAGES)
def test_a_stage_depends_on_what_it_imports(module: str) -> None:
    def loaded(*names: str) -> set[str]:
        command = [sys.executable, "-c", LOADED.format(", ".join(names))]
        environment = {**os.environ, "MJFRAMES_PLUGIN_LIBRARY": LIBRARY}
        done = subprocess.run(command, check=True, capture_output=True, text=True, env=environment)
        return set(done.stdout.split())

    found = cache.sources_of(module).keys()
    assert module in found
    assert loaded("mjframes", module) - loaded("mjframes") <= found
    assert not [name for name in found if name.startswith(("mjframes.body", "mjframes.weights", "mjframes.scene"))]


def test_a_stage_depends_on_what_it_imports_late() -> None:
    assert "mjframes.volume.voxelize" in cache.sources_of("mjframes.volume.volume")  # in a method


def test_of_other_packages_every_source_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    every = cache.sources_of(__name__)
    assert len(every) > 100
    assert cache.sources_of("mjframes.app.doctor") == every  # imports mjframes as a whole


def test_an_edit_of_what_a_stage_imports_changes_its_key(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.py").write_text("from mjframes.room import (\n    b,\n)\n")
    (tmp_path / "b.py").write_text("ONE = 1\n")
    (tmp_path / "c.py").write_text("TWO = 2\n")
    modules = {f"mjframes.room.{name}": tmp_path / f"{name}.py" for name in "abc"}
    (tmp_path / "room.py").write_text("")
    monkeypatch.setattr(cache, "_modules", lambda: {**modules, "mjframes.room": tmp_path / "room.py"})

    def key() -> str:
        return digest(cache.sources_of("mjframes.room.a"))

    first = key()
    (tmp_path / "c.py").write_text("TWO = 3\n")
    assert key() == first
    (tmp_path / "b.py").write_text("ONE = 2\n")
    assert key() != first


def test_another_number_of_frames_takes_the_same_surface(monkeypatch: pytest.MonkeyPatch) -> None:
    from mjframes.surface import isosurface as stages

    extracted = []
    original = stages.extract_surface
    monkeypatch.setattr(stages, "extract_surface", lambda *of: extracted.append(1) or original(*of))
    labels = np.ones((12, 6, 4), int)
    volume = Volume.from_labels(labels, 0.01, {1: Material(1e4, 0.4, 1000)})
    two, three = build(volume, 2), build(volume, 3)
    assert len(extracted) == 1
    np.testing.assert_array_equal(two.skin.vertices, three.skin.vertices)
    labels[0, 0, 0] = 0
    build(Volume.from_labels(labels, 0.01, {1: Material(1e4, 0.4, 1000)}), 2)
    assert len(extracted) == 2


def test_meshes_are_voxelized_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    runs = []
    original = voxelize.voxelize
    monkeypatch.setattr(voxelize, "voxelize", lambda *arguments: runs.append(1) or original(*arguments))
    path = tmp_path / "box.stl"

    def write(extents: tuple[float, float, float]) -> None:
        mesh = trimesh.creation.box(extents)
        mesh.invert()
        mesh.export(path)

    def make(frames: int, **settings: Any) -> Volume:
        with pytest.warns(MeshWarning, match="inside out"):  # again each time
            volume = Volume.from_meshes([(str(path), FLESH)], **(settings or {"voxels": 500}))
        build(volume, frames)
        return volume

    write((0.2, 0.05, 0.05))
    first, second = make(2), make(3)
    assert len(runs) == 1
    for name in ("labels", "spacing", "origin"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
    assert first.labels.dtype == second.labels.dtype
    write((0.2, 0.05, 0.04))
    assert make(2).labels.shape != first.labels.shape
    assert len(runs) == 2
    for settings in ({"voxels": 400}, {"voxels": 500, "scale": 2.0}, {"spacing": 0.01}, {"voxels": 500, "fill": FLESH}):
        make(2, **settings)
    assert len(runs) == 6


def test_arrays_of_a_mesh_count_too(monkeypatch: pytest.MonkeyPatch) -> None:
    runs = []
    original = voxelize.voxelize
    monkeypatch.setattr(voxelize, "voxelize", lambda *arguments: runs.append(1) or original(*arguments))
    for width in (0.05, 0.05, 0.06):
        Volume.from_meshes([(trimesh.creation.box((0.2, width, 0.05)), FLESH)], 0.01)
    assert len(runs) == 2
