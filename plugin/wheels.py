"""Builds dist/: a source distribution, and for each processor a wheel with a library for every MuJoCo that it may meet.

    python plugin/wheels.py            # `make wheels`

The libraries are compiled by zig, from PyPI's package `ziglang`, against the glibc that MuJoCo's own wheels ask for;
libc++ is linked into them. Headers and libraries of MuJoCo are those of its wheels on PyPI, unpacked into build/wheels.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
from email.parser import HeaderParser
from pathlib import Path

from packaging.requirements import Requirement
from packaging.version import Version

ROOT = Path(__file__).parents[1]
BUILD = ROOT / "build" / "wheels"
GLIBC = "2.28"  # of MuJoCo's own wheels, and of Debian 10 and RHEL 8
PROCESSORS = ("x86_64", "aarch64")
PYTHON = "3.11"  # the oldest; headers and libmujoco are the same for all


def main() -> None:
    """Write dist/*.whl and dist/*.tar.gz; leave what was there under other names."""
    releases = supported_releases()
    print(f"MuJoCo {', '.join(map(str, releases))}", flush=True)
    build("--sdist")
    for processor in PROCESSORS:
        packages = [unpacked(release, processor) for release in releases]
        made = BUILD / f"made-{processor}"
        build("--wheel", *settings(processor, packages), out=made, environment=compiler(processor))
        for wheel in made.glob("*.whl"):
            tag = f"--platform-tag=manylinux_{GLIBC.replace('.', '_')}_{processor}"
            run(sys.executable, "-m", "wheel", "tags", "--remove", tag, str(wheel))
        for wheel in made.glob("*.whl"):
            wheel.replace(ROOT / "dist" / wheel.name)
            print(f"dist/{wheel.name}: {(ROOT / 'dist' / wheel.name).stat().st_size / 1e6:.1f} MB", flush=True)


def supported_releases() -> list[Version]:
    """Return the releases of MuJoCo on PyPI that pyproject.toml's dependency allows, oldest first."""
    answer = run(sys.executable, "-m", "pip", "index", "versions", "mujoco", capture=True)
    return allowed_releases(answer, mujoco_requirement())


def mujoco_requirement() -> Requirement:
    """Return the dependency on MuJoCo that pyproject.toml declares."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    (requirement,) = [one for one in map(Requirement, project["dependencies"]) if one.name == "mujoco"]
    return requirement


def allowed_releases(answer: str, requirement: Requirement) -> list[Version]:
    """Return the final releases that `pip index versions` lists and the requirement allows, oldest first."""
    listed = re.search(r"^Available versions: (.+)$", answer, re.MULTILINE)
    if listed is None:
        raise SystemExit(f"pip index versions mujoco lists no versions: {answer.strip()}")
    return sorted(requirement.specifier.filter(map(Version, listed[1].split(", "))))


def unpacked(release: Version | str, processor: str) -> Path:
    """Return the directory of MuJoCo's package, with `include` and libmujoco, fetched from PyPI the first time."""
    folder = BUILD / f"mujoco-{release}-{processor}"
    if not list(folder.glob("mujoco/libmujoco.so.*")):
        fetch(f"mujoco=={release}", folder, processor)
        for core in parts_of_mujoco(folder):  # since MuJoCo 4 the library is in a package of its own
            fetch(core, folder, processor)
    return folder / "mujoco"


def fetch(requirement: str, folder: Path, processor: str) -> None:
    """Unpack a wheel for `processor` into a folder."""
    platforms = [f"--platform=manylinux_2_{minor}_{processor}" for minor in (28, 27, 17)]
    wanted = ["--no-deps", "--only-binary=:all:", f"--python-version={PYTHON}", *platforms]
    run(sys.executable, "-m", "pip", "install", "-q", "--upgrade", "--target", str(folder), *wanted, requirement)


def parts_of_mujoco(folder: Path) -> list[str]:
    """Return what the MuJoCo unpacked there is made of beside its own wheel, as requirements."""
    (metadata,) = folder.glob("mujoco-*.dist-info/METADATA")
    needed = HeaderParser().parsestr(metadata.read_text(encoding="utf-8")).get_all("Requires-Dist", [])
    return [str(one) for one in map(Requirement, needed) if one.name == "mujoco-core" and one.marker is None]


def compiler(processor: str) -> dict[str, str]:
    """Return the environment in which CMake compiles for `processor`, whatever this machine is."""
    zig = f"{sys.executable} -m ziglang"
    target = f"-target {processor}-linux-gnu.{GLIBC}"
    return {"CXX": f"{zig} c++ {target}", "LDFLAGS": "-s", "CMAKE_BUILD_PARALLEL_LEVEL": str(os.cpu_count())}


def settings(processor: str, packages: list[Path]) -> list[str]:
    """Return what scikit-build-core is told."""
    return [
        f"-Ccmake.define.MJFRAMES_MUJOCO={';'.join(map(str, packages))}",
        f"-Cbuild-dir={BUILD / processor}",
        "-Cinstall.strip=false",  # the linker has done it; this machine's strip may not know the other processor
    ]


def build(*arguments: str, out: Path = ROOT / "dist", environment: dict[str, str] | None = None) -> None:
    command = [sys.executable, "-m", "build", "--no-isolation", "--skip-dependency-check", "--outdir", str(out)]
    run(*command, *arguments, str(ROOT), environment=environment)


def run(*command: str, environment: dict[str, str] | None = None, capture: bool = False) -> str:
    """Run a command; return what it printed where that is captured."""
    done = subprocess.run(
        command, env={**os.environ, **(environment or {})}, text=True, stdout=subprocess.PIPE if capture else None
    )
    if done.returncode:
        raise SystemExit(f"failed with {done.returncode}: {' '.join(command)}")
    return done.stdout or ""


if __name__ == "__main__":
    main()
