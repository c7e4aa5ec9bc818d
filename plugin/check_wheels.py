"""Checks what wheels.py has made in dist/, `make check-wheels`.

Each library asks for nothing but glibc, no newer than the wheel's tag says, and the libmujoco that it is for. A wheel
for this machine is installed alone into a clean environment with each MuJoCo, where there is no compiler; it builds a
soft body from labels and steps the steak. One for aarch64 is stepped under qemu's emulation where Debian's
`qemu-user-static` and `libc6-arm64-cross` are there. The source distribution is compiled, installed and stepped.
"""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import TypeVar

from elftools.elf.dynamic import DynamicSection
from elftools.elf.elffile import ELFFile
from elftools.elf.gnuversions import GNUVerNeedSection
from elftools.elf.sections import Section, Symbol, SymbolTableSection
from wheels import BUILD, GLIBC, PROCESSORS, ROOT, compiler, supported_releases, unpacked

Kind = TypeVar("Kind", bound=Section)

MACHINES = {"x86_64": "EM_X86_64", "aarch64": "EM_AARCH64"}
SYSTEM = {"libc.so.6", "libm.so.6", "libdl.so.2", "libpthread.so.0", "ld-linux-x86-64.so.2", "ld-linux-aarch64.so.1"}
STEPS = 200  # of 2 ms: the steak is on the block
AGREEMENT = 1e-6  # [m] of positions after STEPS, of processors whose sums differ in the last digits
QEMU, SYSROOT = "qemu-aarch64-static", Path("/usr/aarch64-linux-gnu")
NO_COMPILER = {"CC": "false", "CXX": "false"}
MOVE = f"""
import sys, mujoco, numpy as np, mjframes as mf
from mjframes.scene import plugin
rubber = mf.Material(young=1e5, poisson=0.4, density=1000)
labels = np.ones((8, 4, 4), int)
block = mf.build(mf.Volume.from_labels(labels, spacing=0.01, materials={{1: rubber}}), frames=2)
spec = mujoco.MjSpec()
mf.attach(spec, block, "block")
model = spec.compile()
data = mujoco.MjData(model)
for _ in range(10): mujoco.mj_step(model, data)
assert np.isfinite(data.qpos).all()
models, scene, state = sys.argv[1:]
spec = mujoco.MjSpec.from_file(models + "/kitchen.xml")
mf.attach(spec, mf.build(models + "/steak.npz", frames=3), "steak", pos=(0, 0, 0.15))
model = spec.compile()
open(scene, "w").write(spec.to_xml())
data = mujoco.MjData(model)
for _ in range({STEPS}): mujoco.mj_step(model, data)
assert data.ncon > 0
open(state, "w").write(" ".join(map(repr, data.qpos.tolist())))
print(plugin.library_path())
"""


def main() -> None:
    """Check every file in dist/; end with a sentence at the first that is not as it must be."""
    dist = ROOT / "dist"
    releases = [str(release) for release in supported_releases()]
    for processor in PROCESSORS:
        wheel = only(dist, f"*-py3-none-manylinux_{GLIBC.replace('.', '_')}_{processor}.whl")
        libraries = extracted(wheel)
        expect(
            sorted(libraries) == sorted(releases), f"{wheel.name} has libraries for {sorted(libraries)}, not {releases}"
        )
        for release, library in libraries.items():
            glibc = examined(library, release, processor)
            print(
                f"{wheel.name}: MuJoCo {release}, {library.stat().st_size / 1e6:.1f} MB, needs glibc {glibc}",
                flush=True,
            )
    with tempfile.TemporaryDirectory() as scratch:
        for release in releases:
            folder = Path(scratch) / release
            native = only(dist, f"*_{platform.machine()}.whl")
            step_installed(native, release, folder, NO_COMPILER)
            if platform.machine() == "x86_64":
                step_emulated(release, folder)
        step_installed(only(dist, "*.tar.gz"), releases[0], Path(scratch) / "sdist", {})


def only(folder: Path, pattern: str) -> Path:
    found = sorted(folder.glob(pattern))
    expect(len(found) == 1, f"{folder} has {len(found)} files {pattern}; it must have one: rm -r dist; make wheels")
    return found[0]


def expect(holds: bool, otherwise: str) -> None:
    if not holds:
        raise SystemExit(otherwise)


def extracted(wheel: Path) -> dict[str, Path]:
    """Return the libraries in a wheel, unpacked into build/, by the version of MuJoCo in their names."""
    folder = BUILD / "checked" / wheel.stem
    shutil.rmtree(folder, ignore_errors=True)
    with zipfile.ZipFile(wheel) as archive:
        names = [name for name in archive.namelist() if name.endswith(".so")]
        return {name.split("-")[1]: Path(archive.extract(name, folder)) for name in names}


