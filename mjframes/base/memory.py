"""How much memory this machine has left for a process."""

from __future__ import annotations

import resource
from contextlib import suppress
from pathlib import Path

MEMINFO = Path("/proc/meminfo")
CONTROL_GROUP = Path("/sys/fs/cgroup")  # of a container: version 2 of control groups


def available_memory() -> float:
    """Return the bytes that a process may still take without swapping; infinity where the system does not say."""
    return min(_free(), _left_in_group(), _left_to_process())


def _free() -> float:
    with suppress(OSError, ValueError, IndexError):
        for line in MEMINFO.read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return 1024.0 * int(line.split()[1])
    return float("inf")


def _left_in_group() -> float:
    with suppress(OSError, ValueError):  # ValueError: "max" is no limit
        return float(int((CONTROL_GROUP / "memory.max").read_text())) - _used_by_group()
    return float("inf")


def _used_by_group() -> float:
    """The files that are cached go first where memory is short."""
    used = int((CONTROL_GROUP / "memory.current").read_text())
    for line in (CONTROL_GROUP / "memory.stat").read_text().splitlines():
        name, _, value = line.partition(" ")
        if name == "inactive_file":
            used -= int(value)
    return float(used)


def _left_to_process() -> float:
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit == resource.RLIM_INFINITY:
        return float("inf")
    with suppress(OSError, ValueError, IndexError):
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        return float(limit - pages * resource.getpagesize())
    return float(limit)
