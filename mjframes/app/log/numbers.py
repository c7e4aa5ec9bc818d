"""Numbers of a log: JSON messages, which keep every float64 as it is, and the JSON schemas that Foxglove plots by.

Channels: /state, /energy and /soft/<name> for each soft body, /contacts, /sensors. All is SI. TOPICS has what can be
chosen; the command line, `Log`, the writer and the reader read it.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from mjframes.app.recording import STATE, Instant, State

NUMBERS = {"type": "array", "items": {"type": "number"}}
FIELDS: dict[str, dict[str, Any]] = {
    "state": dict.fromkeys(STATE, NUMBERS),
    "energy": {
        "kinetic": "J",
        "potential": "J, gravity and springs",
        "elastic": "J",
        "total": "J",
        "speed": "m/s, of the fastest body",
    },
    "contacts": {
        "count": "contacts",
        "penetration": "m, deepest since the message before",
        "normal_force": "N, sum",
        "rigid_force": "N, sum over rigid geoms alone",
    },
    "soft": {"elastic": "J", "kinetic": "J", "normal_force": "N, sum over its contacts"},
}


Fields = dict[str, Any]


@dataclass(frozen=True)
class Topic:
    """Numbers that `--log-topics` has a name for.

    fields: of a model and the names of its soft bodies, what each channel has: by name a unit, or a JSON schema.
    messages: of a model, its data and an instant, what it says in each of these channels.
    """

    fields: Callable[[mujoco.MjModel, Collection[str]], dict[str, Fields]]
    messages: Callable[[mujoco.MjModel, mujoco.MjData, Instant], dict[str, dict[str, Any]]]


def nanoseconds_of(time: float) -> int:
    """Return simulated time [s] in nanoseconds."""
    return round(time * 1e9)


def schemas(model: mujoco.MjModel, soft_names: Collection[str], topics: Collection[str]) -> dict[str, Fields]:
    """Return the JSON schema of each channel of numbers."""
    found = {"/state": FIELDS["state"]} if "state" in topics else {}
    for name, topic in TOPICS.items():
        found |= topic.fields(model, soft_names) if name in topics else {}
    return {channel: json_schema(channel.split("/")[1], fields) for channel, fields in found.items()}


def messages(
    model: mujoco.MjModel, data: mujoco.MjData, instant: Instant, topics: Collection[str]
) -> dict[str, dict[str, Any]]:
    """Return what an instant says in each channel of some topics; data: at that instant."""
    found: dict[str, dict[str, Any]] = {}
    for name, topic in TOPICS.items():
        found |= topic.messages(model, data, instant) if name in topics else {}
    return found


def sensor_fields(model: mujoco.MjModel) -> dict[str, Any]:
    """Return what `sensor_message` has, by name, as `json_schema` takes it."""
    sizes = zip(sensor_names(model), model.sensor_dim.tolist(), strict=True)
    return {name: "as MuJoCo has it" if size == 1 else NUMBERS for name, size in sizes}


def state_message(state: State) -> dict[str, Any]:
    """Return what a state says in its topic."""
    return {name: getattr(state, name).tolist() for name in STATE}


def _energy(instant: Instant) -> dict[str, dict[str, Any]]:
    energy = {"kinetic": instant.kinetic, "potential": instant.potential, "elastic": sum(instant.elastic.values())}
    found: dict[str, dict[str, Any]] = {"/energy": {**energy, "total": instant.total, "speed": instant.speed}}
    for name, elastic in instant.elastic.items():
        kinetic, force = instant.soft_kinetic[name], instant.soft_force[name]
        found[f"/soft/{name}"] = {"elastic": elastic, "kinetic": kinetic, "normal_force": force}
    return found


def _contacts(instant: Instant) -> dict[str, dict[str, Any]]:
    names = {"count": "contacts"} | {name: name for name in ("penetration", "normal_force", "rigid_force")}
    return {"/contacts": {key: getattr(instant, name) for key, name in names.items()}}


def sensor_message(model: mujoco.MjModel, sensordata: np.ndarray) -> dict[str, Any]:
    """Return each sensor's value, or its values, by its name."""
    values = np.split(sensordata, model.sensor_adr[1:])
    return {
        name: value.tolist() if len(value) != 1 else float(value[0])
        for name, value in zip(sensor_names(model), values, strict=True)
    }


