"""A shard: the log of some worlds in one MCAP file, world after world, so that a reader finds each at once.

Topics: /world_42/state (time, qpos, qvel, act, ctrl) and /world_42/sensors, where there are sensors. Records of
metadata say what was drawn for each world. The scene is attached as in the log of a run.
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from functools import lru_cache

import mujoco

from mjframes.app.collect.options import CollectOptions
from mjframes.app.collect.plan import engine
from mjframes.app.collect.worlds import Stepping, Worlds
from mjframes.app.log.numbers import FIELDS, json_schema, nanoseconds_of, sensor_fields, sensor_message
from mjframes.app.log.worlds import WORLD, world_topic
from mjframes.app.log.write import LIBRARY, METADATA, attach
from mjframes.app.measure import weight_of
from mjframes.app.recording import STATE
from mjframes.base.errors import MjframesError
from mjframes.scene.packed import unpack


def shard_bytes(
    options: CollectOptions, files: Mapping[str, bytes], number: int, threads: int, wanted_engine: str
) -> bytes:
    """Return the file of a shard, the same wherever it is computed.

    files: of the packed scene.  threads: 0 for one a processor.  wanted_engine: of the collection.
    Raise MjframesError as `worlds.Stepping` does, and where there is another engine here.
    """
    if engine() != wanted_engine:
        raise MjframesError(f"a worker has {engine()}, but the plan is for {wanted_engine}; install the same there.")
    stepping, numbers = stepping_of(options, files), options.worlds_of(number)
    return _written(stepping.model, files, numbers, stepping.run(numbers, threads))


def stepping_of(options: CollectOptions, files: Mapping[str, bytes]) -> Stepping:
    """Return the scene, kept for the next shard; raises what `worlds.Stepping` does."""
    return _stepping(options, tuple(sorted(files.items())))


@lru_cache(maxsize=1)
def _stepping(options: CollectOptions, files: tuple[tuple[str, bytes], ...]) -> Stepping:
    return Stepping(options, unpack(dict(files), "the scene"))


def _written(model: mujoco.MjModel, files: Mapping[str, bytes], numbers: range, worlds: Worlds) -> bytes:
    from mcap.writer import Writer

    stream = io.BytesIO()
    writer = Writer(stream)
    writer.start(profile="", library=LIBRARY)
    attach(writer, files)
    about = {"timestep": model.opt.timestep, "weight": weight_of(model), "mujoco": mujoco.mj_versionString()}
    writer.add_metadata(METADATA, {key: str(value) for key, value in about.items()})
    schemas = {}
    topics = {"state": FIELDS["state"]} | ({"sensors": sensor_fields(model)} if model.nsensor else {})
    for topic, fields in topics.items():
        schema = json_schema(f"world.{topic}", fields)
        schemas[topic] = writer.register_schema(schema["title"], "jsonschema", json.dumps(schema).encode())
    for i, number in enumerate(numbers):
        row = {WORLD: number, **worlds.drawn[i], "entries": worlds.count[i], "ended": worlds.ended[i]}
        writer.add_metadata(WORLD, {key: str(value) for key, value in row.items()})
        for topic, schema in schemas.items():
            channel = writer.register_channel(world_topic(number, topic), "json", schema)
            for k in range(int(worlds.count[i])):
                message = {name: worlds.kept[name][i, k].tolist() for name in STATE}
                if topic == "sensors":
                    message = sensor_message(model, worlds.kept["sensors"][i, k])
                time = float(worlds.times[k])
                at = nanoseconds_of(time)
                writer.add_message(channel, at, json.dumps({"time": time, **message}).encode(), at)
    writer.finish()
    return stream.getvalue()