def examined(library: Path, release: str, processor: str) -> str:
    """Return the newest glibc that a library asks for; end where it cannot be loaded on such a system."""
    with library.open("rb") as file:
        elf = ELFFile(file)
        expect(elf["e_machine"] == MACHINES[processor], f"{library} is for {elf['e_machine']}, not {processor}")
        tags = [tag for part in sections(elf, DynamicSection) for tag in part.iter_tags("DT_NEEDED")]
        needed = {tag.needed for tag in tags}  # pyright: ignore[reportAttributeAccessIssue]  (made from the file)
        foreign = needed - SYSTEM - {f"libmujoco.so.{release}"}
        expect(not foreign, f"{library} needs {foreign}; a wheel may need glibc and libmujoco only")
        versions = [
            auxiliary.name.removeprefix("GLIBC_")
            for part in sections(elf, GNUVerNeedSection)
            for _, auxiliaries in part.iter_versions()
            for auxiliary in auxiliaries
        ]
        undefined = {
            symbol.name for symbol in dynamic_symbols(elf) if symbol["st_shndx"] == "SHN_UNDEF" and symbol.name
        }
    from_mujoco = {name for name in undefined if name.startswith(("mj", "_mj"))}
    with next(unpacked_library(release, processor)).open("rb") as file:
        offered = {symbol.name for symbol in dynamic_symbols(ELFFile(file)) if symbol["st_shndx"] != "SHN_UNDEF"}
    expect(from_mujoco <= offered, f"{library} needs {from_mujoco - offered}, which libmujoco.so.{release} has not")
    newest = max(versions, key=lambda version: [int(number) for number in version.split(".")])
    expect(
        [int(number) for number in newest.split(".")] <= [int(number) for number in GLIBC.split(".")],
        f"{library} needs glibc {newest}, newer than {GLIBC}",
    )
    return newest


def unpacked_library(release: str, processor: str) -> Iterator[Path]:
    return unpacked(release, processor).glob("libmujoco.so.*")


def sections(elf: ELFFile, kind: type[Kind]) -> list[Kind]:
    return [section for section in elf.iter_sections() if isinstance(section, kind)]


def dynamic_symbols(elf: ELFFile) -> list[Symbol]:
    return [symbol for table in sections(elf, SymbolTableSection) for symbol in table.iter_symbols()]


def step_installed(package: Path, release: str, folder: Path, environment: dict[str, str]) -> None:
    """Install a package with a MuJoCo into a clean environment, and step there; the wheel's own library must do it."""
    start = time.monotonic()
    call([sys.executable, "-m", "venv", str(folder / "venv")])
    python = str(folder / "venv" / "bin" / "python")
    call([python, "-m", "pip", "install", "-q", "--disable-pip-version-check", str(package), f"mujoco=={release}"])
    installed = time.monotonic()
    clean = {"XDG_CACHE_HOME": str(folder / "cache"), "PYTHONPATH": "", **environment}
    arguments = [str(ROOT / "models"), str(folder / "steak.xml"), str(folder / "state")]
    used = call([python, "-W", "error::RuntimeWarning", "-c", MOVE, *arguments], clean, folder).strip()
    expect("site-packages" in used, f"{package.name} with MuJoCo {release} compiled {used} instead of using its own")
    print(
        f"{package.name}: MuJoCo {release}, installed in {installed - start:.0f} s, "
        f"built and stepped in {time.monotonic() - installed:.0f} s",
        flush=True,
    )


def step_emulated(release: str, folder: Path) -> None:
    """Step the steak under aarch64's emulation, and compare with what this machine's processor found."""
    if shutil.which(QEMU) is None or not SYSROOT.exists():
        print(
            f"aarch64: not stepped, as {QEMU} or {SYSROOT} is missing; "
            "apt-get install qemu-user-static libc6-arm64-cross brings them"
        )
        return
    mujoco = unpacked(release, "aarch64")
    (plugin,) = (BUILD / "checked").glob(f"*aarch64/mjframes/_plugin/*-{release}-*.so")
    source, driver = ROOT / "tests" / "builders" / "step_driver.cc", folder / "step_driver"
    flags = ["-std=c++20", "-O2", "-isystem", str(mujoco / "include"), str(mujoco / f"libmujoco.so.{release}")]
    call([*compiler("aarch64")["CXX"].split(), str(source), *flags, "-o", str(driver)])
    emulator = [QEMU, "-L", str(SYSROOT), "-E", f"LD_LIBRARY_PATH={mujoco}"]
    printed = call([*emulator, str(driver), str(plugin), str(folder / "steak.xml"), str(STEPS)])
    here = [float(word) for word in (folder / "state").read_text().split()]
    there = [float(word) for word in printed.split()]
    difference = max(abs(a - b) for a, b in zip(here, there, strict=True))
    expect(difference <= AGREEMENT, f"MuJoCo {release}: the steak on aarch64 is {difference} m off x86-64's")
    print(f"aarch64: MuJoCo {release}, {STEPS} steps under {QEMU}, {difference:.1e} m from x86-64's", flush=True)


def call(command: list[str], environment: dict[str, str] | None = None, folder: Path | None = None) -> str:
    done = subprocess.run(
        command, env={**os.environ, **(environment or {})}, cwd=folder, text=True, capture_output=True
    )
    expect(done.returncode == 0, f"failed with {done.returncode}: {' '.join(command)}\n{done.stdout}{done.stderr}")
    return done.stdout


if __name__ == "__main__":
    main()
