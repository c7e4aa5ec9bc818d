"""A shard: the log of some worlds in one MCAP file, world after world, so that a reader finds each at once.

Topics: /world_42/state (time, qpos, qvel, act, ctrl) and /world_42/sensors, where there are sensors. Records of
metadata say what was drawn for each world. The scene is attached as in the log of a run.
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import mujoco

from mjframes.app.collect.plan import Plan, engine
from mjframes.app.collect.worlds import Stepping, Worlds
from mjframes.app.log.numbers import NUMBERS, json_schema, nanoseconds_of, sensor_fields, sensor_message
from mjframes.app.log.worlds import WORLD, world_topic
from mjframes.app.log.write import METADATA, attach
from mjframes.app.measure import weight_of
from mjframes.base.errors import MjframesError
from mjframes.scene.packed import unpack

STATE = {"qpos": NUMBERS, "qvel": NUMBERS, "act": NUMBERS, "ctrl": NUMBERS}


def shard_path(folder: Path, number: int) -> Path:
    return folder / f"shard-{number:05}.mcap"


def shard_bytes(plan: Plan, files: Mapping[str, bytes], number: int, threads: int) -> bytes:
    """Return the file of a shard, the same wherever it is computed.

    files: of the packed scene.  threads: 0 for one a processor.
    Raise MjframesError as `worlds.Stepping` does, and where the plan is for another engine than there is here.
    """
    if engine() != plan.engine:
        raise MjframesError(f"a worker has {engine()}, but the plan is for {plan.engine}; install the same there.")
    stepping, worlds = stepping_of(plan, files), plan.of_shard(number)
    return _written(stepping.model, files, worlds, stepping.run(worlds, threads))


def stepping_of(plan: Plan, files: Mapping[str, bytes]) -> Stepping:
    """Return the plan's scene, kept for the next shard; raises what `worlds.Stepping` does."""
    return _stepping(plan, tuple(sorted(files.items())))


@lru_cache(maxsize=1)
def _stepping(plan: Plan, files: tuple[tuple[str, bytes], ...]) -> Stepping:
    return Stepping(plan, unpack(dict(files), "the scene"))


def _written(model: mujoco.MjModel, files: Mapping[str, bytes], numbers: range, worlds: Worlds) -> bytes:
    from mcap.writer import Writer

    stream = io.BytesIO()
    writer = Writer(stream)
    writer.start(profile="", library="mjframes")
    attach(writer, files)
    about = {"timestep": model.opt.timestep, "weight": weight_of(model), "mujoco": mujoco.mj_versionString()}
    writer.add_metadata(METADATA, {key: str(value) for key, value in about.items()})
    topics = {"state": STATE} | ({"sensors": sensor_fields(model)} if model.nsensor else {})
    schemas = {}
    for topic, fields in topics.items():
        schema = json_schema(f"world.{topic}", fields)
        schemas[topic] = writer.register_schema(schema["title"], "jsonschema", json.dumps(schema).encode())
    for i, number in enumerate(numbers):
        row = {WORLD: number, **worlds.drawn[i], "entries": worlds.count[i], "ended": worlds.ended[i]}
        writer.add_metadata(WORLD, {key: str(value) for key, value in row.items()})
        for topic, schema in schemas.items():
            channel = writer.register_channel(world_topic(number, topic), "json", schema)
            for time, message in _messages(model, worlds, i, topic):
                at = nanoseconds_of(time)
                writer.add_message(channel, at, json.dumps({"time": time, **message}).encode(), at)
    writer.finish()
    return stream.getvalue()


def _messages(model: mujoco.MjModel, worlds: Worlds, i: int, topic: str) -> Iterator[tuple[float, dict[str, Any]]]:
    """What world i says in a topic, and when [s]."""
    for k in range(int(worlds.count[i])):
        if topic == "sensors":
            message = sensor_message(model, worlds.sensors[i, k])
        else:
            message = {name: getattr(worlds, name)[i, k].tolist() for name in STATE}
        yield float(worlds.times[k]), message
