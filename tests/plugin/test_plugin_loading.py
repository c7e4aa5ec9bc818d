"""The plugin's library: found, compiled, loaded; each test works in a cache of its own, on a plugin of a few lines."""

from __future__ import annotations

import importlib.metadata
import os
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import mujoco
import pytest

from mjframes.base.errors import MjframesError
from mjframes.base.files import cache_directory
from mjframes.scene import plugin

REPOSITORY = Path(__file__).parents[2]
TINY_PLUGIN = """
#include <mujoco/mujoco.h>

mjPLUGIN_LIB_INIT(mjframes_soft) {
  mjpPlugin plugin;
  mjp_defaultPlugin(&plugin);
  plugin.name = "mjframes.soft";
  plugin.capabilityflags = mjPLUGIN_PASSIVE;
  plugin.nstate = [](const mjModel*, int) { return 0; };
  plugin.init = [](const mjModel*, mjData*, int) { return 0; };
  plugin.reset = [](const mjModel*, mjtNum*, void*, int) {};
  plugin.compute = [](const mjModel*, mjData*, int, int) {};
  mjp_registerPlugin(&plugin);
}
"""
IS_REGISTERED = """
mujoco.MjModel.from_xml_string('<mujoco><extension><plugin plugin="mjframes.soft"/></extension></mujoco>')
"""


