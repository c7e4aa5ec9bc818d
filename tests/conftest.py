"""Lets MuJoCo draw without a display: it reads MUJOCO_GL when it is imported, so this comes before any test."""

from __future__ import annotations

import os
from ctypes import CDLL

if not any(os.environ.get(name) for name in ("MUJOCO_GL", "DISPLAY", "WAYLAND_DISPLAY")):
    try:
        CDLL("libEGL.so.1")
        os.environ["MUJOCO_GL"] = "egl"
    except OSError:
        os.environ["MUJOCO_GL"] = "osmesa"
