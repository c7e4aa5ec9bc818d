"""Finds, compiles and loads the engine plugin `mjframes.soft`.

An engine plugin works only with the very MuJoCo it was compiled for, so a library's name carries that version and a
digest of its sources: libmjframes_soft-<MuJoCo version>-<digest>.so. A wheel holds the sources, and a library for each
MuJoCo that was out when it was made. Where none fits the installed MuJoCo, and in a checkout always, the sources are
compiled once into a cache of the user, without CMake. A digest of what was compiled lies beside it: a library that is
cut off, as where a disk was full, would end the process that loads it, so that it is compiled again.
"""

from __future__ import annotations

import hashlib
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import mujoco

from mjframes.base.errors import MjframesError, reason
from mjframes.base.files import cache_directory

NAME = "mjframes.soft"
SENSOR_NAME = "mjframes.sensor"  # in the same library
FORCE_SENSOR_NAME = "mjframes.force_sensor"
PATCH_NAME = "mjframes.patch"
TENDON_NAME = "mjframes.tendon"
FLAGS_FILE = "compile_flags.txt"  # CMake and clangd read it too
LIBRARY_VARIABLE = "MJFRAMES_PLUGIN_LIBRARY"  # names a library to use instead, for example one with sanitizers

SCRATCH = "compiling-"  # begins the names of folders that compilations work in
LOCK = "compiling.lock"  # of the cache: one process at a time compiles into it

_PACKAGED = Path(__file__).parents[1] / "_plugin"  # in an installed wheel: sources and a library
_CHECKOUT = Path(__file__).parents[2] / "plugin"

_loading = threading.Lock()


def load() -> None:
    """Load the plugin into MuJoCo, once; do nothing where something else has loaded it already.

    Raise MjframesError where no library fits and none can be compiled, or where MuJoCo cannot load it.
    """
    with _loading:
        if is_loaded():
            return
        path = library_path()
        if _is_cut_off(path):
            raise MjframesError(
                f"{path} is cut off, as where a disk was full; delete it and install mjframes again, or unset "
                f"{LIBRARY_VARIABLE}."
            )
        try:
            mujoco.mj_loadPluginLibrary(str(path))
        except mujoco.FatalError as error:
            raise MjframesError(
                f"MuJoCo {mujoco.mj_versionString()} cannot load {path} ({reason(error)}); "
                "delete that file to have it made again."
            ) from error
        if not is_loaded():
            raise MjframesError(f"{path} does not register {NAME}; it must be a library built from mjframes' plugin.")


def is_loaded() -> bool:
    """Return whether MuJoCo knows the plugin, whoever loaded it."""
    try:
        mujoco.MjModel.from_xml_string(f'<mujoco><extension><plugin plugin="{NAME}"/></extension></mujoco>')
    except ValueError:
        return False
    return True


def library_path() -> Path:
    """Return the library for the installed MuJoCo; compile it first where there is none yet.

    A program that does not import mjframes hands it to `mujoco.mj_loadPluginLibrary`.
    Raise MjframesError where no library fits and none can be compiled.
    """
    if chosen := os.environ.get(LIBRARY_VARIABLE):
        if not Path(chosen).is_file():
            raise MjframesError(
                f"{LIBRARY_VARIABLE} names {chosen}, which is no file; name a plugin library or unset it."
            )
        return Path(chosen)
    sources = source_directory()
    name = library_name(sources)
    packaged = sources / name
    if packaged.is_file():
        return packaged
    cached = cache_directory() / name
    if not _is_whole(cached):
        _compile_once(sources, cached)
    return cached


def source_directory() -> Path:
    """Return the directory of the plugin's C++ sources: in the installed package, or in the checkout around it."""
    for directory in (_PACKAGED, _CHECKOUT):
        if (directory / FLAGS_FILE).is_file():
            return directory
    raise MjframesError(f"the plugin's sources are neither in {_PACKAGED} nor in {_CHECKOUT}; install mjframes again.")


def library_name(sources: Path, version: str = mujoco.mj_versionString()) -> str:
    """Return the file name of what these sources give for a MuJoCo; CMakeLists.txt computes the same."""
    patterns = ("*.cc", "*.h", "laws/*.h", FLAGS_FILE)
    files = sorted(path.relative_to(sources).as_posix() for pattern in patterns for path in sources.glob(pattern))
    manifest = "".join(f"{hashlib.sha256((sources / name).read_bytes()).hexdigest()}  {name}\n" for name in files)
    digest = hashlib.sha256(manifest.encode()).hexdigest()[:12]
    return f"libmjframes_soft-{version}-{digest}.so"


def packaged_versions(sources: Path) -> list[str]:
    """Return the versions of MuJoCo that a wheel's libraries beside its sources fit; none in a checkout."""
    versions = {path.name.split("-")[1] for path in sources.glob(library_name(sources, "*"))}
    return sorted(versions, key=lambda version: [int(number) for number in version.split(".")])


