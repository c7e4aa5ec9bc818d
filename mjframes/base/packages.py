"""Packages that only some commands need, and that extras install."""

from __future__ import annotations

import importlib
from typing import Any

from mjframes.base.errors import MjframesError, reason


def optional(module: str, user: str, extra: str, package: str = "", instead: str = "") -> Any:
    """Return a module.  Raise MjframesError, the user ("a plot") needs its package, where it is not or does not work.

    extra: of mjframes, which installs it.  package: its name, that of the module unless given.
    instead: what one can do without it ("repair it").
    """
    try:
        return importlib.import_module(module)
    except Exception as error:  # a damaged package can fail in any way
        top = module.partition(".")[0]
        name, other = package or top, f", or {instead}" if instead else ""
        if isinstance(error, ModuleNotFoundError) and str(error.name).partition(".")[0] == top:
            raise MjframesError(
                f'{user} needs {name}, which is not installed; pip install "mjframes[{extra}]"{other}.'
            ) from error
        raise MjframesError(
            f"{user} needs {name}, which does not work ({reason(error)}); install it anew{other}."
        ) from error
