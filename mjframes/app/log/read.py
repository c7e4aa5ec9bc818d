"""Reading logs: their numbers, the scene, what the run was; also of a log that a killed run left behind."""

from __future__ import annotations

import json
import lzma
import math
import os
import struct
import sys
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from mjframes.app.log.numbers import instants, require_message
from mjframes.app.log.worlds import WORLD, world_of
from mjframes.app.log.write import LIBRARY, METADATA, attached
from mjframes.app.recording import STATE, Recording, State
from mjframes.base.archive import DAMAGED
from mjframes.base.errors import MjframesError, reason

FACTS = ("timestep", "steps", "seconds", "weight")  # that are numbers
SHOWN = 20  # letters of one that is none


@dataclass(frozen=True, eq=False)
class Logged:
    """What is in a log.

    path: of its file.  messages: topic of numbers → its messages in order of time.
    files: what was attached, by name; the scene is `scene.SCENE` of them.  about: facts of the run.
    whole: whether it was written to its end.  worlds: those in it, of a log of many of which none was chosen.
    """

    path: str
    messages: Mapping[str, list[dict[str, Any]]]
    files: Mapping[str, bytes]
    about: Mapping[str, str]
    whole: bool
    worlds: tuple[int, ...] = ()

    def states(self) -> list[dict[str, Any]]:
        """Return the messages of /state.  Raise MjframesError where there are none, and where they differ in length."""
        self._of_one()
        found = self.messages.get("/state", [])
        if not found:
            if not self.whole:
                raise MjframesError(f"{self.path}: the log was cut off, and what is left has no states.")
            raise MjframesError(f"{self.path}: the log has no states; log a run with the topic state.")
        for state in found:
            for key in STATE:
                count, first = len(state[key]), len(found[0][key])
                if count != first:
                    raise MjframesError(
                        f"{self.path}: its state at {state['time']:g} s has {count} {key}, the first one {first}; "
                        "it is damaged."
                    )
        return found

    def recording(self) -> Recording:
        """Return the recording that was logged; its `seconds` are NaN where the log is not whole.

        Raise MjframesError where the log has not all topics that it takes.
        """
        self._of_one()
        for topic in ("energy", "contacts"):
            if f"/{topic}" not in self.messages:
                raise MjframesError(f"{self.path}: the log has no {topic}; log a run with the topic {topic}.")
        # a log cut off between two topics of an instant has one message less of the later ones
        count = min(len(found) for topic, found in self.messages.items() if topic not in ("/state", "/sensors"))
        timestep = float(self.about["timestep"])
        measured = instants({topic: found[:count] for topic, found in self.messages.items()})
        return Recording(
            measured,
            tuple(map(_state, self.messages.get("/state", []))),
            steps=int(self.about.get("steps", round(measured[-1].time / timestep) + 1)),
            seconds=float(self.about.get("seconds", math.nan)),
            timestep=timestep,
            weight=self._weight(),
        )

    def _weight(self) -> float:
        """Return the weight of all that moves [N]."""
        if "weight" not in self.about:
            raise MjframesError(f"{self.path}: the log does not say the weight of all that moves; it is damaged.")
        return float(self.about["weight"])

    def end(self) -> float:
        """Return the last time that a message tells of [s].  Raise MjframesError where there are none."""
        self._of_one()
        return max(found[-1]["time"] for found in self.messages.values())

    def _of_one(self) -> None:
        if self.worlds:
            several = f"{self.worlds[0]} to {self.worlds[-1]}"
            raise MjframesError(f"{self.path}: the log is of the worlds {several}; choose one, with --world.")


def read_log(path: str | os.PathLike[str], world: int | None = None) -> Logged:
    """Return the numbers and files of a log, as far as it was written.

    world: which, of a log of many: its topics are as in a log of it alone, and what was drawn for it is in `about`.
    Raise MjframesError for a file that cannot be read, is damaged or is no log of ours, and where it has no such world.
    """
    from mcap.exceptions import McapError
    from mcap.records import Attachment, Channel, Header, Message, Metadata
    from mcap.stream_reader import StreamReader
    from zstandard import ZstdError

    messages: dict[str, list[dict[str, Any]]] = defaultdict(list)
    files: dict[str, bytes] = {}
    about: dict[str, str] = {}
    topics: dict[int, str] = {}
    worlds: set[int] = set()
    whole = ours = False
    try:
        with open(path, "rb") as stream:
            try:
                for record in StreamReader(stream, validate_crcs=True).records:
                    if isinstance(record, Header):
                        ours = record.library == LIBRARY
                    elif isinstance(record, Channel) and record.message_encoding == "json":
                        own = world_of(record.topic)
                        worlds |= {own[0]} if own else set()
                        if own is None or own[0] == world:
                            topics[record.id] = own[1] if own else record.topic
                    elif isinstance(record, Message) and record.channel_id in topics:
                        topic = topics[record.channel_id]
                        messages[topic].append(_message(path, topic, record.data))
                    elif isinstance(record, Attachment):
                        name, content = attached(record.name, record.data)
                        files[name] = content
                    elif isinstance(record, Metadata) and _concerns(record.name, record.metadata, world):
                        about |= record.metadata
                whole = True
            except MjframesError:
                raise
            except (*DAMAGED, MemoryError, McapError, struct.error, ZstdError, lzma.LZMAError) as error:
                if stream.read(1):  # else the file ends within a record: it was cut off
                    raise MjframesError(
                        f"{path}: not a log that mjframes wrote, or a damaged one ({reason(error)})."
                    ) from error
    except OSError as error:
        raise MjframesError(f"{path}: the log cannot be read ({error.strerror}).") from error
    if "timestep" not in about:
        if ours and not whole:
            raise MjframesError(f"{path}: the log was cut off before its first entry; nothing of it can be read.")
        raise MjframesError(f"{path}: not a log that mjframes wrote (it does not say of what).")
    _require_facts(path, about)
    if world is not None and world not in worlds:
        known = f"those of {min(worlds)} to {max(worlds)}" if worlds else "none, it is of one run"
        raise MjframesError(f"{path}: world is {world}, but the log has {known}.")
    return Logged(os.fspath(path), dict(messages), files, about, whole, tuple(sorted(worlds)) if world is None else ())


def _message(path: str | os.PathLike[str], topic: str, content: bytes) -> dict[str, Any]:
    """Return a message of numbers. Raise MjframesError for what is none."""
    try:
        message = json.loads(content)
        if topic == "/state" and isinstance(message, dict):
            message.setdefault("ctrl", [])  # logs of version 0.1.0 have none
        require_message(topic, message)
    except (ValueError, RecursionError) as error:
        raise MjframesError(f"{path}: the log is damaged ({error}).") from error
    return message


def _require_facts(path: str | os.PathLike[str], about: Mapping[str, str]) -> None:
    """Raise MjframesError where a number of a log's facts is none."""
    for key in FACTS:
        text = about.get(key, "1")
        try:
            number = float(text)
        except ValueError:
            number = math.nan
        least = 0.0 if key in ("seconds", "weight") else sys.float_info.min
        if not (math.isfinite(number) and number >= least and (key != "steps" or text.isdecimal())):
            raise MjframesError(
                f"{path}: the log says {key} = {text[:SHOWN]!r}, which is no such number; it is damaged."
            )


def _state(message: Mapping[str, Any]) -> State:
    return State(message["time"], *(np.array(message[key], float) for key in STATE))


def _concerns(name: str, metadata: Mapping[str, str], world: int | None) -> bool:
    """Whether metadata are of the run, or of the world that is chosen."""
    return name == METADATA or (name == WORLD and metadata.get(WORLD) == str(world))