@pytest.fixture
def sources(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A directory with a tiny plugin, which takes the place of the shipped sources, and an empty cache."""
    directory = tmp_path / "plugin"
    directory.mkdir()
    (directory / "register.cc").write_text(TINY_PLUGIN)
    shutil.copy(plugin.source_directory() / plugin.FLAGS_FILE, directory)
    monkeypatch.setattr(plugin, "_PACKAGED", directory)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv(plugin.LIBRARY_VARIABLE, raising=False)
    return directory


def run_python(code: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-W", "error::RuntimeWarning", "-c", code]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_the_library_is_compiled_once_and_kept(sources: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    library = plugin.library_path()
    assert library.parent == cache_directory()
    assert mujoco.mj_versionString() in library.name
    monkeypatch.setenv("CXX", "no-such-compiler")
    assert plugin.library_path() == library


def test_a_library_beside_the_sources_needs_no_compiler(sources: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    packaged = sources / plugin.library_name(sources)
    packaged.touch()
    monkeypatch.setenv("CXX", "no-such-compiler")
    assert plugin.library_path() == packaged


def test_a_mujoco_newer_than_the_wheel_is_compiled_for_with_a_sentence(
    sources: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    for version in ("3.9.0", "3.17.0", "3.10.0"):
        (sources / plugin.library_name(sources, version)).touch()
    (sources / "libmjframes_soft-9.9.9-000000000000.so").touch()  # of other sources
    mine = sources / plugin.library_name(sources)
    mine.unlink(missing_ok=True)
    ready = " and ".join(v for v in ("3.9.0", "3.10.0", "3.17.0") if v != mujoco.mj_versionString())
    assert plugin.library_path().parent == cache_directory()
    assert (
        f"for MuJoCo {mujoco.mj_versionString()}, as mjframes comes with libraries for MuJoCo {ready} only"
        in capfd.readouterr().err
    )


def test_without_a_compiler_a_mujoco_that_needs_none_is_named(sources: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (sources / plugin.library_name(sources, "3.99.0")).touch()
    monkeypatch.setenv("CXX", "no-such-compiler")
    with pytest.raises(MjframesError, match=r"apt-get install g\+\+.* or install .*: pip install mujoco==3\.99\.0\.$"):
        plugin.library_path()


@pytest.mark.parametrize("edited", ["register.cc", plugin.FLAGS_FILE])
def test_an_edit_makes_the_library_stale(sources: Path, edited: str) -> None:
    before = plugin.library_name(sources)
    (sources / before).touch()
    with (sources / edited).open("a") as file:
        file.write("\n")
    assert plugin.library_name(sources) != before
    assert plugin.library_path() != sources / before


def test_callers_at_the_same_time_compile_once(sources: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    compilations: list[Path] = []
    compile_ = plugin._compile

    def counted(*arguments: Any) -> None:
        compilations.append(arguments[-1])
        compile_(*arguments)

    monkeypatch.setattr(plugin, "_compile", counted)
    with ThreadPoolExecutor(4) as pool:
        libraries = set(pool.map(lambda _: plugin.library_path(), range(4)))
    assert libraries == set(compilations)
    assert len(compilations) == 1
    assert not [path for path in cache_directory().iterdir() if path.is_dir()]


def test_what_a_killed_compilation_left_goes_with_the_next_one(sources: Path) -> None:
    left, other = (cache_directory() / name for name in ("compiling-left", "mine"))
    for folder in (left, other):
        folder.mkdir(parents=True)
        (folder / "register.o").touch()
    plugin.library_path()
    assert [path for path in cache_directory().iterdir() if path.is_dir()] == [other]


@pytest.mark.parametrize("damage", ["truncated", "changed", "without its digest"])
def test_a_damaged_library_is_compiled_again(sources: Path, damage: str) -> None:
    library = plugin.library_path()
    content = library.read_bytes()
    middle = len(content) // 2
    if damage == "truncated":
        os.truncate(library, middle)
    elif damage == "changed":
        library.write_bytes(content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :])
    else:
        library.with_suffix(".sha256").unlink()
    damaged = library.stat().st_ino, library.read_bytes()
    assert plugin.library_path() == library
    assert (library.stat().st_ino, library.read_bytes()) != damaged
    loaded = run_python(  # MuJoCo 4 loads the chosen one on import
        f"import os; os.environ[{plugin.LIBRARY_VARIABLE!r}] = {str(library)!r}; import mujoco\n"
        f"mujoco.mj_loadPluginLibrary({str(library)!r}){IS_REGISTERED}"
    )
    assert (loaded.returncode, loaded.stderr) == (0, "")


def test_cmake_names_the_library_as_python_does(tmp_path: Path) -> None:
    cmake = shutil.which("cmake", path=f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    if cmake is None:
        pytest.skip("no cmake")
    python = f"-DPython_EXECUTABLE={sys.executable}"
    command = [cmake, "-S", REPOSITORY / "plugin", "-B", tmp_path, "-G", "Unix Makefiles", python]
    subprocess.run(command, check=True, capture_output=True)
    (build_file,) = tmp_path.glob("CMakeFiles/mjframes_soft-*.dir/build.make")
    build_files = build_file.read_text()
    assert plugin.library_name(REPOSITORY / "plugin") in build_files


def test_without_a_compiler_the_sentence_says_what_to_install(sources: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("CXX", raising=False)
    monkeypatch.setenv("PATH", "/nonexistent")
    with pytest.raises(MjframesError, match=r"no C\+\+ compiler found.*apt-get install g\+\+.*CXX"):
        plugin.library_path()


def test_a_compiler_that_is_no_command_is_named(sources: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CXX", "no-such-compiler -m64")
    with pytest.raises(MjframesError, match="'no-such-compiler -m64'"):
        plugin.library_path()


def test_a_failed_compilation_names_its_log_and_leaves_no_library(sources: Path) -> None:
    (sources / "broken.cc").write_text("int broken(")
    with pytest.raises(MjframesError, match=r"cannot compile the plugin.*see .*\.log"):
        plugin.library_path()
    (log,) = cache_directory().glob("*.log")
    assert "broken.cc" in log.read_text()
    assert not list(cache_directory().glob("**/*.so"))


def test_a_cache_that_cannot_be_written_is_named(sources: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(sources / "register.cc"))
    with pytest.raises(MjframesError, match=r"register\.cc.*set XDG_CACHE_HOME"):
        plugin.library_path()


def test_the_variable_chooses_the_library(sources: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    chosen = sources / "chosen.so"
    monkeypatch.setenv(plugin.LIBRARY_VARIABLE, str(chosen))
    with pytest.raises(MjframesError, match=rf"{plugin.LIBRARY_VARIABLE} names .*chosen\.so"):
        plugin.library_path()
    chosen.touch()
    assert plugin.library_path() == chosen


@pytest.mark.parametrize("content", ["", "int other;"], ids=["no library", "no plugin"])
def test_a_wrong_library_is_refused_by_a_sentence(sources: Path, monkeypatch: pytest.MonkeyPatch, content: str) -> None:
    chosen = sources / "chosen.so"
    if content:
        (sources / "register.cc").write_text(content)
        chosen = plugin.library_path()
    else:
        chosen.touch()
    monkeypatch.setenv(plugin.LIBRARY_VARIABLE, str(chosen))
    monkeypatch.setattr(plugin, "is_loaded", lambda: False)
    with pytest.raises(MjframesError, match=rf"cannot load {chosen}|{chosen} does not register"):
        plugin.load()


def test_a_library_that_is_cut_off_is_refused_by_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Loading it would end the process with a bus error."""
    whole, cut = plugin.library_path(), tmp_path / "cut.so"
    monkeypatch.setenv(plugin.LIBRARY_VARIABLE, str(cut))
    monkeypatch.setattr(plugin, "is_loaded", lambda: False)
    for kept in (0.2, 0.5, 0.95):
        cut.write_bytes(whole.read_bytes()[: int(kept * whole.stat().st_size)])
        with pytest.raises(MjframesError, match=rf"{cut} is cut off, .*; delete it and install mjframes again"):
            plugin.load()


def test_a_program_needs_only_mujoco_and_the_library() -> None:
    done = run_python(f"import mujoco\nmujoco.mj_loadPluginLibrary({str(plugin.library_path())!r}){IS_REGISTERED}")
    assert done.returncode == 0, done.stderr


def test_a_plugin_that_is_loaded_is_not_loaded_again(sources: Path) -> None:
    # MuJoCo refuses a second plugin of that name with other functions. MuJoCo 4 loads the chosen one on import.
    other = plugin.library_path()
    done = run_python(
        f"import os\nos.environ[{plugin.LIBRARY_VARIABLE!r}] = {str(other)!r}\nimport mujoco\n"
        f"mujoco.mj_loadPluginLibrary({str(other)!r})\ndel os.environ[{plugin.LIBRARY_VARIABLE!r}]\n"
        "from mjframes import plugin\nplugin.load()"
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_numbers_are_read_alike_in_every_locale(tmp_path: Path) -> None:
    if shutil.which("localedef") is None:
        pytest.skip("no locale with a comma can be made without localedef")
    made = subprocess.run(["localedef", "-i", "de_DE", "-f", "UTF-8", str(tmp_path / "de_DE.UTF-8")], check=False)
    if made.returncode:
        pytest.skip("the system has no sources of locales")
    code = """
import locale
locale.setlocale(locale.LC_NUMERIC, "de_DE.UTF-8")
assert locale.localeconv()["decimal_point"] == ","
import mujoco, numpy as np, mjframes as mf
volume = mf.Volume.from_labels(np.ones((4, 2, 2), int), 0.01, {1: mf.Material(1e4, 0.4, 1000)})
spec = mujoco.MjSpec()
mf.attach(spec, mf.build(volume, 1, damping=(0.5, 0.001)), "soft")
mujoco.MjModel.from_xml_string(spec.to_xml())
"""
    environment = {**os.environ, "LOCPATH": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_loading_twice_is_loading_once() -> None:
    plugin.load()
    plugin.load()
    assert plugin.is_loaded()


@pytest.mark.parametrize("first", ["mujoco", "mjframes", "mjframes.scene.plugin", "mjframes.app.doctor"])
def test_the_plugin_is_there_whatever_is_imported_first(first: str) -> None:
    done = run_python(f"import {first}\nimport mjframes, mujoco{IS_REGISTERED}")
    assert done.returncode == 0, done.stderr


def test_mujoco_4_loads_the_plugin_by_itself() -> None:
    (entry,) = [e for e in importlib.metadata.entry_points(group="mujoco.plugins") if e.name == "mjframes"]
    assert entry.load() is plugin.load
    if int(mujoco.mj_versionString().split(".")[0]) >= 4:
        done = run_python(f"import mujoco{IS_REGISTERED}")
        assert done.returncode == 0, done.stderr
