"""How many instructions a step takes, by valgrind: what a busy machine does not change."""

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
mujoco.mj_step(model, data, nstep=int(steps))
"""


def instructions(run: Run) -> float | None:
    """Return those of a step, a mean of the run's first ones, in some 20 s; None where valgrind is missing.

    Valgrind 3.19 knows no AVX-512: the plugin does then what it does on processors with AVX2.
    """
    if shutil.which("valgrind") is None:
        return None
    steps = max(1, min(10, SIMULATED // run.dofs))
    with tempfile.TemporaryDirectory() as folder:
        mujoco.mj_saveModel(run.model, f"{folder}/model.mjb")
        np.save(f"{folder}/state.npy", run.state)
        counted = Path(folder) / "counted.out"
        only = ["--collect-atstart=no", "--toggle-collect=mj_step", f"--callgrind-out-file={counted}"]
        valgrind = ["valgrind", "--tool=callgrind", *only, sys.executable, "-c", STEPPING, str(plugin.library_path())]
        done = subprocess.run(
            [*valgrind, folder, str(steps)], capture_output=True, env=os.environ | {"GLIBC_TUNABLES": NO_STRINGS}
        )
        lines = counted.read_text().splitlines() if counted.is_file() else []
    total = next((line.split()[1] for line in lines if line.startswith("totals:")), "")
    return int(total) / steps if done.returncode == 0 and total.isdigit() else None