def find_compiler() -> list[str]:
    """Return the command of the C++ compiler: $CXX, else the first of c++, g++ and clang++ on the path.

    Raise MjframesError where there is none.
    """
    chosen = os.environ.get("CXX", "").strip()
    for command in [chosen] if chosen else ["c++", "g++", "clang++"]:
        words = shlex.split(command)
        if shutil.which(words[0]):
            return words
    looked_for = f"CXX is {chosen!r}, which is no command" if chosen else "there is no c++, g++ or clang++"
    ready = packaged_versions(source_directory())
    instead = f", or install a MuJoCo that needs none: pip install mujoco=={ready[-1]}" if ready else ""
    raise MjframesError(
        f"no C++ compiler found to build the plugin for MuJoCo {mujoco.mj_versionString()} ({looked_for}); "
        f"install g++ (Debian, Ubuntu: apt-get install g++) or set CXX to a compiler{instead}."
    )


def _compile_once(sources: Path, target: Path) -> None:
    """Compiles `sources` to `target`; processes that ask for it at the same time wait for one of them."""
    compiler = find_compiler()
    include, mujoco_library = _mujoco_files()
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with _locked(target.with_name(LOCK)):
            if not _is_whole(target):
                with _progress(_reason_to_compile(sources)):
                    _compile(compiler, sources, include, mujoco_library, target)
    except OSError as error:
        raise MjframesError(
            f"cannot compile the plugin into {target.parent} ({error.strerror}); "
            "set XDG_CACHE_HOME to a directory that can be written."
        ) from error


def _is_whole(library: Path) -> bool:
    """Whether there is a library, as it was compiled."""
    try:
        return _digest_of(library).read_text() == hashlib.sha256(library.read_bytes()).hexdigest()
    except (OSError, ValueError):  # no text
        return False


def _is_cut_off(library: Path) -> bool:
    """Whether an ELF file ends before its section headers, its last part: loading it would end the process."""
    try:
        with library.open("rb") as file:
            start = file.read(64)
    except OSError:  # MuJoCo says why
        return False
    if start[:4] != b"\x7fELF":
        return False
    first, size, count = (int.from_bytes(start[a:b], "little") for a, b in ((40, 48), (58, 60), (60, 62)))
    return library.stat().st_size < first + size * count


def _digest_of(library: Path) -> Path:
    """Where the digest of a compiled library is."""
    return library.with_suffix(".sha256")


def _reason_to_compile(sources: Path) -> str:
    ready = packaged_versions(sources)
    without = f", as mjframes comes with libraries for MuJoCo {' and '.join(ready)} only" if ready else ""
    return f"Compiling {NAME} for MuJoCo {mujoco.mj_versionString()}{without}; this happens once."


def _compile(compiler: list[str], sources: Path, include: Path, mujoco_library: Path, target: Path) -> None:
    flags = (sources / FLAGS_FILE).read_text().split()
    units = sorted(sources.glob("*.cc"))
    _remove_abandoned(target.parent)
    with tempfile.TemporaryDirectory(prefix=SCRATCH, dir=target.parent) as scratch:
        objects = [Path(scratch) / f"{unit.stem}.o" for unit in units]
        partial = Path(scratch) / target.name
        commands = [
            [*compiler, *flags, "-isystem", str(include), "-c", str(unit), "-o", str(made)]
            for unit, made in zip(units, objects, strict=True)
        ]
        # Without an rpath: the process holds MuJoCo already, found by its SONAME; any other would be a second MuJoCo.
        link = [*compiler, "-shared", "-o", str(partial), *map(str, objects), str(mujoco_library)]
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            results = list(pool.map(_run, commands))
        if all(code == 0 for code, _ in results):
            results.append(_run(link))
        log = target.with_suffix(".log")
        log.write_text("".join(output for _, output in results))
        if any(code != 0 for code, _ in results):
            raise MjframesError(
                f"{shlex.join(compiler)} cannot compile the plugin for MuJoCo {mujoco.mj_versionString()}, see {log}; "
                "it must be a compiler with C++20, for example g++ 11 or newer (set CXX to choose one)."
            )
        _digest_of(target).write_text(hashlib.sha256(partial.read_bytes()).hexdigest())
        os.replace(partial, target)


def _remove_abandoned(directory: Path) -> None:
    """Remove what compilations left that were killed: whoever has the lock is the only one that compiles."""
    for scratch in directory.glob(f"{SCRATCH}*/"):
        shutil.rmtree(scratch, ignore_errors=True)  # a compiler of a killed one may still write there


def _run(command: Sequence[str]) -> tuple[int, str]:
    """The exit code of a command, and its command line with what it printed."""
    done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True)
    return done.returncode, f"$ {shlex.join(command)}\n{done.stdout}{done.stderr}"


def _mujoco_files() -> tuple[Path, Path]:
    """The include directory and the library of the MuJoCo that is running."""
    package = Path(mujoco.HEADERS_DIR).parent.parent
    library = package / f"libmujoco.so.{mujoco.mj_versionString()}"
    if not library.is_file():
        raise MjframesError(f"{library} is missing; mjframes needs MuJoCo's wheel for Linux: pip install mujoco.")
    return package / "include", library


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    import fcntl  # not on Windows, where `import mjframes` shall fail by a sentence

    with path.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield  # closing the file unlocks it


@contextmanager
def _progress(message: str) -> Iterator[None]:
    """Says what is going on: on a terminal while it does, elsewhere as a line of stderr."""
    if sys.stderr is None or not sys.stderr.isatty():
        if sys.stderr is not None:  # else it is closed
            print(message, file=sys.stderr)
        yield
        return
    from rich.console import Console  # MuJoCo 4 imports this module with itself: keep it light

    with Console(stderr=True).status(message):
        yield
