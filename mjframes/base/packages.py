"""Packages that only some commands need, and that extras install."""

from __future__ import annotations

import importlib
from typing import Any

from mjframes.base.errors import MjframesError


def optional(module: str, user: str, extra: str, package: str = "") -> Any:
    """Return a module.  Raise MjframesError, the user ("a plot") needs its package, where it is not installed.

    extra: of mjframes, which installs it.  package: its name, that of the module unless given.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        name = package or module.partition(".")[0]
        raise MjframesError(f'{user} needs {name}, which is not installed; pip install "mjframes[{extra}]".') from error
