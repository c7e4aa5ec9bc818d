"""Writing logs: MCAP in zstd chunks with indexes, which grow on the disk while the simulation runs.

Beside the topics of `numbers`: /tf (FrameTransforms), /scene/rigid (SceneUpdate, said once), /scene/soft and
/scene/forces (SceneUpdate), /taxels/<name> of each map (RawImage), /video (CompressedVideo). Attached, compressed, are
the scene's XML and the files that it names. All is SI; the log time of a message is the simulated time.
"""

from __future__ import annotations

import json
import lzma
import os
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING

import mujoco

from mjframes.app.log.numbers import messages, nanoseconds_of, schemas, state_message
from mjframes.base.files import replacing
from mjframes.base.packages import optional

if TYPE_CHECKING:
    from mcap.writer import Writer

    from mjframes.app.log.drawing import Drawing
    from mjframes.app.recording import Instant, State

LIBRARY = "mjframes"  # what a log's header says that it was written by
METADATA = "mjframes"  # name of the records of what the run was
FLUSH = 5.0  # [s] of wall time: so much of a run that is killed may be missing
CHUNK = 1 << 22  # [bytes] of messages, at most: the triangles, the same in all of them, are packed once in each
LARGEST_FILE = 2**30  # [bytes] of an attachment: scenes have a hundredth
PACKED = ".xz"  # ending of attachments


class LogWriter:
    """A log that is being written."""

    def __init__(
        self, writer: Writer, model: mujoco.MjModel, soft_names: Collection[str], topics: Collection[str]
    ) -> None:
        self._writer, self._model, self._topics = writer, model, topics
        self._flushed = time.monotonic()
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._drawn: dict[str, Callable[[mujoco.MjData, float], Drawing]] = {}
        for topic, schema in schemas(model, soft_names, topics).items():
            self._register(topic, "jsonschema", schema["title"], json.dumps(schema).encode())
        if "scene" in topics:
            from mjframes.app.log.drawing import channels, rigid_scene

            self._drawn = channels(model)
            self._write_drawing("/scene/rigid", 0.0, rigid_scene(model))

    def numbers(self, instant: Instant, data: mujoco.MjData) -> None:
        """Log the numbers of an instant; data: at that instant."""
        for topic, message in messages(self._model, data, instant, self._topics).items():
            self._write(topic, instant.time, json.dumps({"time": instant.time, **message}).encode())

    def state(self, state: State) -> None:
        """Log a state, if that is a topic."""
        if "/state" in self._channels:
            message = {"time": state.time, **state_message(state)}
            self._write("/state", state.time, json.dumps(message).encode())

    def scene(self, data: mujoco.MjData, now: float) -> None:
        """Log what is drawn in 3D.  now: the data's time [s]."""
        for topic, draw in self._drawn.items():
            self._write_drawing(topic, now, draw(data, now))

    def video(self, picture: bytes, camera: str, now: float) -> None:
        """Log a frame of H.264 in Annex B.  camera: its name.  now: its time [s]."""
        from mjframes.app.log.drawing import video_frame

        self._write_drawing("/video", now, video_frame(picture, camera, now))

    def about(self, facts: Mapping[str, object]) -> None:
        """Log facts of the run, numbers as Python prints them."""
        self._writer.add_metadata(METADATA, {key: str(value) for key, value in facts.items()})

    def _write_drawing(self, topic: str, now: float, message: Drawing) -> None:
        """Log a message of one of Foxglove's own schemas."""
        if topic not in self._channels:
            schema = message.get_schema()
            self._register(topic, schema.encoding, schema.name, schema.data)
        self._write(topic, now, message.encode())

    def _write(self, topic: str, now: float, message: bytes) -> None:
        nanoseconds = nanoseconds_of(now)
        self._writer.add_message(self._channels[topic], nanoseconds, message, nanoseconds)
        if time.monotonic() > self._flushed + FLUSH:
            self._writer.flush()
            self._flushed = time.monotonic()

    def _register(self, topic: str, encoding: str, name: str, schema: bytes) -> None:
        """Add the channel of a topic.  encoding: of its schema."""
        if name not in self._schemas:
            self._schemas[name] = self._writer.register_schema(name, encoding, schema)
        messages = encoding.removesuffix("schema")  # messages of a "jsonschema" are "json"
        self._channels[topic] = self._writer.register_channel(topic, messages, self._schemas[name])


@contextmanager
def log_file(
    path: str | os.PathLike[str],
    model: mujoco.MjModel,
    soft_names: Collection[str],
    topics: Collection[str],
    files: Mapping[str, bytes],
) -> Iterator[LogWriter]:
    """A log of a model's simulation; it grows under a hidden name, and has its own when the block succeeds.

    soft_names: the soft bodies.  topics: some of `options.TOPICS`.  files: to attach, by name.
    Raise MjframesError where a package is missing or the file cannot be written.
    """
    optional("foxglove.messages", "a log", "log", "foxglove-sdk")
    mcap = optional("mcap.writer", "a log", "log")
    with replacing(path, "the log") as partial, partial.open("wb") as stream:
        writer = mcap.Writer(stream, CHUNK)
        writer.start(profile="", library=LIBRARY)
        attach(writer, files)
        yield LogWriter(writer, model, soft_names, topics)
        writer.finish()


def attach(writer: Writer, files: Mapping[str, bytes]) -> None:
    """Attach files by name, compressed."""
    for name, content in files.items():
        writer.add_attachment(0, 0, name + PACKED, "application/x-xz", lzma.compress(content))


def attached(name: str, content: bytes) -> tuple[str, bytes]:
    """Return name and content of a file that `attach` made an attachment of.

    Raise lzma.LZMAError for others, and for one that would become too large.
    """
    decompressor = lzma.LZMADecompressor()
    unpacked = decompressor.decompress(content, LARGEST_FILE + 1)
    if len(unpacked) > LARGEST_FILE or not decompressor.eof:
        raise lzma.LZMAError(f"{name!r} is cut off, or takes more than {LARGEST_FILE >> 20} MiB")
    return name.removesuffix(PACKED), unpacked
