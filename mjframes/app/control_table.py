"""Controls of a run: constant ones, or a table of them over time, from an array or a file.

A CSV has a header of `time` and names of actuators, a row an instant:

    time,press,grip
    0,-0.02,0
    0.5,-0.04,1

An .npy holds (t, 1 + nu), a row an instant, first its time; or (t, nu), a row a step. nu: all controls of the model.
Times are rounded to steps. Each row holds until the next one; the last to the end. What is not in the table stays as
it is. A control has its actuator's name; where that has several, "press:0", "press:1".
"""

from __future__ import annotations

import csv
import os
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjframes.base.errors import MjframesError, Notice
from mjframes.base.numbers import is_number

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ControlTable:
    """time: (t,) of each row from the run's start on [s], ascending.  value: (t, c).  control: (c,) which."""

    time: Array
    value: Array
    control: NDArray[np.int64]

    def set(self, data: mujoco.MjData, now: float, timestep: float) -> None:
        """Set the controls of the step at `now` [s]; before the first row's time leave them as they are."""
        row = int(np.searchsorted(self.time, now + 0.5 * timestep, "right")) - 1
        if row >= 0:
            data.ctrl[self.control] = self.value[row]


def control_table(model: mujoco.MjModel, given: Mapping[str, float] | str | os.PathLike[str]) -> ControlTable:
    """Return the table of a file (.csv, .npy), or of constant controls by their actuators' names.

    Warn (Notice) of controls outside an actuator's range, which MuJoCo clamps.
    Raise MjframesError for actuators that are not there and files that cannot be used.
    """
    if isinstance(given, Mapping):
        for name, value in given.items():
            if not is_number(value):
                raise MjframesError(f"ctrl has {name}={value!r}; give a number.")
        values = np.array([list(given.values())], float).reshape(1, -1)
        table = ControlTable(np.zeros(1), values, _controls(model, "ctrl", list(given)))
    else:
        path = Path(given)
        if path.suffix.lower() not in (".csv", ".npy"):
            raise MjframesError(f"{path}: controls are NAME=VALUE,… or a file .csv or .npy; give one of these.")
        table = _from_csv(model, path) if path.suffix.lower() == ".csv" else _from_npy(model, path)
    _warn_of_clamping(model, table)
    return table


def control_names(model: mujoco.MjModel) -> list[str]:
    """Return the names of all controls, "" of actuators without a name."""
    names: list[str] = []
    for actuator in range(model.nactuator):
        name, count = model.actuator(actuator).name, int(model.actuator_ctrlnum[actuator])
        names += [f"{name}:{k}" if name else "" for k in range(count)] if count > 1 else [name]
    return names


def _controls(model: mujoco.MjModel, where: str, names: list[str]) -> NDArray[np.int64]:
    known = control_names(model)
    if not known:
        raise MjframesError(f"{where} has the actuator {names[0]!r}, but the scene has no actuators.")
    for number, name in enumerate(names):
        if not name or name not in known:
            listed = ", ".join(map(repr, filter(None, known))) or "unnamed; give them as an .npy file"
            raise MjframesError(f"{where} has the actuator {name!r}, but those of the scene are: {listed}.")
        if name in names[:number]:
            raise MjframesError(f"{where} has the actuator {name!r} twice; give it once.")
    return np.array([known.index(name) for name in names], np.int64)


def _from_csv(model: mujoco.MjModel, path: Path) -> ControlTable:
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = [row for row in csv.reader(file) if any(map(str.strip, row))]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise MjframesError(f"{path}: the controls cannot be read ({getattr(error, 'strerror', error)}).") from error
    names = [name.strip() for name in rows[0]] if rows else []
    if len(names) < 2 or names[0] != "time" or len(rows) < 2:
        raise MjframesError(f"{path}: it needs a header like time,{_example(model)} and a row of numbers or more.")
    control = _controls(model, f"{path}:", names[1:])
    values = np.empty((len(rows) - 1, len(names)))
    for number, row in enumerate(rows[1:]):
        try:
            values[number] = np.array([float(word) for word in row]).reshape(len(names))
        except ValueError as error:
            raise MjframesError(f"{path}: row {number + 2} is not {len(names)} numbers: {','.join(row)!r}.") from error
    return _checked(path, values[:, 0], values[:, 1:], control)


def _from_npy(model: mujoco.MjModel, path: Path) -> ControlTable:
    try:
        values = np.asarray(np.load(path, allow_pickle=False), np.float64)
    except (OSError, ValueError, EOFError) as error:
        raise MjframesError(
            f"{path}: the controls cannot be read ({getattr(error, 'strerror', None) or error})."
        ) from error
    if values.ndim != 2 or not len(values) or values.shape[1] not in (model.nu, model.nu + 1) or not model.nu:
        raise MjframesError(
            f"{path}: it has the shape {values.shape}; with {model.nu} controls it must be (t, {model.nu + 1}), times "
            f"first, or (t, {model.nu}), a row a step."
        )
    if values.shape[1] == model.nu + 1:
        return _checked(path, values[:, 0], values[:, 1:], np.arange(model.nu))
    return _checked(path, np.arange(len(values)) * model.opt.timestep, values, np.arange(model.nu))


def _checked(path: Path, time: Array, value: Array, control: NDArray[np.int64]) -> ControlTable:
    if not (np.isfinite(time).all() and np.isfinite(value).all()):
        raise MjframesError(f"{path}: it has values that are not finite; give numbers.")
    if (np.diff(time) <= 0).any():
        row = int(np.argmax(np.diff(time) <= 0)) + 1
        raise MjframesError(f"{path}: its times must ascend, but {time[row]:g} s follows {time[row - 1]:g} s.")
    return ControlTable(time, value, control)


def _example(model: mujoco.MjModel) -> str:
    return next(filter(None, control_names(model)), "ACTUATOR")


def _warn_of_clamping(model: mujoco.MjModel, table: ControlTable) -> None:
    for column, i in enumerate(table.control):
        low, high = model.actuator_ctrlrange[i]
        values = table.value[:, column]
        if model.actuator_ctrllimited[i] and (values.min() < low or values.max() > high):
            outside = values[(values < low) | (values > high)][0]
            name = control_names(model)[i] or f"number {i}"
            warnings.warn(
                f"ctrl of {name} is {outside:g}, outside its range {low:g} to {high:g}; MuJoCo clamps it.",
                Notice,
                stacklevel=4,
            )
