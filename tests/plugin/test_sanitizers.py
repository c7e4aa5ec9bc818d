"""The plugin under the address and undefined-behaviour sanitizers, on the steak, in a process of its own."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import mujoco
import numpy as np
import pytest
from builders.damaged import DAMAGED, edited
from builders.lengthwise import block
from builders.rubber import bar
from builders.scenes import beam, lump

from mjframes.base.files import cache_directory, replacing
from mjframes.body.build import build
from mjframes.scene import plugin
from mjframes.scene.attach import attach
from mjframes.scene.contact import Contact
from mjframes.scene.sensors import add_sensor
from mjframes.volume.volume import Volume

pytestmark = pytest.mark.slow
SOURCES = Path(__file__).parents[2] / "plugin"
SCENE = """
<mujoco>
  <option cone="elliptic"/>
  <worldbody>
    <geom type="plane" size="1 1 .1"/>
    <flexcomp name="cloth" type="grid" dim="2" count="5 5 1" spacing=".03 .03 .03" pos="0 0 .075"
      mass=".05" radius=".001"><edge equality="true"/></flexcomp>
    <geom type="cylinder" size=".02 .1" pos="0 0 .02" euler="90 0 0"/>
    <body pos="0 0 .08"><freejoint/><geom type="ellipsoid" size=".03 .02 .01"/></body>
    <body pos=".05 0 .1"><freejoint/><geom type="box" size=".02 .02 .01"/></body>
  </worldbody>
</mujoco>
"""
SIMULATION = """
import sys
import mujoco
mujoco.mj_loadPluginLibrary({library!r})
model = mujoco.MjModel.from_xml_path({scene!r})
for jacobian in (mujoco.mjtJacobian.mjJAC_DENSE, mujoco.mjtJacobian.mjJAC_SPARSE):
    model.opt.jacobian = jacobian
    data = mujoco.MjData(model)
    contacts = 0
    for _ in range(30):
        mujoco.mj_step(model, data)
        contacts += data.ncon
    for x in range(-4, 6):
        mujoco.mj_ray(model, data, [0.1 * x, 0.1, 1], [0.01, 0, -1], None, 1, -1, None)
    print(contacts)
for damaged in {damaged!r}:
    try:
        mujoco.MjModel.from_xml_path(damaged)
        sys.exit("taken: " + damaged)
    except ValueError:
        pass
