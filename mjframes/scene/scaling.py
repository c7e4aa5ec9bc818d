"""How stiff and how damped a soft body is in one model, to what it was built with, without building it again.

Two numerics of the model say it, `steak:stiffness` with a factor of all moduli, and `steak:damping` with those of
Rayleigh's α and β. The plugin reads `numeric_data` in every step, so that whatever gives each world a model of its own,
or a `numeric_data` of its own, gives it a material of its own. A body's forces and stiffness are homogeneous of degree
one in its moduli together: a common factor is exact, for every law.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import mujoco
import numpy as np

from mjframes.base.errors import MjframesError
from mjframes.scene.plugin_text import SEPARATOR
from mjframes.volume.material import is_number

STIFFNESS, DAMPING = "stiffness", "damping"
SIZES = {STIFFNESS: 1, DAMPING: 2}  # entries of each numeric


def scale(
    model: mujoco.MjModel, name: str, stiffness: float | None = None, *, damping: Sequence[float] | None = None
) -> None:
    """Make soft body `name` of a compiled model as many times as stiff, or as damped, as it was built, from now on.

    stiffness: factor of the moduli of all its materials [-].  damping: factors of α and β of `build` [-].
    What is not given stays as it is. Factors do not add up: 1 is what was built, whatever was asked for before.
    Raise MjframesError where the model has no such soft body, and for factors that are not positive and finite.
    """
    if stiffness is not None and not _is_factor(stiffness):
        raise MjframesError(f"stiffness is {stiffness!r}; give a positive factor of the moduli that the body has.")
    if damping is not None and not (np.shape(damping) == (2,) and all(map(_is_factor, damping))):
        raise MjframesError(f"damping is {damping!r}; give two positive factors, of α and of β.")
    given = {STIFFNESS: stiffness, DAMPING: damping}
    found = {key: _entries(model, name, key) for key in given}
    if None in found.values():
        known = ", ".join(map(repr, _known(model))) or "none"
        raise MjframesError(f"name is {name!r} but the soft bodies that the model can scale are: {known}.")
    for key, entries in found.items():
        if given[key] is not None:
            model.numeric_data[entries] = given[key]


def add_scaling(spec: mujoco.MjSpec, name: str) -> None:
    """Give soft body `name` of a spec its numerics, all of them 1."""
    for key, size in SIZES.items():
        spec.add_numeric(name=_numeric(name, key), size=size, data=np.ones(size))


def stiffness(model: mujoco.MjModel, name: str) -> float:
    """Return the factor of the moduli of soft body `name` as the plugin takes it: 1 for what is no positive factor."""
    entries = _entries(model, name, STIFFNESS)
    value = 1.0 if entries is None else float(model.numeric_data[entries][0])
    return value if _is_factor(value) else 1.0


def _is_factor(value: Any) -> bool:
    return is_number(value) and value > 0


def _numeric(name: str, key: str) -> str:
    return f"{name}{SEPARATOR}{key}"


def _entries(model: mujoco.MjModel, name: str, key: str) -> slice | None:
    """Where `numeric_data` has the factors, None for models that were written without."""
    for numeric, names in _numerics(model, key):
        if name in names and model.numeric_size[numeric] == SIZES[key]:
            start = int(model.numeric_adr[numeric])
            return slice(start, start + SIZES[key])
    return None


def _known(model: mujoco.MjModel) -> list[str]:
    """Return the names of the soft bodies that have numerics."""
    return [names[0] for _, names in _numerics(model, STIFFNESS)]


def _numerics(model: mujoco.MjModel, key: str) -> Iterator[tuple[int, tuple[str, str]]]:
    """Yield the numerics for a key, and what their soft bodies may be called.

    MuJoCo puts suffixes behind the names of both, and behind the separator that names of one letter have.
    """
    for i in range(model.nnumeric):
        before, found, behind = model.numeric(i).name.rpartition(_numeric("", key))
        if found:
            yield i, (before + behind, before + SEPARATOR + behind)
