"""Lets MuJoCo draw without a display: it reads MUJOCO_GL when it is imported, so this comes before any test."""

from __future__ import annotations

import os
from collections.abc import Iterator
from ctypes import CDLL
from pathlib import Path

import pytest

pytest_plugins = ["pytest_mjframes", "builders.durations"]  # an installed mjframes has the first by itself

if not any(os.environ.get(name) for name in ("MUJOCO_GL", "DISPLAY", "WAYLAND_DISPLAY")):
    try:
        CDLL("libEGL.so.1")
        os.environ["MUJOCO_GL"] = "egl"
    except OSError:
        os.environ["MUJOCO_GL"] = "osmesa"


@pytest.fixture
def uncached(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every stage is computed, also what an earlier test has built."""
    monkeypatch.setenv("MJFRAMES_CACHE", "0")


@pytest.fixture
def warnings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[list[str]]:
    """What MuJoCo warns of, instead of writing it to MUJOCO_LOG.TXT."""
    import mujoco

    monkeypatch.chdir(tmp_path)
    messages: list[str] = []
    mujoco.set_mju_user_warning(messages.append)
    yield messages
    mujoco.set_mju_user_warning(None)
