"""How many instructions a step takes, by Linux's `perf` or by valgrind: what a busy machine does not change."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import mujoco
import numpy as np

from benchmarks.speed.step_scenes import Run
from mjframes.scene import plugin

EVENT = "instructions:u"
# Valgrind takes what moves a string, one instruction of the processor, for one a byte; the C library then uses others.
NO_STRINGS = "glibc.cpu.x86_rep_stosb_threshold=1000000000:glibc.cpu.x86_rep_movsb_threshold=1000000000"
SIMULATED = 2000  # [degrees of freedom × steps] that valgrind, fifty times slower than the processor, is given
STEPPING = """
import sys
import mujoco
import numpy as np
library, folder, steps = sys.argv[1:]
mujoco.mj_loadPluginLibrary(library)
model = mujoco.MjModel.from_binary_path(folder + "/model.mjb")
data = mujoco.MjData(model)
mujoco.mj_setState(model, data, np.load(folder + "/state.npy"), mujoco.mjtState.mjSTATE_INTEGRATION)
if int(steps):
    mujoco.mj_step(model, data, nstep=int(steps))
"""


def instructions(run: Run, steps: int) -> float | None:
    """Return the instructions of a step, a mean over so many; None where `perf` is missing or may not count.

    They are what a process with these steps takes more than one without.
    """
    if shutil.which("perf") is None:
        return None
    with tempfile.TemporaryDirectory() as folder:
        _save(run, folder)
        before, after = (_count(folder, number) for number in (0, steps))
    return None if before is None or after is None else (after - before) / steps


def simulated_instructions(run: Run) -> float | None:
    """Return those of the run's first steps by valgrind, in seconds; None where it is missing.

    Valgrind 3.19 knows no AVX-512: the plugin does then what it does on processors with AVX2.
    """
    if shutil.which("valgrind") is None:
        return None
    steps = max(1, min(10, SIMULATED // run.dofs))
    with tempfile.TemporaryDirectory() as folder:
        _save(run, folder)
        counted = Path(folder) / "counted.out"
        only = ["--collect-atstart=no", "--toggle-collect=mj_step", f"--callgrind-out-file={counted}"]
        valgrind = ["valgrind", "--tool=callgrind", *only, *_stepping(folder, steps)]
        done = subprocess.run(valgrind, capture_output=True, env=os.environ | {"GLIBC_TUNABLES": NO_STRINGS})
        lines = counted.read_text().splitlines() if counted.is_file() else []
    total = next((line.split()[1] for line in lines if line.startswith("totals:")), "")
    return int(total) / steps if done.returncode == 0 and total.isdigit() else None


def _save(run: Run, folder: str) -> None:
    """Write what the process needs that is counted."""
    mujoco.mj_saveModel(run.model, f"{folder}/model.mjb")
    np.save(f"{folder}/state.npy", run.state)


def _stepping(folder: str, steps: int) -> list[str]:
    """The command of that process."""
    return [sys.executable, "-c", STEPPING, str(plugin.library_path()), folder, str(steps)]


def _count(folder: str, steps: int) -> int | None:
    """Those of a process that makes so many steps."""
    counted = Path(folder) / "counted.csv"
    perf = ["perf", "stat", "-x", ",", "-e", EVENT, "-o", str(counted), *_stepping(folder, steps)]
    done = subprocess.run(perf, capture_output=True)
    lines = counted.read_text().splitlines() if counted.is_file() else []
    number = next((line.split(",")[0] for line in lines if EVENT in line), "")
    return int(number) if done.returncode == 0 and number.isdigit() else None
