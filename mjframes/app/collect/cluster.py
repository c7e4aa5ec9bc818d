"""Shards as tasks of a Ray cluster, whose results come back to whoever asked: no folder has to be shared."""

from __future__ import annotations

import logging
import os
import socket
from collections.abc import Iterator, Mapping, Sequence

from mjframes.app.collect.options import CollectOptions
from mjframes.app.collect.plan import engine
from mjframes.app.collect.shard import shard_bytes
from mjframes.base.errors import MjframesError, reason
from mjframes.base.packages import optional

RETRIES = 20  # [a shard] after its worker died
PATIENCE = 10.0  # [s] for a cluster's first answer; Ray itself would wait for minutes
AHEAD = 2  # [a processor] shards that are asked for at a time: their results wait in the cluster's memory


def on_cluster(
    address: str, options: CollectOptions, files: Mapping[str, bytes], shards: Sequence[int], threads: int
) -> Iterator[tuple[int, bytes]]:
    """Yield shards and their numbers as they are done, in any order.

    address: of the cluster, "local" for a new one on this machine.  threads: of each task.
    Raise MjframesError where Ray is not installed or the cluster cannot be reached.
    """
    ray = optional("ray", "a cluster", "ray")
    host, colon, port = address.rpartition("://")[2].rpartition(":")
    try:
        if colon and port.isdecimal():
            socket.create_connection((host.strip("[]"), int(port)), PATIENCE).close()
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # a cluster started here sends nothing home
        ray.init(address, log_to_driver=False, logging_level=logging.ERROR)
    except (OSError, RuntimeError, ValueError) as error:
        raise MjframesError(f"ray is {address!r}: there is no cluster that answers ({reason(error)}).") from error
    try:
        task = ray.remote(num_cpus=threads, max_retries=RETRIES)(shard_bytes)
        scene = ray.put(dict(files))
        waiting, running = list(shards), {}
        while waiting or running:
            room = AHEAD * max(1, int(ray.cluster_resources().get("CPU", 1)) // threads)
            while waiting and len(running) < room:
                number = waiting.pop(0)
                running[task.remote(options, scene, number, threads, engine())] = number
            done, _ = ray.wait(list(running), num_returns=1)
            try:
                yield running.pop(done[0]), ray.get(done[0])
            except ray.exceptions.RayError as error:
                if isinstance(getattr(error, "cause", None), MjframesError):
                    raise error.cause from error
                last_line = (str(error).splitlines() or [type(error).__name__])[-1]
                raise MjframesError(f"the cluster could not compute a shard ({last_line}).") from error
    finally:
        ray.shutdown()
