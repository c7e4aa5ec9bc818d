"""How much memory is left."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from mjframes.base import memory


@pytest.fixture(autouse=True)
def machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(memory, "MEMINFO", tmp_path / "meminfo")
    monkeypatch.setattr(memory, "CONTROL_GROUP", tmp_path)
    monkeypatch.setattr(memory, "_left_to_process", lambda: math.inf)
    return tmp_path


def test_a_system_that_does_not_say_has_no_limit() -> None:
    assert memory.available_memory() == math.inf


def test_what_is_available_of_the_machine(machine: Path) -> None:
    (machine / "meminfo").write_text("MemTotal: 9000 kB\nMemFree:  100 kB\nMemAvailable:    2000 kB\n")
    assert memory.available_memory() == 2000 * 1024


def test_a_container_may_have_less(machine: Path) -> None:
    (machine / "meminfo").write_text("MemAvailable: 2000 kB\n")
    (machine / "memory.max").write_text("900000\n")
    (machine / "memory.current").write_text("500000\n")
    (machine / "memory.stat").write_text("anon 300000\ninactive_file 100000\n")
    assert memory.available_memory() == 500_000
    (machine / "memory.max").write_text("max\n")
    assert memory.available_memory() == 2000 * 1024
