"""How many instructions a step takes, by Linux's `perf`: what a busy machine does not change."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import mujoco
import numpy as np

from mjframes.benchmarks.step_scenes import Run
from mjframes.scene import plugin

EVENT = "instructions:u"
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
        mujoco.mj_saveModel(run.model, f"{folder}/model.mjb")
        np.save(f"{folder}/state.npy", run.state)
        before, after = (_count(Path(folder), number) for number in (0, steps))
    return None if before is None or after is None else (after - before) / steps


def _count(folder: Path, steps: int) -> int | None:
    """Those of a process that makes so many steps."""
    counted = folder / "counted.csv"
    command = [sys.executable, "-c", STEPPING, str(plugin.library_path()), str(folder), str(steps)]
    perf = ["perf", "stat", "-x", ",", "-e", EVENT, "-o", str(counted), *command]
    done = subprocess.run(perf, capture_output=True)
    lines = counted.read_text().splitlines() if counted.is_file() else []
    number = next((line.split(",")[0] for line in lines if EVENT in line), "")
    return int(number) if done.returncode == 0 and number.isdigit() else None