del data
print("done")
"""


FORCES = """
import mujoco
import numpy as np
mujoco.mj_loadPluginLibrary({library!r})
model = mujoco.MjModel.from_binary_path({folder!r} + "/model.mjb")
data = mujoco.MjData(model)
data.qpos[:] = np.load({folder!r} + "/qpos.npy")
mujoco.mj_forward(model, data)
np.save({folder!r} + "/found.npy", [data.qfrc_passive, data.qacc])
"""

# MuJoCo is not compiled with the sanitizer, which does not see how its threads wait for each other: what MuJoCo does
# itself, and the contacts that the hook hands to it.
SUPPRESSIONS = "called_from_lib:libmujoco.so\nrace_top:CollisionHook\n"

DAMAGES = (
    "truncated",
    "huge count",
    "points out of range",
    "large region",
    "empty clusters",
    "patch points",
)  # to be read out of bounds


def runtime(compiler: list[str], name: str) -> Path | None:
    """The shared library that goes before all others into the process."""
    printed = subprocess.run([*compiler, f"-print-file-name={name}"], capture_output=True, text=True, check=False)
    path = Path(printed.stdout.strip())
    return path.resolve() if path.is_absolute() and path.exists() else None


def sanitized(sanitizers: str) -> Path:
    """The plugin with sanitizers, made once for these sources."""
    cmake = shutil.which("cmake", path=f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    if cmake is None:
        pytest.skip("no cmake to build the plugin with sanitizers")
    name = plugin.library_name(SOURCES)
    made = cache_directory() / f"{sanitizers.replace(',', '-')}-{Path(name).stem}" / name
    if not made.is_file():
        # in a directory of its own: one that an interrupted run or another clone left is not CMake's to build on
        with TemporaryDirectory() as build_directory:
            options = [f"-DMJFRAMES_SANITIZE={sanitizers}", f"-DPython_EXECUTABLE={sys.executable}"]
            for command in (
                [cmake, "-S", str(SOURCES), "-B", build_directory, "-G", "Unix Makefiles", *options],
                [cmake, "--build", build_directory, "--parallel", "2"],
            ):
                subprocess.run(command, check=True, capture_output=True)
            with replacing(made, "the library") as file:
                shutil.copyfile(Path(build_directory, name), file)
    return made


def crowded(path: Path) -> Path:
    """A scene of soft and rigid things of all kinds that touch, some of them each other softly."""
    spec = mujoco.MjSpec.from_string(SCENE)
    turning = block("neo_hookean", frame_type=("rigid", "affine", "rigid"))
    steak = Volume.load(Path(__file__).parents[2] / "models" / "steak.npz")
    attach(spec, build(steak, 3), "steak", pos=(0, 0, 0.055), contact=Contact(dents=True))
    attach(spec, beam(), "beam", pos=(0.2, 0.1, 0.0))
    attach(spec, lump(0.5, 0.001), "lump", pos=(-0.4, 0.1, -0.3))
    add_sensor(spec, beam(), "beam", "elastic_energy")
    for quantity in ("stress", "position", "velocity"):
        add_sensor(spec, beam(), "beam", quantity, [[0.05, 0.02, 0.02], [0.2, 0.02, 0.02]])
    add_sensor(spec, beam(), "beam", "contact_force")
    attach(spec, turning, "block", pos=(0.2, -0.3, 0.0))
    attach(spec, bar("arruda_boyce", "whole_body"), "bar", pos=(0.5, -0.3, 0.0))
    add_sensor(spec, bar("arruda_boyce", "whole_body"), "bar", "elastic_energy")
    for quantity in ("strain", "position", "velocity"):
        add_sensor(spec, turning, "block", quantity, [[0.06, 0.02, 0.02]])
    attach(spec, beam(beta=0.001), "upper", pos=(0.21, 0.11, 0.039), contact=Contact(dents=True))
    spec.compile()
    path.write_text(spec.to_xml())
    return path


def checked() -> tuple[Path, dict[str, str]]:
    """The plugin with the address sanitizer, and what a process needs around it; skips the test where there is none."""
    preloaded = [runtime(plugin.find_compiler(), name) for name in ("libasan.so", "libstdc++.so")]
    if None in preloaded:
        pytest.skip("the compiler has no libasan.so; it comes with g++")
    library = sanitized("address,undefined")
    return library, os.environ | {
        plugin.LIBRARY_VARIABLE: str(library),
        "LD_PRELOAD": " ".join(map(str, preloaded)),
        "ASAN_OPTIONS": "detect_leaks=0:detect_stack_use_after_return=1",
        "UBSAN_OPTIONS": "print_stacktrace=1",
    }


def test_a_steak_among_things_leaves_the_sanitizers_silent(tmp_path: Path) -> None:
    library, environment = checked()
    scene = crowded(tmp_path / "scene.xml")

    damaged = []
    for number, damage in enumerate(DAMAGES):
        damaged.append(str(tmp_path / f"{number}.xml"))
        Path(damaged[-1]).write_text(edited(*DAMAGED[damage][:3]))

    code = SIMULATION.format(scene=str(scene), library=str(library), damaged=damaged)
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path, env=environment, check=False
    )
    assert done.returncode == 0, done.stderr[-4000:]
    assert "runtime error" not in done.stderr
    assert "AddressSanitizer" not in done.stderr
    *contacts, last = done.stdout.split()
    assert last == "done"
    assert min(map(int, contacts)) > 200


def test_four_lanes_give_what_eight_give(tmp_path: Path) -> None:
    """The sanitized library has the code for any processor: regions four at a time, each four as large as they are."""
    library, environment = checked()
    spec = mujoco.MjSpec()
    steak = build(Volume.load(Path(__file__).parents[2] / "models" / "steak.npz"), 12)
    sizes = np.sort([len(points) for points in steak.stiffness.points])[::-1]
    assert sizes[4] < sizes[0]  # else the fours of an eight are alike
    attach(spec, steak, "steak", pos=(0, 0, 1))
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos += np.random.default_rng(0).normal(0, 3e-4, model.nq)
    mujoco.mj_forward(model, data)
    mujoco.mj_saveModel(model, str(tmp_path / "model.mjb"))
    np.save(tmp_path / "qpos.npy", data.qpos)
    code = FORCES.format(library=str(library), folder=str(tmp_path))
    subprocess.run([sys.executable, "-c", code], env=environment, check=True)
    force, acceleration = np.load(tmp_path / "found.npy")
    assert np.abs(data.qfrc_passive).max() > 1
    assert np.abs(force - data.qfrc_passive).max() < 1e-10 * np.abs(data.qfrc_passive).max()
    assert np.abs(acceleration - data.qacc).max() < 1e-8 * np.abs(data.qacc).max()


def test_threads_that_share_a_model_leave_the_sanitizer_silent(tmp_path: Path) -> None:
    """A program of its own: Python is not made for this sanitizer. MuJoCo's pool, too, calls the collision hook."""
    if runtime(plugin.find_compiler(), "libtsan.so") is None:
        pytest.skip("the compiler has no libtsan.so; it comes with g++")
    library, scene = sanitized("thread"), crowded(tmp_path / "scene.xml")
    package = Path(mujoco.__file__).parent
    driver = tmp_path / "driver"
    source = Path(__file__).with_name("thread_driver.cc")
    flags = ["-std=c++20", "-g", "-O1", "-fsanitize=thread", f"-I{package / 'include'}", f"-Wl,-rpath,{package}"]
    subprocess.run(
        [*plugin.find_compiler(), *flags, str(source), *map(str, package.glob("libmujoco.so.*")), "-o", str(driver)],
        check=True,
    )
    suppressions = tmp_path / "suppressions"
    suppressions.write_text(SUPPRESSIONS)
    done = subprocess.run(
        [str(driver), str(library), str(scene), "20"],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={**os.environ, "TSAN_OPTIONS": f"suppressions={suppressions}"},
        check=False,
    )
    assert done.returncode == 0, done.stderr[-4000:]
    assert "ThreadSanitizer" not in done.stderr
    assert int(done.stdout) > 200