def sensor_names(model: mujoco.MjModel) -> list[str]:
    """Return the sensors' names, `sensor_3` for one that has none."""
    return [model.sensor(k).name or f"sensor_{k}" for k in range(model.nsensor)]


def instants(logged: Mapping[str, list[dict[str, Any]]]) -> tuple[Instant, ...]:
    """Return the instants that `messages` made the messages of; inverse of it, bit by bit.

    Raise KeyError for a topic or field that is missing, ValueError for topics of different lengths.
    """
    soft = {topic.removeprefix("/soft/"): found for topic, found in logged.items() if topic.startswith("/soft/")}
    rows = zip(logged["/energy"], logged["/contacts"], strict=True)
    return tuple(
        Instant(
            time=energy["time"],
            kinetic=energy["kinetic"],
            potential=energy["potential"],
            elastic={name: found[k]["elastic"] for name, found in soft.items()},
            soft_kinetic={name: found[k]["kinetic"] for name, found in soft.items()},
            contacts=contacts["count"],
            penetration=contacts["penetration"],
            normal_force=contacts["normal_force"],
            soft_force={name: found[k]["normal_force"] for name, found in soft.items()},
            rigid_force=contacts["rigid_force"],
            speed=energy["speed"],
        )
        for k, (energy, contacts) in enumerate(rows)
    )


def require_message(topic: str, message: Any) -> None:
    """Raise ValueError where a message of a log has not the numbers that its topic has in FIELDS, or no time."""
    name = topic.removeprefix("/").split("/")[0]
    if not isinstance(message, dict) or not _is_number(message.get("time")) or not math.isfinite(message["time"]):
        raise ValueError(f"a message of {topic} has no time")
    for key, field in FIELDS.get(name, {}).items():
        value = message.get(key)
        if field is NUMBERS and not (isinstance(value, list) and all(map(_is_number, value))):
            raise ValueError(f"a message of {topic} has no list of numbers {key!r}")
        if field is not NUMBERS and not _is_number(value):
            raise ValueError(f"a message of {topic} has no number {key!r}")


def _is_number(value: Any) -> bool:
    """Whether JSON gave a number that a float64 holds; it may be infinite or none, as in a run that diverged."""
    if isinstance(value, float):
        return True
    return isinstance(value, int) and not isinstance(value, bool) and abs(value) <= sys.float_info.max


def json_schema(name: str, fields: Mapping[str, Any]) -> dict[str, Any]:
    """Return the JSON schema of messages that have a time and `fields`: their schema, or the unit of a number."""
    properties = {
        name: field if isinstance(field, dict) else {"type": "number", "description": f"[{field}]"}
        for name, field in {"time": "s", **fields}.items()
    }
    return {
        "title": f"mjframes.{name}",
        "type": "object",
        "properties": properties,
        "required": ["time", *fields],
    }


# What is measured at an instant. States have a rate of their own.
TOPICS: dict[str, Topic] = {
    "energy": Topic(
        lambda model, bodies: {"/energy": FIELDS["energy"], **{f"/soft/{name}": FIELDS["soft"] for name in bodies}},
        lambda model, data, instant: _energy(instant),
    ),
    "contacts": Topic(
        lambda model, bodies: {"/contacts": FIELDS["contacts"]},
        lambda model, data, instant: _contacts(instant),
    ),
    "sensors": Topic(
        lambda model, bodies: {"/sensors": sensor_fields(model)} if model.nsensor else {},
        lambda model, data, instant: {"/sensors": sensor_message(model, data.sensordata)} if model.nsensor else {},
    ),
}
