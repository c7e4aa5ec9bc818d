"""Logs of a simulation: MCAP files with JSON messages and their schemas, which Foxglove opens.

Channels: /state (time, qpos, qvel), /energy, /contacts, and /soft/<name> for each soft body; the scene's XML is an
attachment. All is SI; the log time of a message is the simulated time.
"""

from __future__ import annotations

import json
import os
import struct
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from mjframes.base.errors import MjframesError
from mjframes.base.files import replacing

if TYPE_CHECKING:
    from mjframes.app.recording import Instant

SCENE = "scene.xml"  # name of the attachment

NUMBERS = {"type": "array", "items": {"type": "number"}}
CHANNELS: dict[str, dict[str, Any]] = {
    "state": {"time": "s", "qpos": NUMBERS, "qvel": NUMBERS},
    "energy": {"time": "s", "kinetic": "J", "potential": "J, gravity and springs", "elastic": "J", "total": "J"},
    "contacts": {"time": "s", "count": "contacts", "penetration": "m, deepest", "normal_force": "N, sum"},
    "soft": {"time": "s", "elastic": "J", "kinetic": "J"},
}


@dataclass(frozen=True)
class Log:
    """messages: topic → its messages in order of time.  scene: XML of the scene, "" where none was attached."""

    messages: dict[str, list[dict[str, Any]]]
    scene: str


@contextmanager
def log_file(
    path: str | os.PathLike[str], soft_names: tuple[str, ...] = (), scene: str = ""
) -> Iterator[Callable[[Instant], None]]:
    """A function that logs an instant; the file appears when the block succeeds.

    soft_names: the soft bodies, one channel each.  scene: XML to attach.
    Raises MjframesError where mcap is missing or the file cannot be written.
    """
    try:
        from mcap.writer import Writer
    except ImportError as error:
        raise MjframesError('a log needs mcap, which is not installed; pip install "mjframes[log]".') from error
    with replacing(path, "the log") as partial, partial.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="", library="mjframes")
        schemas = {
            name: writer.register_schema(f"mjframes.{name}", "jsonschema", json.dumps(_schema(fields)).encode())
            for name, fields in CHANNELS.items()
        }
        topics = {f"/{name}": name for name in CHANNELS if name != "soft"} | {f"/soft/{n}": "soft" for n in soft_names}
        channels = {topic: writer.register_channel(topic, "json", schemas[name]) for topic, name in topics.items()}
        if scene:
            writer.add_attachment(0, 0, SCENE, "application/xml", scene.encode())

        def write(instant: Instant) -> None:
            nanoseconds = round(instant.time * 1e9)
            for topic, message in _messages(instant).items():
                data = json.dumps({"time": instant.time, **message}).encode()
                writer.add_message(channels[topic], nanoseconds, data, nanoseconds)

        yield write
        writer.finish()


def read_log(path: str | os.PathLike[str]) -> Log:
    """All messages of a log, by topic.  Raises MjframesError for a file that is no log of ours."""
    from mcap.exceptions import McapError
    from mcap.reader import make_reader

    messages: dict[str, list[dict[str, Any]]] = defaultdict(list)
    try:
        with open(path, "rb") as stream:
            reader = make_reader(stream)
            for _, channel, message in reader.iter_messages():
                messages[channel.topic].append(json.loads(message.data))
            scene = next((a.data.decode() for a in reader.iter_attachments() if a.name == SCENE), "")
    except OSError as error:
        raise MjframesError(f"{path}: the log cannot be read ({error.strerror}).") from error
    except (McapError, ValueError, struct.error) as error:
        raise MjframesError(f"{path}: not a log that mjframes wrote ({error}).") from error
    return Log(dict(messages), scene)


def _messages(instant: Instant) -> dict[str, dict[str, Any]]:
    energy = {"kinetic": instant.kinetic, "potential": instant.potential, "elastic": sum(instant.elastic.values())}
    return {
        "/state": {"qpos": instant.qpos.tolist(), "qvel": instant.qvel.tolist()},
        "/energy": {**energy, "total": instant.total},
        "/contacts": {
            "count": instant.contacts,
            "penetration": instant.penetration,
            "normal_force": instant.normal_force,
        },
        **{
            f"/soft/{name}": {"elastic": elastic, "kinetic": instant.soft_kinetic[name]}
            for name, elastic in instant.elastic.items()
        },
    }


def _schema(fields: dict[str, Any]) -> dict[str, Any]:
    properties = {
        name: field if isinstance(field, dict) else {"type": "number", "description": f"[{field}]"}
        for name, field in fields.items()
    }
    return {"type": "object", "properties": properties, "required": list(fields)}
