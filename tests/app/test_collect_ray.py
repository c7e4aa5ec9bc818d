"""Collections on a Ray cluster: a local one, of which a worker dies on the way."""

from __future__ import annotations

import os
import signal
import threading
import time
from pathlib import Path

import mujoco
import pytest
from builders.scenes import FLOOR, lump

from mjframes.app.collect.run import collect
from mjframes.base.errors import MjframesError
from mjframes.scene.attach import attach
from mjframes.scene.scene_file import write_scene

pytestmark = pytest.mark.slow
pytest.importorskip("mcap")
pytest.importorskip("ray", reason="the extra ray is not installed")


def parent(process: int) -> int:
    try:
        return int(Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[1])
    except OSError:
        return 0


def is_own(process: int) -> bool:
    """Whether this process has started it, by way of others."""
    while process > 1 and process != os.getpid():
        process = parent(process)
    return process == os.getpid()


def busy_workers() -> list[int]:
    """Processes of Ray that compute a shard for this one."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            busy = (folder / "cmdline").read_bytes().startswith(b"ray::shard_bytes")
        except OSError:
            continue
        if busy and is_own(int(folder.name)):
            found.append(int(folder.name))
    return found


def test_a_cluster_of_which_a_worker_dies_gives_the_same_bytes(tmp_path: Path) -> None:
    spec = mujoco.MjSpec.from_string(FLOOR)
    attach(spec, lump(0.5, 0.001), "lump", pos=(0, 0, 0.02))
    spec.compile()
    write_scene(spec, tmp_path / "scene.xml")
    killed = []

    def kill_one() -> None:
        while not killed:
            for worker in busy_workers()[:1]:
                os.kill(worker, signal.SIGKILL)
                killed.append(worker)
            time.sleep(0.002)

    killer = threading.Thread(target=kill_one, daemon=True)
    folders = []
    for ray in (None, "local"):
        if ray:
            killer.start()
        found = collect(tmp_path / "scene.xml", tmp_path / f"runs-{ray}", worlds=4, seconds=1.0, shard=1, ray=ray,
                        vary={"lump.stiffness": (0.5, 2.0)}, push={"lump": (0.0, 2.0)})  # fmt: skip
        folders.append({path.name: path.read_bytes() for path in found.folder.iterdir()})
    assert killed
    assert folders[0] == folders[1]
    with pytest.raises(MjframesError, match=r"ray is '127.0.0.1:9': there is no cluster that answers"):
        collect(tmp_path / "scene.xml", tmp_path / "none", worlds=1, seconds=1.0, ray="127.0.0.1:9")
